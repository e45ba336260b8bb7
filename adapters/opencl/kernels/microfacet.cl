// What materials are made of: a cosine-weighted direction, Fresnel reflectances, the GGX distribution. Directions are in the
// shading frame, z along the normal; w_i points to where the path came from, w_o to where it goes on (Mitsuba's convention).

INLINE float3 cosine_direction(float u, float v) {
    // Concentric map of the square to the disk (Shirley and Chiu 1997).
    const float a = 2.0f * u - 1.0f, b = 2.0f * v - 1.0f;
    const bool first = magnitude(a) > magnitude(b);
    const float r = first ? a : b;
    const float other = first ? b : a;
    const float phi = r == 0.0f ? 0.0f : 0.25f * PI * (other / r);
    const float2 p = eighth(phi);
    const float x = r * (first ? p.x : p.y), y = r * (first ? p.y : p.x);
    return (float3)(x, y, root(larger(0.0f, 1.0f - x * x - y * y)));
}

// Unpolarised reflectance of a dielectric; eta is inside over outside. *cos_t has the sign of the transmitted side.
INLINE float fresnel(float cos_i, float eta, float* cos_t, float* eta_ti) {
    const bool outside = cos_i >= 0.0f;
    const float ratio = outside ? eta : 1.0f / eta, inverse = 1.0f / ratio;
    *eta_ti = inverse;
    const float squared = 1.0f - inverse * inverse * (1.0f - cos_i * cos_i);
    const float c = magnitude(cos_i), t = root(larger(squared, 0.0f));
    *cos_t = outside ? -t : t;
    if (squared <= 0.0f) return 1.0f;
    const float s = (c - ratio * t) / (c + ratio * t), p = (ratio * c - t) / (ratio * c + t);
    return 0.5f * (s * s + p * p);
}

#if HAS_CONDUCTOR || HAS_ROUGHCONDUCTOR
// Unpolarised reflectance of a conductor (Born and Wolf 1999, section 14.2).
INLINE float3 fresnel_conductor(float cos_i, float3 eta, float3 k) {
    const float c2 = cos_i * cos_i, s2 = 1.0f - c2, s4 = s2 * s2;
    const float3 difference = eta * eta - k * k - s2;
    const float3 a2b2 = root(larger(difference * difference + 4.0f * eta * eta * k * k, 0.0f));
    const float3 a = root(larger(0.5f * (a2b2 + difference), 0.0f));
    const float3 one = a2b2 + c2, two = 2.0f * cos_i * a;
    const float3 s = (one - two) / (one + two);
    const float3 three = a2b2 * c2 + s4, four = two * s2;
    return 0.5f * (s + s * (three - four) / (three + four));
}
#endif

#if HAS_ROUGHDIELECTRIC || HAS_ROUGHCONDUCTOR || HAS_METALLIC_ROUGHNESS
INLINE float ggx_d(float3 m, float alpha) {
    const float e = (m.x * m.x + m.y * m.y) / (alpha * alpha) + m.z * m.z;
    return 1.0f / (PI * alpha * alpha * e * e);
}
INLINE float ggx_g1(float3 w, float3 m, float alpha) {
    if (inner(w, m) * w.z <= 0.0f) return 0.0f;
    const float tan2 = (w.x * w.x + w.y * w.y) / (w.z * w.z);
    return 2.0f / (1.0f + root(1.0f + alpha * alpha * tan2));
}
// A visible normal (Heitz 2018, "Sampling the GGX distribution of visible normals", JCGT 7(4)), w.z > 0.
INLINE float3 ggx_normal(float3 w, float alpha, float u, float v) {
    const float3 h = unit((float3)(alpha * w.x, alpha * w.y, w.z));
    const float length2 = h.x * h.x + h.y * h.y;
    const float3 t1 = length2 > 0.0f ? (float3)(-h.y, h.x, 0.0f) / root(length2) : (float3)(1.0f, 0.0f, 0.0f);
    const float3 t2 = outer(h, t1);
    const float2 p = circle(v) * root(u);
    const float x = p.x, half_ = 0.5f * (1.0f + h.z), y = (1.0f - half_) * root(larger(0.0f, 1.0f - x * x)) + half_ * p.y;
    const float3 n = x * t1 + y * t2 + root(larger(0.0f, 1.0f - x * x - y * y)) * h;
    return unit((float3)(alpha * n.x, alpha * n.y, larger(n.z, 1e-7f)));
}
#endif

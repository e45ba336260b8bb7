// How surfaces scatter. Directions are in the shading frame, z along the normal; w_i points to where the path came from, w_o to
// where it goes on (Mitsuba's convention). Values hold the cosine. Transmission carries radiance, which a change of the index of
// refraction concentrates by its square (Veach 1997, section 5.2).

// Rows of a material in its table, four floats each.
enum { COLOR_OPACITY, REFLECTANCE_ETA, TRANSMITTANCE_ALPHA, CONDUCTOR_ETA, CONDUCTOR_K, PLASTIC, MATERIAL_ROWS };
// Its integers.
enum { KIND, FLAGS, COLOR_TEXTURE, NORMAL_TEXTURE, MATERIAL_INTS };
enum { TWO_SIDED = 1, CUT_OUT = 2, VERTEX_COLORS = 4, NONLINEAR = 8 };

typedef struct {
    float3 wo;
    float3 weight;  // value over density
    float density;  // per solid angle; 0 for a direction that has none (a perfect mirror's)
    float eta;      // index of refraction behind over before, where the path crosses a surface
    bool valid;
} Scattered;

typedef struct {
    int kind;
    float3 color;
    global const float4* rows;
    bool nonlinear;
} Bsdf;

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

#if HAS_ROUGHDIELECTRIC || HAS_ROUGHCONDUCTOR
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

#if HAS_PLASTIC
// Share of light that a plastic's diffuse base sends out, colour by colour; `base` has 1 - (share reflected back inside).
INLINE float3 plastic_base(const Bsdf* b) {
    const float inside = b->rows[PLASTIC].x;
    const float3 back = b->nonlinear ? b->color * inside : (float3)(inside);
    return b->color / (1.0f - back) / square(b->rows[REFLECTANCE_ETA].w);
}
INLINE float plastic_specular_share(const Bsdf* b, float f) {
    const float w = b->rows[PLASTIC].y, specular = f * w, diffuse = (1.0f - f) * (1.0f - w);
    return specular / (specular + diffuse);
}
#endif

// Value times cosine, and the density with which `scatter` draws wo; both 0 where all scattering is by perfect mirrors.
INLINE float3 evaluate(const Bsdf* b, float3 wi, float3 wo, float* density) {
    *density = 0.0f;
    float cos_t, eta_ti;
    switch (b->kind) {
#if HAS_DIFFUSE
    case DIFFUSE:
        if (wi.z <= 0.0f || wo.z <= 0.0f) break;
        *density = wo.z * INV_PI;
        return b->color * *density;
#endif
#if HAS_PLASTIC
    case PLASTIC_KIND: {
        if (wi.z <= 0.0f || wo.z <= 0.0f) break;
        const float eta = b->rows[REFLECTANCE_ETA].w, f_i = fresnel(wi.z, eta, &cos_t, &eta_ti), f_o = fresnel(wo.z, eta, &cos_t, &eta_ti);
        *density = wo.z * INV_PI * (1.0f - plastic_specular_share(b, f_i));
        return plastic_base(b) * (wo.z * INV_PI * (1.0f - f_i) * (1.0f - f_o));
    }
#endif
#if HAS_ROUGHCONDUCTOR
    case ROUGHCONDUCTOR: {
        if (wi.z <= 0.0f || wo.z <= 0.0f) break;
        const float alpha = b->rows[TRANSMITTANCE_ALPHA].w;
        const float3 m = unit(wi + wo);
        const float d = ggx_d(m, alpha), g = ggx_g1(wi, m, alpha);
        *density = d * g / (4.0f * wi.z);
        return b->rows[REFLECTANCE_ETA].xyz * fresnel_conductor(inner(wi, m), b->rows[CONDUCTOR_ETA].xyz, b->rows[CONDUCTOR_K].xyz) *
               (d * g * ggx_g1(wo, m, alpha) / (4.0f * wi.z));
    }
#endif
#if HAS_ROUGHDIELECTRIC
    case ROUGHDIELECTRIC: {
        if (wi.z == 0.0f || wo.z == 0.0f) break;
        const float alpha = b->rows[TRANSMITTANCE_ALPHA].w, eta = wi.z > 0.0f ? b->rows[REFLECTANCE_ETA].w : 1.0f / b->rows[REFLECTANCE_ETA].w;
        const bool reflects = wi.z * wo.z > 0.0f;
        float3 m = wi + wo * (reflects ? 1.0f : eta);
        if (largest(magnitude(m)) < 1e-6f) break;  // straight through an interface without refraction: no normal does that
        m = unit(m);
        if (m.z < 0.0f) m = -m;
        const float i_m = inner(wi, m), o_m = inner(wo, m);
        if (i_m * wi.z <= 0.0f || o_m * wo.z <= 0.0f) break;
        const float f = fresnel(i_m, b->rows[REFLECTANCE_ETA].w, &cos_t, &eta_ti);
        const float d = ggx_d(m, alpha), g = ggx_g1(wi, m, alpha) * ggx_g1(wo, m, alpha);
        if (reflects) {
            *density = ggx_g1(wi, m, alpha) * magnitude(i_m) * d / magnitude(wi.z) * f / (4.0f * magnitude(o_m));
            return b->rows[REFLECTANCE_ETA].xyz * (f * d * g / (4.0f * magnitude(wi.z)));
        }
        const float jacobian = magnitude(eta * eta * o_m / square(i_m + eta * o_m));
        *density = ggx_g1(wi, m, alpha) * magnitude(i_m) * d / magnitude(wi.z) * (1.0f - f) * jacobian;
        return b->rows[TRANSMITTANCE_ALPHA].xyz * ((1.0f - f) * d * g * magnitude(i_m) * jacobian / (magnitude(wi.z) * eta * eta));
    }
#endif
    default: break;
    }
    return (float3)(0.0f);
}

// Draws where the path goes on; `lobe` chooses among kinds of scattering.
INLINE Scattered scatter(const Bsdf* b, float3 wi, float u, float v, float lobe) {
    Scattered r;
    r.wo = (float3)(0.0f, 0.0f, 1.0f);
    r.weight = (float3)(0.0f);
    r.density = 0.0f;
    r.eta = 1.0f;
    r.valid = false;
    float cos_t, eta_ti;
    switch (b->kind) {
#if HAS_DIFFUSE
    case DIFFUSE:
        if (wi.z <= 0.0f) break;
        r.wo = cosine_direction(u, v);
        r.density = r.wo.z * INV_PI;
        r.weight = b->color;
        r.valid = r.density > 0.0f;
        break;
#endif
#if HAS_DIELECTRIC
    case DIELECTRIC: {
        const float f = fresnel(wi.z, b->rows[REFLECTANCE_ETA].w, &cos_t, &eta_ti);
        r.valid = wi.z != 0.0f;
        if (lobe < f) {
            r.wo = (float3)(-wi.x, -wi.y, wi.z);
            r.weight = b->rows[REFLECTANCE_ETA].xyz;
        } else {
            r.wo = (float3)(-eta_ti * wi.x, -eta_ti * wi.y, cos_t);
            r.weight = b->rows[TRANSMITTANCE_ALPHA].xyz * square(eta_ti);
            r.eta = 1.0f / eta_ti;
        }
        break;
    }
#endif
#if HAS_CONDUCTOR
    case CONDUCTOR:
        if (wi.z <= 0.0f) break;
        r.wo = (float3)(-wi.x, -wi.y, wi.z);
        r.weight = b->rows[REFLECTANCE_ETA].xyz * fresnel_conductor(wi.z, b->rows[CONDUCTOR_ETA].xyz, b->rows[CONDUCTOR_K].xyz);
        r.valid = true;
        break;
#endif
#if HAS_PLASTIC
    case PLASTIC_KIND: {
        if (wi.z <= 0.0f) break;
        const float eta = b->rows[REFLECTANCE_ETA].w, f_i = fresnel(wi.z, eta, &cos_t, &eta_ti), share = plastic_specular_share(b, f_i);
        r.valid = true;
        if (lobe < share) {
            r.wo = (float3)(-wi.x, -wi.y, wi.z);
            r.weight = b->rows[REFLECTANCE_ETA].xyz * (f_i / share);
        } else {
            r.wo = cosine_direction(u, v);
            const float f_o = fresnel(r.wo.z, eta, &cos_t, &eta_ti);
            r.density = r.wo.z * INV_PI * (1.0f - share);
            r.weight = plastic_base(b) * ((1.0f - f_i) * (1.0f - f_o) / (1.0f - share));
            r.valid = r.density > 0.0f;
        }
        break;
    }
#endif
#if HAS_ROUGHCONDUCTOR
    case ROUGHCONDUCTOR: {
        if (wi.z <= 0.0f) break;
        const float3 m = ggx_normal(wi, b->rows[TRANSMITTANCE_ALPHA].w, u, v);
        r.wo = 2.0f * inner(wi, m) * m - wi;
        const float3 value = evaluate(b, wi, r.wo, &r.density);
        r.valid = r.density > 0.0f;
        r.weight = r.valid ? value / r.density : value;
        break;
    }
#endif
#if HAS_ROUGHDIELECTRIC
    case ROUGHDIELECTRIC: {
        if (wi.z == 0.0f) break;
        const float side = wi.z > 0.0f ? 1.0f : -1.0f;
        const float3 m = ggx_normal(wi * side, b->rows[TRANSMITTANCE_ALPHA].w, u, v);
        const float i_m = inner(wi, m), f = fresnel(i_m, b->rows[REFLECTANCE_ETA].w, &cos_t, &eta_ti);
        const bool reflects = lobe < f;
        r.wo = reflects ? 2.0f * i_m * m - wi : m * (i_m * eta_ti + cos_t) - wi * eta_ti;
        if (!reflects) r.eta = 1.0f / eta_ti;
        if (r.wo.z * wi.z * (reflects ? 1.0f : -1.0f) <= 0.0f) break;
        const float3 value = evaluate(b, wi, r.wo, &r.density);
        r.valid = r.density > 0.0f;
        r.weight = r.valid ? value / r.density : value;
        break;
    }
#endif
    default: break;
    }
    return r;
}

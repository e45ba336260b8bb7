// glTF 2.0's metallic-roughness material (specification, appendix B), with KHR_materials_transmission and KHR_materials_ior: a
// dielectric coat over a diffuse base or over a coloured window, mixed with a metal. Thin walls let light straight through, spread
// by the roughness; walls of a volume refract it.
#if HAS_METALLIC_ROUGHNESS

typedef struct {
    float alpha, metallic, transmission;
    float eta;  // inside over outside; 1 for a thin wall
    float f0;   // of the dielectric
} Metallic;

INLINE float schlick(float cosine) {
    const float c = 1.0f - smaller(magnitude(cosine), 1.0f);
    return square(square(c)) * c;
}

// Reflectance of the coat, seen from outside (side > 0) or from inside.
INLINE float coat_reflectance(const Metallic* m, float cosine, float side) {
    const float ratio = side > 0.0f ? m->eta : 1.0f / m->eta;
    if (ratio < 1.0f) {  // the cosine on the other side, where there is one
        const float squared = 1.0f - (1.0f - cosine * cosine) / square(ratio);
        if (squared <= 0.0f) return 1.0f;
        cosine = root(squared);
    }
    return m->f0 + (1.0f - m->f0) * schlick(cosine);
}

// Probabilities of drawing from the coat, the base and the window.
INLINE float3 metallic_lobes(const Metallic* m, float3 color, float cos_i, float side) {
    const float grey = (color.x + color.y + color.z) * (1.0f / 3.0f), s = schlick(cos_i);
    const float coat = coat_reflectance(m, cos_i, side), metal = grey + (1.0f - grey) * s, rest = (1.0f - m->metallic) * (1.0f - coat) * grey;
    const float3 lobes = (float3)(coat * (1.0f - m->metallic) + metal * m->metallic, rest * (1.0f - m->transmission), rest * m->transmission);
    const float total = lobes.x + lobes.y + lobes.z;
    return total > 0.0f ? lobes / total : (float3)(1.0f, 0.0f, 0.0f);  // a black metal seen straight on
}

// Value times cosine, and density; wi.z > 0 unless the material refracts.
INLINE float3 metallic_evaluate(const Metallic* m, float3 color, float3 wi, float3 wo, float* density) {
    *density = 0.0f;
    if (wi.z == 0.0f || wo.z == 0.0f) return (float3)(0.0f);
    const float side = wi.z > 0.0f ? 1.0f : -1.0f;
    const float3 i = wi * side, o = wo * side;  // as seen from where the light arrives
    const float3 lobes = metallic_lobes(m, color, i.z, side);
    if (o.z > 0.0f) {
        const float3 h = unit(i + o);
        const float s = schlick(inner(i, h)), coat = coat_reflectance(m, inner(i, h), side);
        const float d = ggx_d(h, m->alpha), g = ggx_g1(i, h, m->alpha);
        const float3 metal = color + (1.0f - color) * s, f = coat * (1.0f - m->metallic) + metal * m->metallic;
        *density = lobes.x * d * g / (4.0f * i.z) + lobes.y * o.z * INV_PI;
        // What the coat does not reflect on the way in and out, over its mean: white stays white (Kelemen and Szirmay-Kalos 2001,
        // doi:10.2312/egs.20011013), where the specification's 1 - F at the half vector gains a tenth at grazing angles.
        const float base = (1.0f - coat_reflectance(m, i.z, side)) * (1.0f - coat_reflectance(m, o.z, side)) / ((1.0f - m->f0) * (20.0f / 21.0f));
        return f * (d * g * ggx_g1(o, h, m->alpha) / (4.0f * i.z)) +
               color * ((1.0f - m->metallic) * (1.0f - m->transmission) * base * o.z * INV_PI);
    }
    if (m->transmission == 0.0f) return (float3)(0.0f);
    const float rest = (1.0f - m->metallic) * m->transmission;
    if (m->eta == 1.0f) {
        const float3 mirrored = (float3)(o.x, o.y, -o.z), h = unit(i + mirrored);
        const float d = ggx_d(h, m->alpha), g = ggx_g1(i, h, m->alpha), coat = coat_reflectance(m, inner(i, h), side);
        *density = lobes.z * d * g / (4.0f * i.z);
        return color * (rest * (1.0f - coat) * d * g * ggx_g1(mirrored, h, m->alpha) / (4.0f * i.z));
    }
    const float eta = side > 0.0f ? m->eta : 1.0f / m->eta;
    float3 h = i + o * eta;
    if (largest(magnitude(h)) < 1e-6f) return (float3)(0.0f);
    h = unit(h);
    if (h.z < 0.0f) h = -h;
    const float i_h = inner(i, h), o_h = inner(o, h);
    if (i_h <= 0.0f || o_h >= 0.0f) return (float3)(0.0f);
    const float coat = coat_reflectance(m, i_h, side);
    const float d = ggx_d(h, m->alpha), g = ggx_g1(i, h, m->alpha), jacobian = eta * eta * magnitude(o_h) / square(i_h + eta * o_h);
    *density = lobes.z * g * i_h * d / i.z * jacobian;
    return color * (rest * (1.0f - coat) * d * g * ggx_g1(o, h, m->alpha) * i_h * jacobian / (i.z * eta * eta));
}

// Where the path goes on (zero: nowhere), and by how much the index of refraction grows.
INLINE float3 metallic_direction(const Metallic* m, float3 color, float3 wi, float u, float v, float lobe, float* eta) {
    const float side = wi.z > 0.0f ? 1.0f : -1.0f;
    const float3 i = wi * side, lobes = metallic_lobes(m, color, i.z, side);
    *eta = 1.0f;
    if (lobe >= lobes.x && lobe < lobes.x + lobes.y) return cosine_direction(u, v) * side;
    const float3 h = ggx_normal(i, m->alpha, u, v);
    const float i_h = inner(i, h);
    const float3 mirrored = 2.0f * i_h * h - i;
    if (mirrored.z <= 0.0f && (lobe < lobes.x || m->eta == 1.0f)) return (float3)(0.0f);
    if (lobe < lobes.x) return mirrored * side;
    if (m->eta == 1.0f) return (float3)(mirrored.x, mirrored.y, -mirrored.z) * side;
    const float ratio = side > 0.0f ? m->eta : 1.0f / m->eta, squared = 1.0f - (1.0f - i_h * i_h) / square(ratio);
    if (squared <= 0.0f) return (float3)(0.0f);  // total reflection is the coat's
    *eta = ratio;
    const float3 refracted = h * (i_h / ratio - root(squared)) - i / ratio;
    return refracted.z < 0.0f ? refracted * side : (float3)(0.0f);
}

#endif

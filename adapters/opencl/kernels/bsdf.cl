// How surfaces scatter. Values hold the cosine. Transmission carries radiance, which a change of the index of refraction
// concentrates by its square (Veach 1997, section 5.2).

// Rows of a material in its table, four floats each.
// PLASTIC: diffuse light reflected back inside, weight of the coat in sampling, glTF's alpha cut-off (negative: none); METALLIC:
// metallic, roughness, transmission, scale of the normal map.
enum { COLOR_OPACITY, REFLECTANCE_ETA, TRANSMITTANCE_ALPHA, CONDUCTOR_ETA, CONDUCTOR_K, PLASTIC, METALLIC, MATERIAL_ROWS };
// Its integers.
enum { KIND, FLAGS, COLOR_TEXTURE, NORMAL_TEXTURE, METALLIC_TEXTURE, MATERIAL_INTS };
enum { TWO_SIDED = 1, CUT_OUT = 2, VERTEX_COLORS = 4, NONLINEAR = 8, THIN = 16 };

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
#if HAS_METALLIC_ROUGHNESS
    Metallic metallic;
#endif
} Bsdf;

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

#if HAS_METALLIC_ROUGHNESS
INLINE Metallic metallic_of(global const float4* rows, global const int* ints, float metallic, float roughness) {
    const float eta = rows[REFLECTANCE_ETA].w, transmission = rows[METALLIC].z;
    Metallic m;
    m.metallic = metallic;
    m.alpha = larger(roughness * roughness, 1e-3f);
    m.transmission = transmission;
    m.eta = transmission == 0.0f || (ints[FLAGS] & THIN) ? 1.0f : eta;
    m.f0 = square((eta - 1.0f) / (eta + 1.0f));
    return m;
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
#if HAS_METALLIC_ROUGHNESS
    case METALLIC_ROUGHNESS:
        if (wi.z <= 0.0f && b->metallic.transmission == 0.0f) break;
        return metallic_evaluate(&b->metallic, b->color, wi, wo, density);
#endif
    default: break;
    }
    return (float3)(0.0f);
}

// The weight of a direction whose density is set.
INLINE void weigh(Scattered* r, float3 value) {
    r->valid = r->density > 0.0f;
    r->weight = r->valid ? value / r->density : value;
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
        weigh(&r, evaluate(b, wi, r.wo, &r.density));
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
        weigh(&r, evaluate(b, wi, r.wo, &r.density));
        break;
    }
#endif
#if HAS_METALLIC_ROUGHNESS
    case METALLIC_ROUGHNESS: {
        if (wi.z == 0.0f || (wi.z < 0.0f && b->metallic.transmission == 0.0f)) break;
        r.wo = metallic_direction(&b->metallic, b->color, wi, u, v, lobe, &r.eta);
        weigh(&r, metallic_evaluate(&b->metallic, b->color, wi, r.wo, &r.density));
        break;
    }
#endif
    default: break;
    }
    return r;
}

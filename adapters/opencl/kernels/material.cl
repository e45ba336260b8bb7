// From what a material says and its textures to how a surface scatters where it was hit.

#if TEXTURES
INLINE int wrapped(int i, int size, int mode) {
    if (mode == 2) return larger(0, smaller(i, size - 1));
    const int period = mode == 1 ? 2 * size : size;
    int r = i % period;
    if (r < 0) r += period;
    return r < size ? r : period - 1 - r;
}

INLINE float4 texture(const Surfaces* g, int number, float2 uv) {
    const int4 t = g->textures[number];
    const int mode = t.w & 3;
    // Far out of [0, 1] nothing is left of the fraction, and an integer would overflow.
    const float x = limited(uv.x, -1e4f, 1e4f) * t.y, y = (1.0f - limited(uv.y, -1e4f, 1e4f)) * t.z;
    if (t.w & 4) return g->texels[t.x + wrapped((int)floor(y), t.z, mode) * t.y + wrapped((int)floor(x), t.y, mode)];
    const float fx = floor(x - 0.5f), fy = floor(y - 0.5f);
    const int x0 = wrapped((int)fx, t.y, mode), x1 = wrapped((int)fx + 1, t.y, mode);
    global const float4 *upper = g->texels + t.x + wrapped((int)fy, t.z, mode) * t.y, *lower = g->texels + t.x + wrapped((int)fy + 1, t.z, mode) * t.y;
    const float a = x - 0.5f - fx, b = y - 0.5f - fy;
    return mix(mix(upper[x0], upper[x1], a), mix(lower[x0], lower[x1], a), b);
}
#endif

#if NORMAL_MAPS
// Tilts the shading frame by a tangent-space normal map. Without a direction of u there is nothing to tilt along.
INLINE void tilt(Surface* s, float4 texel, float scale) {
    const float3 along = s->u_axis - s->n * inner(s->n, s->u_axis);
    const float most = largest(magnitude(along));
    const float3 m = (float3)((2.0f * texel.x - 1.0f) * scale, (2.0f * texel.y - 1.0f) * scale, 2.0f * texel.z - 1.0f);
    if (!(most > 0.0f && m.z > 0.0f)) return;
    const float3 u = unit(along / most), v = outer(s->n, u) * s->handed;
    s->n = unit(m.x * u + m.y * v + m.z * s->n);
    tangents(s->n, &s->s, &s->t);
}
#endif

// Base colour and alpha. Colours above 1, as textures may hold, would let paths gain energy for ever.
INLINE float4 color_at(const Surfaces* g, int material, float2 uv, float4 vertex_color) {
    float4 color = g->materials[material * MATERIAL_ROWS + COLOR_OPACITY];
    global const int* ints = g->material_ints + material * MATERIAL_INTS;
#if TEXTURES
    if (ints[COLOR_TEXTURE] >= 0) color *= texture(g, ints[COLOR_TEXTURE], uv);
#endif
#if COLORS
    if (ints[FLAGS] & VERTEX_COLORS) color *= vertex_color;
#endif
#if TEXTURES || COLORS
    color = color < 1.0f ? color : (float4)(1.0f);
#endif
    return color;
}

// The share of paths that a surface is there for.
INLINE float opacity_of(const Surfaces* g, int material, float2 uv, float4 vertex_color) {
#if HAS_CUT_OUT
    if (g->material_ints[material * MATERIAL_INTS + FLAGS] & CUT_OUT) {
        const float alpha = color_at(g, material, uv, vertex_color).w, cutoff = g->materials[material * MATERIAL_ROWS + PLASTIC].z;
        return cutoff < 0.0f ? alpha : alpha < cutoff ? 0.0f : 1.0f;
    }
#endif
    return 1.0f;
}

INLINE float4 vertex_color_of(const Surface* s) {
#if COLORS
    return s->color;
#else
    return (float4)(1.0f);
#endif
}

INLINE float opacity_at(const Surfaces* g, const Surface* s) { return opacity_of(g, s->material, s->uv, vertex_color_of(s)); }

// The scattering; turns the shading frame of a two-sided surface to where the path came from.
INLINE Bsdf bsdf_at(const Surfaces* g, Surface* s, float3 wi) {
    Bsdf b;
    b.rows = g->materials + s->material * MATERIAL_ROWS;
    global const int* ints = g->material_ints + s->material * MATERIAL_INTS;
#ifdef ONLY_KIND
    b.kind = ONLY_KIND;
#else
    b.kind = ints[KIND];
#endif
    b.nonlinear = (ints[FLAGS] & NONLINEAR) != 0;
    b.color = color_at(g, s->material, s->uv, vertex_color_of(s)).xyz;
    const bool turned = (ints[FLAGS] & TWO_SIDED) && inner(wi, s->n) < 0.0f;
#if NORMAL_MAPS
    s->smooth = s->n;
    if (ints[NORMAL_TEXTURE] >= 0) tilt(s, texture(g, ints[NORMAL_TEXTURE], s->uv), b.rows[METALLIC].w);
#endif
    if (turned) {
        s->n = -s->n;
        s->t = -s->t;
#if NORMAL_MAPS
        s->smooth = -s->smooth;
#endif
    }
#if HAS_METALLIC_ROUGHNESS
    const float4 row = b.rows[METALLIC];
    float metallic = row.x, roughness = row.y;
#if TEXTURES
    if (ints[METALLIC_TEXTURE] >= 0) {
        const float4 texel = texture(g, ints[METALLIC_TEXTURE], s->uv);
        metallic *= texel.z;
        roughness *= texel.y;
    }
#endif
    b.metallic = metallic_of(b.rows, ints, metallic, roughness);
#endif
    return b;
}

// Whether the map's normal and the surface's agree on which side a direction is.
INLINE bool same_side(const Surface* s, float3 direction, float cosine) {
#if NORMAL_MAPS
    return inner(s->smooth, direction) * cosine > 0.0f;
#else
    return true;
#endif
}

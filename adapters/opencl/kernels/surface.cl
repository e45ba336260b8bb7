// What lies where a ray hits: positions, normals, texture coordinates, material.

enum { TRIANGLE_MATERIAL = 3, TRIANGLE_LIGHT, TRIANGLE_INTS };  // after the numbers of its vertices
enum { SPHERE_MATERIAL, SPHERE_LIGHT, SPHERE_INTS };

typedef struct {
#if TRIANGLES
    global const float* vertices;
    global const int* triangles;
#if NORMALS
    global const float* normals;  // zero where a mesh has none
#endif
#if UVS
    global const float* uvs;
#endif
#if COLORS
    global const float4* colors;
#endif
#endif
#if SPHERES
    global const float4* balls;  // by number: centre, and radius (negative: the front is inside)
    global const int* ball_ints;
#endif
#if TEXTURES
    global const float4* texels;
    global const int4* textures;  // first texel, width, height, wrap and filter
#endif
    global const float4* materials;
    global const int* material_ints;
} Surfaces;

typedef struct {
    float3 p, ng, n, s, t;  // ng: geometric normal of the front; n, s, t: shading frame
    float2 uv;
#if COLORS
    float4 color;
#endif
#if NORMAL_MAPS
    float3 smooth;  // the normal without the map
    float3 u_axis;  // in which u grows
    float handed;   // 1 where v grows to the left of it, seen from the front; -1 where the texture is mirrored
#endif
    float offset;           // distance along ng that leaves the surface whatever was rounded
    int material, light;
} Surface;

#if TRIANGLES
INLINE float3 vertex(const Surfaces* g, int triangle, int corner) { return load3(g->vertices, g->triangles[triangle * TRIANGLE_INTS + corner]); }

#define ROUNDING 1e-6f  // some ulps of the numbers that a position is made of

INLINE Surface triangle_surface(const Surfaces* g, int triangle, const Ray* ray) {
    Surface s;
    global const int* ints = g->triangles + triangle * TRIANGLE_INTS;
    const float3 v0 = vertex(g, triangle, 0), v1 = vertex(g, triangle, 1), v2 = vertex(g, triangle, 2);
    const float2 b = barycentric(ray, v0, v1, v2);
    const float b0 = 1.0f - b.x - b.y;
    const float3 e1 = v1 - v0, e2 = v2 - v0;
    s.p = b0 * v0 + b.x * v1 + b.y * v2;
    const float3 sizes = magnitude(v0) + magnitude(e1) + magnitude(e2);
    s.offset = ROUNDING * larger(larger(sizes.x, sizes.y), sizes.z);
    // Edges are scaled first: the square of a tiny triangle's area underflows.
    const float3 sides = larger(magnitude(e1), magnitude(e2));
    const float scale = 1.0f / larger(larger(larger(sides.x, sides.y), sides.z), 1e-37f);
    s.ng = unit(outer(e1 * scale, e2 * scale));
    s.n = s.ng;
#if NORMALS
    const float3 n = b0 * load3(g->normals, ints[0]) + b.x * load3(g->normals, ints[1]) + b.y * load3(g->normals, ints[2]);
    const float length2 = inner(n, n);
    if (length2 > 0.0f) s.n = n / root(length2);
#endif
    s.uv = b;
#if UVS
    const float2 u0 = vload2(ints[0], g->uvs), u1 = vload2(ints[1], g->uvs), u2 = vload2(ints[2], g->uvs);
    s.uv = b0 * u0 + b.x * u1 + b.y * u2;
#if NORMAL_MAPS
    const float2 f1 = u1 - u0, f2 = u2 - u0;
    const float turn = f1.x * f2.y - f1.y * f2.x;
    s.handed = turn < 0.0f ? -1.0f : 1.0f;
    s.u_axis = turn == 0.0f ? e1 : (f2.y * e1 - f1.y * e2) * s.handed;
#endif
#endif
#if COLORS
    s.color = b0 * g->colors[ints[0]] + b.x * g->colors[ints[1]] + b.y * g->colors[ints[2]];
#endif
    s.material = ints[TRIANGLE_MATERIAL];
    s.light = ints[TRIANGLE_LIGHT];
    tangents(s.n, &s.s, &s.t);
    return s;
}
#endif

#if TRIANGLES
INLINE float2 triangle_uv(const Surfaces* g, int triangle, float b0, float b1, float b2) {
#if UVS
    global const int* ints = g->triangles + triangle * TRIANGLE_INTS;
    return b0 * vload2(ints[0], g->uvs) + b1 * vload2(ints[1], g->uvs) + b2 * vload2(ints[2], g->uvs);
#else
    return (float2)(b1, b2);
#endif
}
INLINE float4 triangle_color(const Surfaces* g, int triangle, float b0, float b1, float b2) {
#if COLORS
    global const int* ints = g->triangles + triangle * TRIANGLE_INTS;
    return b0 * g->colors[ints[0]] + b1 * g->colors[ints[1]] + b2 * g->colors[ints[2]];
#else
    return (float4)(1.0f);
#endif
}
#endif

#if SPHERES
INLINE Surface sphere_surface(const Surfaces* g, int sphere, const Ray* ray, float t) {
    Surface s;
    const float4 ball = g->balls[sphere];
    const float3 out = unit(ray->o + t * ray->d - ball.xyz);
    s.p = ball.xyz + magnitude(ball.w) * out;
    const float3 sizes = magnitude(ball.xyz) + magnitude(ball.w);
    s.offset = 4e-6f * larger(larger(sizes.x, sizes.y), sizes.z);
    s.ng = s.n = ball.w < 0.0f ? -out : out;
    s.uv = (float2)(0.0f);
#if COLORS
    s.color = (float4)(1.0f);
#endif
#if NORMAL_MAPS
    s.smooth = s.n;
    s.u_axis = (float3)(0.0f);
    s.handed = 1.0f;
#endif
    s.material = g->ball_ints[sphere * SPHERE_INTS + SPHERE_MATERIAL];
    s.light = g->ball_ints[sphere * SPHERE_INTS + SPHERE_LIGHT];
    tangents(s.n, &s.s, &s.t);
    return s;
}
#endif

INLINE Surface surface_at(const Surfaces* g, const Hit* hit, const Ray* ray) {
#if TRIANGLES && SPHERES
    if (hit->prim < TRIANGLES) return triangle_surface(g, hit->prim, ray);
    return sphere_surface(g, hit->prim - TRIANGLES, ray, hit->t);
#elif TRIANGLES
    return triangle_surface(g, hit->prim, ray);
#elif SPHERES
    return sphere_surface(g, hit->prim, ray, hit->t);
#else
    Surface nothing;  // nor is it asked for
    nothing.material = 0;
    return nothing;
#endif
}

INLINE float3 leave(const Surface* s, float3 d) { return s->p + s->ng * (inner(s->ng, d) > 0.0f ? s->offset : -s->offset); }

INLINE float3 to_local(const Surface* s, float3 d) { return (float3)(inner(d, s->s), inner(d, s->t), inner(d, s->n)); }
INLINE float3 to_world(const Surface* s, float3 d) { return d.x * s->s + d.y * s->t + d.z * s->n; }

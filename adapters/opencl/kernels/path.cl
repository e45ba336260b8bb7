// The path tracer: one work item a path. Next-event estimation and scattering are combined by the power heuristic (Veach and
// Guibas 1995, doi:10.1145/218380.218498).

INLINE float power_heuristic(float a, float b) {
    // In ratios: squares of densities overflow at mirrors that are nearly perfect.
    const float r = b / a;
    return 1.0f / (1.0f + r * r);
}

// Pairs of dimensions: 0 is the place in the pixel, 1 the one on the lens, then four for each segment.
#define LENS_PAIR 1u
#define SEGMENT_PAIRS(depth) (2u + 4u * (uint)(depth))

// Rows of the camera's table.
enum { CAMERA_ORIGIN, CAMERA_X, CAMERA_Y, CAMERA_Z, CAMERA_WINDOW, CAMERA_RANGE };

INLINE Ray camera_ray(global const float4* camera, float2 position, const Sequence* sequence) {
    Ray ray;
    const float4 window = camera[CAMERA_WINDOW], range = camera[CAMERA_RANGE];  // near, far - near, lens radius, focus distance
    float3 d = (float3)(window.x + position.x * window.z, window.y + position.y * window.w, 1.0f);
    float3 o = (float3)(0.0f);
#if THIN_LENS
    const float8 r = draws(sequence, LENS_PAIR);
    const float3 lens = cosine_direction(r.s0, r.s4);
    o = (float3)(lens.x, lens.y, 0.0f) * range.z;
    d = d - o / range.w;
#endif
    o += d * range.x;
    const float length_ = norm(d);
    const float3 x = camera[CAMERA_X].xyz, y = camera[CAMERA_Y].xyz, z = camera[CAMERA_Z].xyz;
    ray.o = camera[CAMERA_ORIGIN].xyz + o.x * x + o.y * y + o.z * z;
    ray.d = (d.x * x + d.y * y + d.z * z) / length_;
    ray.tmax = range.y * length_;
    return ray;
}

// The share of light that comes along a shadow ray. Surfaces that are cut out let theirs through where the scene says so; shadow
// rays end at them elsewhere, as they do in Mitsuba.
INLINE float visibility(const Geometry* geometry, const Surfaces* surfaces, Ray ray) {
#if ALPHA_SHADOWS
    float share = 1.0f;
    for (int layer = 0; layer < MAX_LAYERS; ++layer) {
        const Hit hit = nearest(geometry, &ray);
        if (hit.prim == NOTHING) return share;
        Surface s = surface_at(surfaces, &hit, &ray);
        share *= 1.0f - opacity_at(surfaces, &s);
        if (share <= 0.0f) return 0.0f;
        const float3 from = leave(&s, ray.d);
        ray.tmax -= inner(from - ray.o, ray.d);
        ray.o = from;
    }
    return 0.0f;
#else
    return occluded(geometry, &ray) ? 0.0f : 1.0f;
#endif
}

// What an area light that the path met sends to it, over its probability together with that of `connect` (multiple importance
// sampling). start: where the path scattered last.
INLINE float3 met_light(const Lights* lights, const Surfaces* surfaces, const Surface* s, const Hit* hit, float3 start, float3 wi, float density) {
#if TRIANGLE_LIGHTS || SPHERE_LIGHTS
    const float4 place = lights->rows[s->light * LIGHT_ROWS + LIGHT_PLACE];
    const float facing = inner(wi, s->ng);
    const float3 way = s->p - start;
    float found = 0.0f;
    bool shines = facing > 0.0f;
#if SPHERES && SPHERE_LIGHTS
    if (hit->prim >= TRIANGLES) {
        const float3 to = place.xyz - start;
        const float d2 = inner(to, to), r2 = place.w * place.w;
        found = d2 <= r2 ? inner(way, way) / (4.0f * PI * r2 * magnitude(facing)) : 1.0f / (2.0f * PI * cone(r2 / d2));
    }
#endif
#if TRIANGLE_LIGHTS
    if (hit->prim < TRIANGLES) {
        if (place.w != 0.0f) shines = facing != 0.0f;
        const float3 v0 = vertex(surfaces, hit->prim, 0), n = outer(vertex(surfaces, hit->prim, 1) - v0, vertex(surfaces, hit->prim, 2) - v0);
        found = 2.0f * inner(way, way) / (magnitude(facing) * norm(n));
    }
#endif
    if (shines) {
        const float weight = density > 0.0f ? power_heuristic(density, area_density(lights, s->light, found)) : 1.0f;
        return emitted(lights, surfaces, s->light, s->uv) * weight;
    }
#endif
    return (float3)(0.0f);
}

INLINE float3 radiance(global const float4* camera, float2 position, Sequence sequence, const Geometry* geometry, const Surfaces* surfaces,
                       const Lights* lights) {
    float3 sum = (float3)(0.0f), throughput = (float3)(1.0f);
    float density = 0.0f;  // of the direction that scattering chose; 0 where only scattering finds what lies there
    float eta = 1.0f;
    Ray ray = camera_ray(camera, position, &sequence);
    float3 start = ray.o;  // where the path scattered last, which is not where it passed a cut-out
    int depth = 0;         // segments that count
    for (int segment = 0; segment < MAX_SEGMENTS; ++segment) {
        const Hit hit = nearest(geometry, &ray);
        if (hit.prim == NOTHING) {
#if ENVIRONMENT
            if (depth == 0 && HIDE_EMITTERS) break;
            float found;
            const float3 seen = environment(lights, ray.d, &found);
            found *= lights->rows[(LIGHTS - 1) * LIGHT_ROWS].w;
            sum += throughput * seen * (density > 0.0f ? power_heuristic(density, found) : 1.0f);
#endif
            break;
        }
        Surface s = surface_at(surfaces, &hit, &ray);
        if (!(inner(s.ng, s.ng) > 0.5f)) break;  // a triangle that has an area to the host and none here
        const float3 wi = -ray.d;
        float opacity = 1.0f;
#if ALPHA_SHADOWS
        opacity = opacity_at(surfaces, &s);
#endif
        if (s.light >= 0) {
#if HIDE_EMITTERS
            if (depth == 0) {  // the camera looks through them
                ray.o = start = leave(&s, ray.d);
                ray.tmax -= hit.t;
                continue;
            }
#endif
            sum += throughput * met_light(lights, surfaces, &s, &hit, start, wi, density) * opacity;
        }
#if !ALPHA_SHADOWS
        if (depth + 1 >= MAX_DEPTH) break;
#endif
        const uint8 w = words(&sequence, SEGMENT_PAIRS(segment));
        const float8 r = uniform_of(w);
#if HAS_CUT_OUT
#if !ALPHA_SHADOWS
        opacity = opacity_at(surfaces, &s);
        const int counts = 1;
#else
        const int counts = 0;
#endif
        if (r.s7 >= opacity) {  // straight through, as by an interface that is not there
            ray.o = leave(&s, ray.d);
            ray.tmax = INFINITY;
            depth += counts;
            if (counts) density = 0.0f;
            continue;
        }
#endif
        if (depth + 1 >= MAX_DEPTH) break;
        const Bsdf bsdf = bsdf_at(surfaces, &s, wi);
        const float3 wi_local = to_local(&s, wi);
#if LIGHTS
#if HAS_DELTA
        if (bsdf.kind != DIELECTRIC && bsdf.kind != CONDUCTOR)
#endif
        {
            const Connection c = connect(lights, surfaces, s.p, w.s0, w.s4, w.s2);
            if (largest(c.radiance) > 0.0f) {
                float other;
                const float3 value = evaluate(&bsdf, wi_local, to_local(&s, c.d), &other);
                if (largest(value) > 0.0f && same_side(&s, c.d, inner(c.d, s.n))) {
                    const float weight = c.density > 0.0f ? power_heuristic(c.density, other) : 1.0f;
                    Ray shadow;
                    shadow.o = leave(&s, c.d);
                    // Towards the point on the light from where the ray starts, not from the surface: a light that is seen edge on
                    // would else be met in another place, and shadow itself. The far end stays clear of it by rounding.
                    const float3 to = isinf(c.distance) ? c.d : (s.p - shadow.o) + c.distance * c.d;
                    const float length_ = norm(to);
                    shadow.d = to / length_;
                    shadow.tmax = isinf(c.distance) ? INFINITY : length_ * (1.0f - 1e-4f);
                    const float seen = visibility(geometry, surfaces, shadow);
                    if (seen > 0.0f) sum += throughput * value * c.radiance * (weight * seen);
                }
            }
        }
#endif
        const Scattered next = scatter(&bsdf, wi_local, r.s1, r.s5, r.s6);
        if (!next.valid) break;
        throughput *= next.weight;
        density = next.density;
        eta *= next.eta;
        ray.d = unit(to_world(&s, next.wo));
        if (!same_side(&s, ray.d, next.wo.z)) break;
        ray.o = start = leave(&s, ray.d);
        ray.tmax = INFINITY;
        const float most = largest(throughput);
        if (!(most > 0.0f)) break;
        if (++depth >= RR_DEPTH) {
            const float survival = smaller(most * eta * eta, 0.95f);
            if (r.s3 >= survival) break;
            throughput /= survival;
        }
    }
    return sum;
}

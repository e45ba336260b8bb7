// Nearest hit and occlusion: every packet in turn where there are few, a hierarchy of boxes with eight children where not.

typedef struct {
#if TRIANGLES
    global const float8* triangles;  // packets: 3 vertices of 3 coordinates each
    global const int* triangle_order;
#endif
#if TRIANGLE_NODES
    global const float8* triangle_bounds;
    global const int* triangle_children;
#endif
#if SPHERES
    global const float8* spheres;
    global const int* sphere_order;
#endif
#if SPHERE_NODES
    global const float8* sphere_bounds;
    global const int* sphere_children;
#endif
} Geometry;

typedef union {
    float8 all;
    float one[8];
} Lanes;

// Of a packet's hits, the nearest one, if it is nearer than what is known.
#define NEAREST_LANE(mask, distance, hit, order, packet, base)                            \
    uint found = lanes(mask);                                                             \
    if (found) {                                                                          \
        Lanes each;                                                                    \
        each.all = distance;                                                       \
        for (; found; found &= found - 1u) {                                              \
            const int lane = lowest(found);                                               \
            if (each.one[lane] < hit->t) {                                                    \
                hit->t = each.one[lane];                                                      \
                hit->prim = (base) + (order)[(packet) * 8 + lane];                        \
            }                                                                             \
        }                                                                                 \
    }

#if TRIANGLE_NODES || SPHERE_NODES
// Children of a node that the ray meets before tmax, and where it enters each. Zero directions are made tiny, so that no
// infinity meets a zero; the factor keeps rounding from losing a box (Ize 2013, "Robust BVH ray traversal", JCGT 2(2)).
INLINE uint boxes(const Ray* ray, float3 inverse, global const float8* b, float tmax, float8* entry) {
    const float8 x0 = (b[0] - ray->o.x) * inverse.x, x1 = (b[3] - ray->o.x) * inverse.x;
    const float8 y0 = (b[1] - ray->o.y) * inverse.y, y1 = (b[4] - ray->o.y) * inverse.y;
    const float8 z0 = (b[2] - ray->o.z) * inverse.z, z1 = (b[5] - ray->o.z) * inverse.z;
    const float8 near = larger(larger(smaller(x0, x1), smaller(y0, y1)), larger(smaller(z0, z1), 0.0f));
    const float8 far = smaller(smaller(larger(x0, x1), larger(y0, y1)), smaller(larger(z0, z1), tmax));
    *entry = near;
    return lanes((near <= far * 1.0000005f) & (b[0] <= b[3]));
}

INLINE float3 inverse_direction(float3 d) {
    const float3 tiny = d < 0.0f ? (float3)(-1e-18f) : (float3)(1e-18f);
    return 1.0f / (magnitude(d) < 1e-18f ? tiny : d);
}

// Walks a hierarchy; LEAF is done for every packet of the leaves, and may shrink `limit` or leave the loop by `done`.
#define WALK(ray, bounds, children, limit, LEAF)                                                     \
    const float3 inverse = inverse_direction((ray)->d);                                              \
    int stack[STACK];                                                                                \
    float entries[STACK];                                                                            \
    int top = 1;                                                                                     \
    bool done = false;                                                                               \
    stack[0] = 0;                                                                                    \
    entries[0] = 0.0f;                                                                               \
    while (top > 0 && !done) {                                                                       \
        const int node = stack[--top];                                                               \
        if (entries[top] > (limit)) continue;                                                        \
        if (node >= 0) {                                                                             \
            float8 entry;                                                                            \
            uint met = boxes((ray), inverse, (bounds) + node * 6, (limit), &entry);                  \
            Lanes each;                                                                           \
            each.all = entry;                                                                 \
            const int floor_ = top;                                                                  \
            for (; met; met &= met - 1u) {                                                           \
                const int lane = lowest(met);                                                        \
                int place = top++;                                                                   \
                for (; place > floor_ && entries[place - 1] < each.one[lane]; --place) {                 \
                    entries[place] = entries[place - 1];                                             \
                    stack[place] = stack[place - 1];                                                 \
                }                                                                                    \
                entries[place] = each.one[lane];                                                         \
                stack[place] = (children)[node * 8 + lane];                                          \
            }                                                                                        \
        } else {                                                                                     \
            const int code = -1 - node, last = (code >> 3) + (code & 7);                             \
            for (int packet = code >> 3; packet <= last && !done; ++packet) {                        \
                LEAF                                                                                 \
            }                                                                                        \
        }                                                                                            \
    }
#endif

INLINE void nearest_triangle(const Geometry* g, const Ray* ray, Hit* hit) {
#if TRIANGLES
    const Shear s = shear(ray);
#if TRIANGLE_NODES
    WALK(ray, g->triangle_bounds, g->triangle_children, hit->t, {
        float8 t;
        const int8 mask = triangle_packet(&s, g->triangles + packet * 9, (float8)(hit->t), &t);
        NEAREST_LANE(mask, t, hit, g->triangle_order, packet, 0)
    })
#else
    // Each lane keeps its own nearest; they are compared once.
    float8 nearest = (float8)(hit->t);
    int8 of = (int8)(-1);
    for (int packet = 0; packet < TRIANGLE_PACKETS; ++packet) {
        float8 t;
        const int8 mask = triangle_packet(&s, g->triangles + packet * 9, nearest, &t);
        nearest = mask ? t : nearest;
        of = mask ? (int8)(packet) : of;
    }
    uint found = lanes(of >= 0);
    Lanes each;
    each.all = nearest;
    int packets[8];
    vstore8(of, 0, packets);
    for (; found; found &= found - 1u) {
        const int lane = lowest(found);
        if (each.one[lane] < hit->t) {
            hit->t = each.one[lane];
            hit->prim = g->triangle_order[packets[lane] * 8 + lane];
        }
    }
#endif
#endif
}

INLINE void nearest_sphere(const Geometry* g, const Ray* ray, Hit* hit) {
#if SPHERES
#if SPHERE_NODES
    WALK(ray, g->sphere_bounds, g->sphere_children, hit->t, {
        float8 t;
        const int8 mask = sphere_packet(ray, g->spheres + packet * 4, (float8)(hit->t), &t);
        NEAREST_LANE(mask, t, hit, g->sphere_order, packet, TRIANGLES)
    })
#else
    for (int packet = 0; packet < SPHERE_PACKETS; ++packet) {
        float8 t;
        const int8 mask = sphere_packet(ray, g->spheres + packet * 4, (float8)(hit->t), &t);
        NEAREST_LANE(mask, t, hit, g->sphere_order, packet, TRIANGLES)
    }
#endif
#endif
}

INLINE bool triangle_between(const Geometry* g, const Ray* ray) {
#if TRIANGLES
    const Shear s = shear(ray);
    float8 t;
#if TRIANGLE_NODES
    WALK(ray, g->triangle_bounds, g->triangle_children, ray->tmax,
         { done = lanes(triangle_packet(&s, g->triangles + packet * 9, (float8)(ray->tmax), &t)) != 0u; })
    return done;
#else
    int8 any_lane = (int8)(0);
    for (int packet = 0; packet < TRIANGLE_PACKETS; ++packet)
        any_lane |= triangle_packet(&s, g->triangles + packet * 9, (float8)(ray->tmax), &t);
    return lanes(any_lane) != 0u;
#endif
#else
    return false;
#endif
}

INLINE bool sphere_between(const Geometry* g, const Ray* ray) {
#if SPHERES
    float8 t;
#if SPHERE_NODES
    WALK(ray, g->sphere_bounds, g->sphere_children, ray->tmax,
         { done = lanes(sphere_packet(ray, g->spheres + packet * 4, (float8)(ray->tmax), &t)) != 0u; })
    return done;
#else
    int8 any_lane = (int8)(0);
    for (int packet = 0; packet < SPHERE_PACKETS; ++packet) any_lane |= sphere_packet(ray, g->spheres + packet * 4, (float8)(ray->tmax), &t);
    return lanes(any_lane) != 0u;
#endif
#else
    return false;
#endif
}

INLINE Hit nearest(const Geometry* g, const Ray* ray) {
    Hit hit = {ray->tmax, NOTHING};
    nearest_triangle(g, ray, &hit);
    nearest_sphere(g, ray, &hit);
    return hit;
}

INLINE bool occluded(const Geometry* g, const Ray* ray) { return triangle_between(g, ray) || sphere_between(g, ray); }

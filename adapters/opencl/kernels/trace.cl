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

// The nearest of a packet's hits, by halves.
#define NEAREST_LANE(mask, distance, hit, order, packet, base)                            \
    uint found = lanes(mask);                                                             \
    if (found) {                                                                          \
        float each[8];                                                                    \
        vstore8(distance, 0, each);                                                       \
        for (; found; found &= found - 1u) {                                              \
            const int lane = lowest(found);                                               \
            if (each[lane] < hit->t) {                                                    \
                hit->t = each[lane];                                                      \
                hit->prim = (base) + (order)[(packet) * 8 + lane];                        \
            }                                                                             \
        }                                                                                 \
    }

#if TRIANGLE_NODES || SPHERE_NODES
// Children of a node that the ray meets before tmax, and where it enters each. Zero directions are made tiny, so that no
// infinity meets a zero; the factor keeps rounding from losing a box (Ize 2013, "Robust BVH ray traversal", JCGT 2(2)).
uint boxes(const Ray* ray, float3 inverse, global const float8* b, float tmax, float8* entry) {
    const float8 x0 = (b[0] - ray->o.x) * inverse.x, x1 = (b[3] - ray->o.x) * inverse.x;
    const float8 y0 = (b[1] - ray->o.y) * inverse.y, y1 = (b[4] - ray->o.y) * inverse.y;
    const float8 z0 = (b[2] - ray->o.z) * inverse.z, z1 = (b[5] - ray->o.z) * inverse.z;
    const float8 near = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), 0.0f));
    const float8 far = min(min(max(x0, x1), max(y0, y1)), min(max(z0, z1), tmax));
    *entry = near;
    return lanes((near <= far * 1.0000005f) & (b[0] <= b[3]));
}

float3 inverse_direction(float3 d) {
    const float3 tiny = copysign((float3)(1e-18f), d);
    return 1.0f / select(d, tiny, fabs(d) < 1e-18f);
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
            float each[8];                                                                           \
            vstore8(entry, 0, each);                                                                 \
            const int floor_ = top;                                                                  \
            for (; met; met &= met - 1u) {                                                           \
                const int lane = lowest(met);                                                        \
                int place = top++;                                                                   \
                for (; place > floor_ && entries[place - 1] < each[lane]; --place) {                 \
                    entries[place] = entries[place - 1];                                             \
                    stack[place] = stack[place - 1];                                                 \
                }                                                                                    \
                entries[place] = each[lane];                                                         \
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

void nearest_triangle(const Geometry* g, const Ray* ray, Hit* hit) {
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
        nearest = select(nearest, t, mask);
        of = select(of, (int8)(packet), mask);
    }
    uint found = lanes(of >= 0);
    float each[8];
    int packets[8];
    vstore8(nearest, 0, each);
    vstore8(of, 0, packets);
    for (; found; found &= found - 1u) {
        const int lane = lowest(found);
        if (each[lane] < hit->t) {
            hit->t = each[lane];
            hit->prim = g->triangle_order[packets[lane] * 8 + lane];
        }
    }
#endif
#endif
}

void nearest_sphere(const Geometry* g, const Ray* ray, Hit* hit) {
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

bool triangle_between(const Geometry* g, const Ray* ray) {
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

bool sphere_between(const Geometry* g, const Ray* ray) {
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

Hit nearest(const Geometry* g, const Ray* ray) {
    Hit hit = {ray->tmax, NOTHING};
    nearest_triangle(g, ray, &hit);
    nearest_sphere(g, ray, &hit);
    return hit;
}

bool occluded(const Geometry* g, const Ray* ray) { return triangle_between(g, ray) || sphere_between(g, ray); }

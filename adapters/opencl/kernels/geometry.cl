// Frames, offsets and the intersection of rays with packets of eight triangles or spheres.

typedef struct {
    float3 o, d;  // d is a unit vector
    float tmax;
} Ray;

#define NOTHING (-1)

typedef struct {
    float t;
    int prim;  // a triangle's number, or TRIANGLES + a sphere's; NOTHING
} Hit;

#if TRIANGLES
// Woop, Benthin and Wald 2013, "Watertight ray/triangle intersection", JCGT 2(1): vertices are sheared so that the ray is the z
// axis. A rounded edge function has the right sign or is zero, and zero counts as inside, so that no ray slips between
// triangles; products must not be fused into sums, or two triangles would disagree about their common edge.
typedef struct {
    int kx, ky, kz;
    float sx, sy, sz, ox, oy, oz;
} Shear;

INLINE Shear shear(const Ray* ray) {
    Shear s;
    const float3 a = magnitude(ray->d);
    s.kz = a.x > a.y ? (a.x > a.z ? 0 : 2) : (a.y > a.z ? 1 : 2);
    s.kx = s.kz == 2 ? 0 : s.kz + 1;
    s.ky = s.kx == 2 ? 0 : s.kx + 1;
    s.sz = 1.0f / component(ray->d, s.kz);
    s.sx = component(ray->d, s.kx) * s.sz;
    s.sy = component(ray->d, s.ky) * s.sz;
    s.ox = component(ray->o, s.kx);
    s.oy = component(ray->o, s.ky);
    s.oz = component(ray->o, s.kz);
    return s;
}

// Which lanes of a packet the ray hits nearer than tmax, and how far away.
INLINE int8 triangle_packet(const Shear* s, global const float8* v, float8 tmax, float8* distance) {
    const float8 az = v[s->kz] - s->oz, bz = v[3 + s->kz] - s->oz, cz = v[6 + s->kz] - s->oz;
    const float8 ax = (v[s->kx] - s->ox) - s->sx * az, ay = (v[s->ky] - s->oy) - s->sy * az;
    const float8 bx = (v[3 + s->kx] - s->ox) - s->sx * bz, by = (v[3 + s->ky] - s->oy) - s->sy * bz;
    const float8 cx = (v[6 + s->kx] - s->ox) - s->sx * cz, cy = (v[6 + s->ky] - s->oy) - s->sy * cz;
    const float8 u = cx * by - cy * bx, w = bx * ay - by * ax, q = ax * cy - ay * cx;
    const float8 det = u + q + w;
    const float8 t = s->sz * (u * az + q * bz + w * cz) / det;
    *distance = t;
    const float8 low = smaller(smaller(u, q), w), high = larger(larger(u, q), w);
    return ((low >= 0.0f) | (high <= 0.0f)) & (det != 0.0f) & (t > 0.0f) & (t < tmax);
}

// Barycentric coordinates of the second and the third vertex.
INLINE float2 barycentric(const Ray* ray, float3 v0, float3 v1, float3 v2) {
    const Shear s = shear(ray);
    const float3 a = v0 - ray->o, b = v1 - ray->o, c = v2 - ray->o;
    const float az = component(a, s.kz), bz = component(b, s.kz), cz = component(c, s.kz);
    const float ax = component(a, s.kx) - s.sx * az, ay = component(a, s.ky) - s.sy * az;
    const float bx = component(b, s.kx) - s.sx * bz, by = component(b, s.ky) - s.sy * bz;
    const float cx = component(c, s.kx) - s.sx * cz, cy = component(c, s.ky) - s.sy * cz;
    const float u = cx * by - cy * bx, w = bx * ay - by * ax, q = ax * cy - ay * cx;
    const float det = u + q + w;
    return (float2)(q / det, w / det);
}
#endif

#if SPHERES
// Haines et al. 2019, "Precision improvements for ray/sphere intersection", Ray Tracing Gems chapter 7. A packet holds the
// centres' x, y and z and the radii; a padding lane has the radius 0.
INLINE int8 sphere_packet(const Ray* ray, global const float8* v, float8 tmax, float8* distance) {
    const float8 fx = ray->o.x - v[0], fy = ray->o.y - v[1], fz = ray->o.z - v[2], r = v[3];
    const float8 b = -(fx * ray->d.x + fy * ray->d.y + fz * ray->d.z);
    const float8 lx = fx + b * ray->d.x, ly = fy + b * ray->d.y, lz = fz + b * ray->d.z;
    const float8 rest = r * r - (lx * lx + ly * ly + lz * lz);
    const float8 reach = sqrt(larger(rest, 0.0f));
    const float8 q = b + (b < 0.0f ? -reach : reach);
    const float8 c = fx * fx + fy * fy + fz * fz - r * r;
    const float8 t0 = q != 0.0f ? c / q : q, low = smaller(t0, q), high = larger(t0, q);
    const float8 t = low > 0.0f ? low : high;
    *distance = t;
    return (rest >= 0.0f) & (r > 0.0f) & (t > 0.0f) & (t < tmax);
}
#endif

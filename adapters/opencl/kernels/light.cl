// Lights: which one a path connects to, where on it, and the densities of both. A light is a row of the table; an area light is a
// triangle or a sphere of its own. One is chosen in proportion to its power, by Walker's alias method.

enum { LIGHT_RADIANCE, LIGHT_PLACE, LIGHT_ROWS };  // rgb and probability; position or direction and radius
enum { LIGHT_KIND, LIGHT_PRIM, LIGHT_ALIAS, LIGHT_TEXTURE, LIGHT_INTS };
enum { LIGHT_TRIANGLE, LIGHT_SPHERE, LIGHT_POINT, LIGHT_DIRECTIONAL, LIGHT_ENVIRONMENT };

typedef struct {
    global const float4* rows;
    global const int* ints;
    global const float* thresholds;  // of the alias table
#if ENVIRONMENT == 2
    global const float4* map;         // ENVIRONMENT_HEIGHT rows of ENVIRONMENT_WIDTH + 1 nodes: radiance
    // A row of cells is drawn, then a cell of it: a path has 32 bits for each, and a large map has more cells than numbers.
    global const float2* cells;       // ENVIRONMENT_HEIGHT - 1 rows of ENVIRONMENT_WIDTH: probability, alias threshold in the row
    global const int* cell_aliases;
    global const float* bands;        // alias thresholds of the rows
    global const int* band_aliases;
#endif
} Lights;

typedef struct {
    float3 d;         // unit vector towards the light
    float distance;
    float3 radiance;  // over the density, which is per solid angle
    float density;    // 0 for a light at a point or in one direction: no other strategy finds it
} Connection;

#if ENVIRONMENT
// Into the map's frame, whose y is up, and to its nodes: column j lies at u = (j + 1/2) / width, row i at v = i / (height - 1).
INLINE float2 environment_place(float3 d) {
    const float3 l = (float3)(inner(d, (float3)(ENVIRONMENT_X)), inner(d, (float3)(ENVIRONMENT_Y)), inner(d, (float3)(ENVIRONMENT_Z)));
    const float u = atan2(l.x, -l.z) * (0.5f * INV_PI), v = acos(limited(l.y, -1.0f, 1.0f)) * INV_PI;
    return (float2)(u - floor(u), v);
}
#endif

INLINE float3 environment(const Lights* lights, float3 d, float* density) {
#if ENVIRONMENT == 1
    *density = 0.25f * INV_PI;
    return (float3)(ENVIRONMENT_RADIANCE);
#elif ENVIRONMENT == 2
    const float2 place = environment_place(d);
    float x = place.x - 0.5f / ENVIRONMENT_WIDTH;
    x = (x - floor(x)) * ENVIRONMENT_WIDTH;
    const float y = place.y * (ENVIRONMENT_HEIGHT - 1);
    const int j = larger(0, smaller((int)x, ENVIRONMENT_WIDTH - 1)), i = larger(0, smaller((int)y, ENVIRONMENT_HEIGHT - 2));
    global const float4* node = lights->map + i * (ENVIRONMENT_WIDTH + 1) + j;
    const float4 upper = mix(node[0], node[1], x - j), lower = mix(node[ENVIRONMENT_WIDTH + 1], node[ENVIRONMENT_WIDTH + 2], x - j);
    const float sine = root(larger(1.0f - square(inner(d, (float3)(ENVIRONMENT_Y))), 1e-12f));
    *density = lights->cells[i * ENVIRONMENT_WIDTH + j].x * (float)(ENVIRONMENT_WIDTH * (ENVIRONMENT_HEIGHT - 1)) / (2.0f * PI * PI * sine);
    return mix(upper, lower, y - i).xyz;
#else
    *density = 0.0f;
    return (float3)(0.0f);
#endif
}

#if LIGHTS
// What an area light sends out at a point of it.
INLINE float3 emitted(const Lights* lights, const Surfaces* surfaces, int light, float2 uv) {
    const float3 radiance = lights->rows[light * LIGHT_ROWS].xyz;
#if EMISSION_TEXTURES
    const int number = lights->ints[light * LIGHT_INTS + LIGHT_TEXTURE];
    if (number >= 0) return radiance * texture(surfaces, number, uv).xyz;
#endif
    return radiance;
}

// Density per solid angle with which `connect` finds a point of an area light, its choice included.
INLINE float area_density(const Lights* lights, int light, float density) { return lights->rows[light * LIGHT_ROWS].w * density; }

// Of a sphere, from outside: uniform in the cone that it fills; 1 - cos_max without cancellation.
INLINE float cone(float ratio2) { return ratio2 / (1.0f + root(larger(0.0f, 1.0f - ratio2))); }

INLINE Connection connect(const Lights* lights, const Surfaces* surfaces, float3 p, uint u_word, uint v_word, uint choice) {
    Connection c;
    int light;
    float rest;
    split(choice, LIGHTS, &light, &rest);
    if (rest >= lights->thresholds[light]) light = lights->ints[light * LIGHT_INTS + LIGHT_ALIAS];
    const float u = (float)(u_word >> 8) * 0x1p-24f, v = (float)(v_word >> 8) * 0x1p-24f;
    const float4 radiance = lights->rows[light * LIGHT_ROWS], place = lights->rows[light * LIGHT_ROWS + LIGHT_PLACE];
    const int prim = lights->ints[light * LIGHT_INTS + LIGHT_PRIM];
    c.radiance = radiance.xyz / radiance.w;
    c.distance = INFINITY;
    c.density = 0.0f;
    switch (lights->ints[light * LIGHT_INTS + LIGHT_KIND]) {
#if TRIANGLE_LIGHTS
    case LIGHT_TRIANGLE: {
        const float side = root(u), b1 = 1.0f - side, b2 = v * side;
        const float3 v0 = vertex(surfaces, prim, 0), e1 = vertex(surfaces, prim, 1) - v0, e2 = vertex(surfaces, prim, 2) - v0;
        const float3 n = outer(e1, e2), to = v0 + b1 * e1 + b2 * e2 - p;
        const float d2 = inner(to, to), cosine = -inner(n, to);  // both times their lengths
        c.distance = root(d2);
        c.d = to / c.distance;
        const bool seen = (place.w != 0.0f ? magnitude(cosine) : cosine) > 0.0f && d2 > 0.0f;
        const float density = d2 * c.distance * 2.0f / magnitude(cosine);  // |n| = 2 area cancels
        c.density = seen ? area_density(lights, light, density) : 0.0f;
        const float2 uv = triangle_uv(surfaces, prim, 1.0f - b1 - b2, b1, b2);
        float3 shone = emitted(lights, surfaces, light, uv);
#if ALPHA_SHADOWS
        shone *= opacity_of(surfaces, surfaces->triangles[prim * TRIANGLE_INTS + TRIANGLE_MATERIAL], uv,
                            triangle_color(surfaces, prim, 1.0f - b1 - b2, b1, b2));
#endif
        c.radiance = seen ? shone / c.density : (float3)(0.0f);
        break;
    }
#endif
#if SPHERE_LIGHTS
    case LIGHT_SPHERE: {
        const float3 to = place.xyz - p;
        const float d2 = inner(to, to), r2 = place.w * place.w;
        if (d2 <= r2) {  // from inside: uniform on the sphere
            const float z = 1.0f - 2.0f * u, r = root(larger(0.0f, 1.0f - z * z));
            const float2 around = circle(v) * r;
            const float3 n = (float3)(around, z), line = to + magnitude(place.w) * n;
            const float l2 = inner(line, line);
            c.distance = root(l2);
            c.d = line / c.distance;
            const float facing = place.w < 0.0f ? inner(n, c.d) : 0.0f;
            c.density = facing > 0.0f ? area_density(lights, light, l2 / (4.0f * PI * r2 * facing)) : 0.0f;
        } else if (place.w > 0.0f) {
            const float rest = cone(r2 / d2), less = u * rest, sine2 = less * (2.0f - less), cosine = 1.0f - less;
            float3 s, t;
            const float3 axis = to / root(d2);
            tangents(axis, &s, &t);
            const float2 around = circle(v) * root(sine2);
            c.d = unit(around.x * s + around.y * t + cosine * axis);
            const float along = inner(to, c.d);
            c.distance = along - root(larger(0.0f, r2 - (d2 - along * along)));
            c.density = area_density(lights, light, 1.0f / (2.0f * PI * rest));
        }
        c.radiance = c.density > 0.0f ? radiance.xyz / c.density : (float3)(0.0f);
        break;
    }
#endif
#if POINT_LIGHTS
    case LIGHT_POINT: {
        const float3 to = place.xyz - p;
        const float d2 = inner(to, to);
        c.distance = root(d2);
        c.d = to / c.distance;
        c.radiance = d2 > 0.0f ? c.radiance / d2 : (float3)(0.0f);
        break;
    }
#endif
#if DIRECTIONAL_LIGHTS
    case LIGHT_DIRECTIONAL: c.d = place.xyz; break;
#endif
#if ENVIRONMENT == 1
    case LIGHT_ENVIRONMENT: {
        const float z = 1.0f - 2.0f * u, r = root(larger(0.0f, 1.0f - z * z));
        c.d = (float3)(circle(v) * r, z);
        c.density = radiance.w * 0.25f * INV_PI;
        c.radiance = (float3)(ENVIRONMENT_RADIANCE) / c.density;
        break;
    }
#elif ENVIRONMENT == 2
    case LIGHT_ENVIRONMENT: {
        int row, column;
        float down, along;
        split(v_word, ENVIRONMENT_HEIGHT - 1, &row, &down);
        const float band = lights->bands[row];
        if (down >= band) {
            down = (down - band) / (1.0f - band);
            row = lights->band_aliases[row];
        } else {
            down /= band;
        }
        split(u_word, ENVIRONMENT_WIDTH, &column, &along);
        const int drawn = row * ENVIRONMENT_WIDTH + column;
        const float threshold = lights->cells[drawn].y;
        if (along >= threshold) {
            along = (along - threshold) / (1.0f - threshold);
            column = lights->cell_aliases[drawn];
        } else {
            along /= threshold;
        }
        const float x = (column + 0.5f + limited(along, 0.0f, 1.0f)) / ENVIRONMENT_WIDTH;
        const float y = (row + limited(down, 0.0f, 1.0f)) / (ENVIRONMENT_HEIGHT - 1);
        const float2 phi = circle(x - floor(x)), theta = circle(0.5f * y);
        const float3 l = (float3)(phi.y * theta.y, theta.x, -phi.x * theta.y);
        c.d = l.x * (float3)(ENVIRONMENT_X) + l.y * (float3)(ENVIRONMENT_Y) + l.z * (float3)(ENVIRONMENT_Z);
        float density;
        const float3 seen = environment(lights, c.d, &density);
        c.density = radiance.w * density;
        c.radiance = c.density > 0.0f ? seen / c.density : (float3)(0.0f);
        break;
    }
#endif
    default: c.radiance = (float3)(0.0f);
    }
    return c;
}
#endif

// The kernel. What a scene does not have is left out of its arguments too; tables.py lists the arrays in this order.

kernel void render(uint count, global const float2* positions, global const uint* scramble, global const uint* index,
                   global float* out, global const float4* camera, global const float4* materials, global const int* material_ints
#if TRIANGLES
                   , global const float8* triangle_packets, global const int* triangle_order, global const float* vertices, global const int* triangles
#endif
#if TRIANGLE_NODES
                   , global const float8* triangle_bounds, global const int* triangle_children
#endif
#if NORMALS
                   , global const float* normals
#endif
#if UVS
                   , global const float* uvs
#endif
#if COLORS
                   , global const float4* colors
#endif
#if SPHERES
                   , global const float8* sphere_packets, global const int* sphere_order, global const float4* balls, global const int* ball_ints
#endif
#if SPHERE_NODES
                   , global const float8* sphere_bounds, global const int* sphere_children
#endif
#if TEXTURES
                   , global const float4* texels, global const int4* textures
#endif
#if LIGHTS
                   , global const float4* light_rows, global const int* light_ints, global const float* light_thresholds
#endif
#if ENVIRONMENT == 2
                   , global const float4* environment_map, global const float2* environment_cells, global const int* environment_aliases,
                   global const float* environment_bands, global const int* environment_band_aliases
#endif
) {
    const uint i = get_global_id(0);
    if (i >= count) return;
    Geometry geometry;
    Surfaces surfaces;
    Lights lights;
    surfaces.materials = materials;
    surfaces.material_ints = material_ints;
#if TRIANGLES
    geometry.triangles = triangle_packets;
    geometry.triangle_order = triangle_order;
    surfaces.vertices = vertices;
    surfaces.triangles = triangles;
#endif
#if TRIANGLE_NODES
    geometry.triangle_bounds = triangle_bounds;
    geometry.triangle_children = triangle_children;
#endif
#if NORMALS
    surfaces.normals = normals;
#endif
#if UVS
    surfaces.uvs = uvs;
#endif
#if COLORS
    surfaces.colors = colors;
#endif
#if SPHERES
    geometry.spheres = sphere_packets;
    geometry.sphere_order = sphere_order;
    surfaces.balls = balls;
    surfaces.ball_ints = ball_ints;
#endif
#if SPHERE_NODES
    geometry.sphere_bounds = sphere_bounds;
    geometry.sphere_children = sphere_children;
#endif
#if TEXTURES
    surfaces.texels = texels;
    surfaces.textures = textures;
#endif
#if LIGHTS
    lights.rows = light_rows;
    lights.ints = light_ints;
    lights.thresholds = light_thresholds;
#endif
#if ENVIRONMENT == 2
    lights.map = environment_map;
    lights.cells = environment_cells;
    lights.cell_aliases = environment_aliases;
    lights.bands = environment_bands;
    lights.band_aliases = environment_band_aliases;
#endif
    const float3 value = radiance(camera, positions[i], sequence(scramble[i], index[i]), &geometry, &surfaces, &lights);
    out[3 * i] = value.x;
    out[3 * i + 1] = value.y;
    out[3 * i + 2] = value.z;
}

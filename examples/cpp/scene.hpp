// A path tracer as small as it can be and still have what makes sampling hard: a room with soft shadows from an area light, a
// mirror ball, and a glass ball whose caustic is found by chance alone.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>

namespace scene {

constexpr float pi = 3.14159265f, far_away = std::numeric_limits<float>::infinity(), nudge = 1e-4f;

struct Vec {
    float x = 0, y = 0, z = 0;
    Vec operator+(const Vec& b) const { return {x + b.x, y + b.y, z + b.z}; }
    Vec operator-(const Vec& b) const { return {x - b.x, y - b.y, z - b.z}; }
    Vec operator*(const Vec& b) const { return {x * b.x, y * b.y, z * b.z}; }
    Vec operator*(float s) const { return {x * s, y * s, z * s}; }
    float dot(const Vec& b) const { return x * b.x + y * b.y + z * b.z; }
    Vec cross(const Vec& b) const { return {y * b.z - z * b.y, z * b.x - x * b.z, x * b.y - y * b.x}; }
    Vec unit() const { return *this * (1.0f / std::sqrt(dot(*this))); }
    float largest() const { return std::max({x, y, z}); }
};

struct Ray {
    Vec origin, direction;
    Vec at(float t) const { return origin + direction * t; }
};

enum class Surface { diffuse, mirror, glass, light };

struct Hit {
    float t = far_away;
    Vec normal, albedo;
    Surface surface = Surface::diffuse;
};

struct Ball {
    Vec centre;
    float radius;
    Surface surface;
};

// The room is 2 wide, 2 high and 4 deep; the light is a rectangle in its ceiling.
constexpr Vec low{-1, 0, -1}, high{1, 2, 3};
constexpr Vec light_corner{-0.3f, 2, -0.4f};
constexpr float light_width = 0.6f, light_depth = 0.6f;
constexpr Vec emission{12, 11, 9};
constexpr std::array<Ball, 2> balls{Ball{{0.42f, 0.38f, 0.35f}, 0.38f, Surface::glass}, Ball{{-0.45f, 0.4f, -0.35f}, 0.4f, Surface::mirror}};

inline float ball_distance(const Ball& ball, const Ray& ray) {
    const Vec to = ball.centre - ray.origin;
    const float middle = to.dot(ray.direction), half = middle * middle - to.dot(to) + ball.radius * ball.radius;
    if (half <= 0) return far_away;
    const float root = std::sqrt(half);
    return middle - root > nudge ? middle - root : middle + root > nudge ? middle + root : far_away;
}

inline Hit wall(const Ray& ray) {
    Hit hit;
    const float o[3] = {ray.origin.x, ray.origin.y, ray.origin.z}, d[3] = {ray.direction.x, ray.direction.y, ray.direction.z};
    const float from[3] = {low.x, low.y, low.z}, to[3] = {high.x, high.y, high.z};
    for (int axis = 0; axis < 3; ++axis) {
        if (d[axis] == 0) continue;
        const bool upper = d[axis] > 0;
        const float t = ((upper ? to : from)[axis] - o[axis]) / d[axis], sign = upper ? -1.0f : 1.0f;
        if (t >= hit.t || t <= 0) continue;
        hit.t = t;
        hit.normal = {axis == 0 ? sign : 0, axis == 1 ? sign : 0, axis == 2 ? sign : 0};
        hit.albedo = axis != 0 ? Vec{0.75f, 0.75f, 0.72f} : upper ? Vec{0.2f, 0.5f, 0.2f} : Vec{0.6f, 0.15f, 0.1f};
    }
    const Vec p = ray.at(hit.t) - light_corner;
    if (hit.normal.y < 0 && p.x >= 0 && p.x <= light_width && p.z >= 0 && p.z <= light_depth) hit.surface = Surface::light;
    return hit;
}

inline Hit closest(const Ray& ray) {
    Hit hit = wall(ray);
    for (const Ball& ball : balls)
        if (const float t = ball_distance(ball, ray); t < hit.t) hit = {t, (ray.at(t) - ball.centre).unit(), {0.95f, 0.95f, 0.95f}, ball.surface};
    return hit;
}

inline bool visible(const Vec& from, const Vec& direction, float distance) {
    return std::none_of(balls.begin(), balls.end(), [&](const Ball& ball) { return ball_distance(ball, {from, direction}) < distance; });
}

// Cosine-weighted about n (Malley's method).
inline Vec diffuse_direction(const Vec& n, float u, float v) {
    const Vec a = (std::abs(n.x) > 0.5f ? Vec{0, 1, 0} : Vec{1, 0, 0}).cross(n).unit(), b = n.cross(a);
    const float r = std::sqrt(u), phi = 2 * pi * v;
    return (a * (r * std::cos(phi)) + b * (r * std::sin(phi)) + n * std::sqrt(std::max(0.0f, 1 - u))).unit();
}

// Reflected or refracted, by Fresnel's equations for an index of 1.5.
inline Vec through_glass(const Vec& d, const Vec& outward, float u) {
    const bool enters = d.dot(outward) < 0;
    const Vec n = enters ? outward : outward * -1.0f;
    const float eta = enters ? 1 / 1.5f : 1.5f, cos_i = -d.dot(n), sin2 = eta * eta * (1 - cos_i * cos_i);
    const Vec mirrored = d + n * (2 * cos_i);
    if (sin2 >= 1) return mirrored.unit();
    const float cos_t = std::sqrt(1 - sin2);
    const float s = (eta * cos_i - cos_t) / (eta * cos_i + cos_t), p = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    return (u < 0.5f * (s * s + p * p) ? mirrored : d * eta + n * (eta * cos_i - cos_t)).unit();
}

// Radiance along a ray. numbers(k) gives two numbers in [0, 1), the same two whenever asked for the same k; each bounce has
// three pairs of its own, so that the stratified numbers of all paths of a pixel meet the same decisions.
template <class Numbers>
Vec radiance(Ray ray, const Numbers& numbers) {
    Vec light, weight{1, 1, 1};
    bool sees_light = true;  // not where the light was sampled at the last bounce
    for (std::uint32_t bounce = 0; bounce < 12; ++bounce) {
        const Hit hit = closest(ray);
        if (hit.surface == Surface::light) return sees_light ? light + weight * emission : light;
        const Vec p = ray.at(hit.t);
        const auto choice = numbers(3 * bounce);
        Vec direction;
        if (hit.surface == Surface::diffuse) {
            const auto on_light = numbers(3 * bounce + 1);
            const Vec q = light_corner + Vec{light_width * on_light.x, -nudge, light_depth * on_light.y}, to = q - p;
            const float distance = std::sqrt(to.dot(to)), cosines = to.dot(hit.normal) * to.y / (distance * distance);
            if (cosines > 0 && visible(p, to.unit(), distance))
                light = light + weight * hit.albedo * emission * (cosines * light_width * light_depth / (pi * distance * distance));
            direction = diffuse_direction(hit.normal, choice.x, choice.y);
        } else {
            direction = hit.surface == Surface::glass ? through_glass(ray.direction, hit.normal, choice.x)
                                                      : ray.direction - hit.normal * (2 * hit.normal.dot(ray.direction));
        }
        sees_light = hit.surface != Surface::diffuse;
        weight = weight * hit.albedo;
        if (bounce > 2) {  // Russian roulette
            const float survival = std::min(weight.largest(), 0.95f);
            if (numbers(3 * bounce + 2).x >= survival) break;
            weight = weight * (1 / survival);
        }
        ray = {p + direction * nudge, direction};
    }
    return light;
}

// Through the point (x, y) of the image plane, in pixels from its top-left corner.
inline Ray camera(float x, float y, float width, float height) {
    const float scale = 0.75f / height;
    return {{0, 1, 2.9f}, Vec{(2 * x - width) * scale, (height - 2 * y) * scale, -1.6f}.unit()};
}

}  // namespace scene

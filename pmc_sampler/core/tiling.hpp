// Pixels are stored tile by tile: a "slot" is tile * 256 + the place in its 16x16 tile. Sorting a batch by slot gives coherent
// rays, and a thread that owns a range of tiles owns their sums.
#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>

namespace pmc {

struct Tiling {
    static constexpr std::uint32_t side = 16, area = side * side;
    std::uint32_t width, height, columns, rows;

    Tiling(std::uint32_t w, std::uint32_t h)
        : width(w), height(h), columns((w + side - 1) / side), rows((h + side - 1) / side) {}

    std::size_t pixels() const { return std::size_t(width) * height; }
    std::uint32_t tiles() const { return columns * rows; }
    std::size_t slots() const { return std::size_t(tiles()) * area; }
    // Whether some of a tile's slots are outside the image.
    bool at_border(std::uint32_t tile) const { return !inside(tile * area + area - 1); }

    std::uint32_t slot(std::uint32_t x, std::uint32_t y) const {
        return ((y / side) * columns + x / side) * area + (y % side) * side + x % side;
    }
    std::uint32_t x(std::uint32_t slot) const { return (slot / area) % columns * side + slot % side; }
    std::uint32_t y(std::uint32_t slot) const { return (slot / area) / columns * side + slot % area / side; }
    bool inside(std::uint32_t slot) const { return x(slot) < width && y(slot) < height; }
};

// corner, a whole number, + u, below corner + 1: the sum of two floats may round up to the next pixel, or out of the image.
inline float in_pixel(float corner, float u) {
    const float below = std::bit_cast<float>(std::bit_cast<std::uint32_t>(corner + 1.0f) - 1);
    return std::min(corner + u, below);
}

// x folded into [0, size) by reflection at both borders, as often as it takes.
inline float reflect(float x, float size) {
    if (x >= 0.0f && x < size) return x;
    const double period = 2.0 * size;
    double folded = static_cast<double>(x) - period * static_cast<double>(static_cast<std::int64_t>(x / period));
    if (folded < 0.0) folded = -folded;
    if (folded >= size) folded = period - folded;
    const float result = static_cast<float>(folded);
    return result < size ? result : size * (1.0f - 0x1p-24f);
}

}  // namespace pmc

// Boxes, and the primitives that a hierarchy is built over.
#pragma once

#include <bit>
#include <cstdint>
#include <limits>

namespace bvh {

// Four lanes, the last one unused, so that the compiler takes one vector instruction for a minimum.
struct alignas(16) Box {
    float lower[4], upper[4];

    static Box nothing() {
        constexpr float inf = std::numeric_limits<float>::infinity();
        return {{inf, inf, inf, 0}, {-inf, -inf, -inf, 0}};
    }
    void add(const Box& b) {
        for (int i = 0; i < 4; ++i) lower[i] = b.lower[i] < lower[i] ? b.lower[i] : lower[i];
        for (int i = 0; i < 4; ++i) upper[i] = b.upper[i] > upper[i] ? b.upper[i] : upper[i];
    }
    void add_point(const float (&p)[4]) {
        for (int i = 0; i < 4; ++i) lower[i] = p[i] < lower[i] ? p[i] : lower[i];
        for (int i = 0; i < 4; ++i) upper[i] = p[i] > upper[i] ? p[i] : upper[i];
    }
};

// A primitive's box; its number, below 2^28, travels as bits in the unused lane, so that a primitive is half a cache line.
struct Primitive {
    Box box;

    void number(std::uint32_t index) {
        box.lower[3] = 0;
        box.upper[3] = std::bit_cast<float>(index | normal);
    }
    std::uint32_t index() const { return std::bit_cast<std::uint32_t>(box.upper[3]) & ~normal; }
    // Half the centre: differences of these never overflow.
    float centre(int a) const { return 0.25f * box.lower[a] + 0.25f * box.upper[a]; }
    void centre(float (&c)[4]) const {
        for (int a = 0; a < 4; ++a) c[a] = centre(a);
    }

private:
    // Makes the bits a normal number from 2 to 2^33: arithmetic on all four lanes is slow where one is denormal.
    static constexpr std::uint32_t normal = 1u << 30;
};

}  // namespace bvh

// Counter-based random numbers: any number can be had in any order, on any thread.
//
// hash32 is a bijective 32-bit integer hash of two multiply-xorshift rounds (constants: C. Wellons,
// "Prospecting for Hash Functions", 2018). The Owen scramble follows B. Burley, "Practical Hash-based Owen
// Scrambling", JCGT 9(4), 2020, and S. Laine and T. Karras, "Stratified Sampling for Stochastic
// Transparency", EGSR 2011, doi:10.1111/j.1467-8659.2011.01978.x.
#pragma once

#include <cstdint>

namespace pmc {

constexpr std::uint32_t hash32(std::uint32_t x) {
    x ^= x >> 16;
    x *= 0x7feb352du;
    x ^= x >> 15;
    x *= 0x846ca68bu;
    x ^= x >> 16;
    return x;
}

// One 32-bit key from two; not symmetric in its arguments.
constexpr std::uint32_t mix(std::uint32_t a, std::uint32_t b) { return hash32(a ^ hash32(b + 0x9e3779b9u)); }

// A 24-bit fraction in [0, 1).
constexpr float unit_float(std::uint32_t bits) { return static_cast<float>(bits >> 8) * 0x1p-24f; }

// The random words of one (seed, stream, batch): word(counter, slot) is a pure function of all five.
struct Stream {
    std::uint32_t key0, key1;

    constexpr Stream(std::uint64_t seed, std::uint32_t stream, std::uint64_t batch)
        : key0(mix(mix(static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32)), stream)),
          key1(mix(mix(static_cast<std::uint32_t>(batch), static_cast<std::uint32_t>(batch >> 32)), key0)) {}

    constexpr std::uint32_t word(std::uint32_t counter, std::uint32_t slot = 0) const {
        // Two keyed rounds: the second key keeps two streams that collide in the first from running in step.
        return hash32(hash32(counter ^ key0) + key1 + slot * 0x9e3779b9u);
    }
    constexpr float uniform(std::uint32_t counter, std::uint32_t slot = 0) const {
        return unit_float(word(counter, slot));
    }
};

constexpr std::uint32_t reverse_bits(std::uint32_t x) {
    x = ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);
    x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);
    x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);
    x = ((x >> 8) & 0x00ff00ffu) | ((x & 0x00ff00ffu) << 8);
    return (x >> 16) | (x << 16);
}

// Owen scramble of a bit-reversed word: every bit is flipped by a hash of the bits below it.
constexpr std::uint32_t owen_reversed(std::uint32_t x, std::uint32_t key) {
    x ^= x * 0x3d20adeau;
    x += key;
    x *= (key >> 16) | 1u;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return x;
}

struct Point2 {
    float x, y;
};

// Dimensions 2 * pair and 2 * pair + 1 of the Owen-scrambled, index-shuffled Sobol sequence `scramble`.
constexpr Point2 sobol_pair(std::uint32_t scramble, std::uint32_t index, std::uint32_t pair) {
    const std::uint32_t key = mix(scramble, pair);
    const std::uint32_t i = reverse_bits(owen_reversed(reverse_bits(index), key));
    // The bit-reversed second Sobol coordinate of i in closed form; that of the first is i itself.
    std::uint32_t t = i;
    t ^= (t >> 1) & 0x55555555u;
    t ^= (t >> 2) & 0x33333333u;
    t ^= (t >> 4) & 0x0f0f0f0fu;
    t ^= (t >> 8) & 0x00ff00ffu;
    t ^= (t >> 16) & 0x0000ffffu;
    return {unit_float(reverse_bits(owen_reversed(i, hash32(key ^ 0x68bc21ebu)))),
            unit_float(reverse_bits(owen_reversed(t, hash32(key ^ 0x02e5be93u))))};
}

}  // namespace pmc

// Numbers kept in fewer bits than they are computed in: sums of which a film has one in every pixel.
//
// A sum that is rounded to the nearest number at every step drifts, and stands still once what is added is below half its last
// place. Rounding up or down in proportion to what is lost has no bias, and an error that grows with the square root of the
// steps (M. Croci et al., "Stochastic rounding: implementation, error analysis and applications", 2022,
// doi:10.1098/rsos.211631). What stands in for chance is a Weyl sequence over the number of samples.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <limits>

namespace pmc {

// 32 bits that decide how values are rounded after n samples.
constexpr std::uint32_t dither(std::uint32_t n) { return n * 0x9e3779b9u; }

// value, and up to the last place of a float more: as a float, rounded as `dither` says. What a float can hold stays as it is.
inline float rounded(double value, std::uint32_t dither) {
    constexpr int dropped = 52 - 23;
    constexpr double largest = std::numeric_limits<float>::max();
    const std::uint64_t bits = std::bit_cast<std::uint64_t>(std::clamp(value, -largest, largest)) + (dither >> (32 - dropped));
    return static_cast<float>(std::bit_cast<double>(bits >> dropped << dropped));
}

using Quad = double __attribute__((vector_size(4 * sizeof(double))));

// N <= 4 numbers of 40 bits each: doubles with a mantissa of 28 bits. Those that a float can hold are held exactly. All at once:
// what a processor has vectors for. Inlined by force, to be compiled for the instruction set of whoever calls it.
template <int N>
class Reals40 {
public:
    double get(int i) const { return std::bit_cast<double>(std::uint64_t(high_[i]) << 32 | ((low_ << 8 * i) & 0xff000000u)); }

    // Beyond the N-th there is 0, and nothing is taken. (No function returns a vector: how is another matter on every processor.)
    [[gnu::always_inline]] void get(Quad& values) const {
        Words high = {}, low = {};
        for (int i = 0; i < N; ++i) {
            high[i] = high_[i];
            low[i] = low_;
        }
        values = reinterpret_cast<Quad>(high << 32 | ((low << places) & 0xff000000u));
    }
    [[gnu::always_inline]] void set(const Quad& values, std::uint32_t dither) {
        const Words bits = reinterpret_cast<Words>(values) + (dither >> 8), low = (bits & 0xff000000u) >> places;
        for (int i = 0; i < N; ++i) high_[i] = static_cast<std::uint32_t>(bits[i] >> 32);
        const Pair even = {low[0], low[1]}, odd = {low[2], N > 3 ? low[3] : 0}, both = even | odd;
        low_ = static_cast<std::uint32_t>(both[0] | both[1]);
    }

private:
    using Words = std::uint64_t __attribute__((vector_size(4 * sizeof(std::uint64_t))));
    using Pair = std::uint64_t __attribute__((vector_size(2 * sizeof(std::uint64_t))));
    static constexpr Words places = {0, 8, 16, 24};

    std::uint32_t high_[N], low_;  // the low bytes, the first number's on top
};

}  // namespace pmc

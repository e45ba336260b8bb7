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
#include <cstring>
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
using QuadFloat = float __attribute__((vector_size(4 * sizeof(float))));

// N <= 4 numbers of 40 bits each: doubles with a mantissa of 28 bits. Those that a float can hold are held exactly.
template <int N>
class Reals40 {
public:
    double get(int i) const { return std::bit_cast<double>(std::uint64_t(high_[i]) << 32 | ((low_ << 8 * i) & 0xff000000u)); }
    // All four, and likewise below.
    [[gnu::always_inline]] Quad get() const requires(N == 4) {
        const std::uint64_t low = low_;
        const Words high = {high_[0], high_[1], high_[2], high_[3]};
        return std::bit_cast<Quad>(high << 32 | ((Words{low, low, low, low} << places) & 0xff000000u));
    }
    [[gnu::always_inline]] void set(Quad values, std::uint32_t dither) requires(N == 4) {
        const Words bits = std::bit_cast<Words>(values) + (dither >> 8), low = (bits & 0xff000000u) >> places;
        const auto high = __builtin_convertvector(bits >> 32, QuadWord);
        std::memcpy(high_, &high, sizeof(high_));
        low_ = static_cast<std::uint32_t>(low[0] | low[1] | low[2] | low[3]);
    }
    void set(const double (&values)[N], std::uint32_t dither) {
        low_ = 0;
        for (int i = 0; i < N; ++i) {
            const std::uint64_t bits = std::bit_cast<std::uint64_t>(values[i]) + (dither >> 8);
            high_[i] = static_cast<std::uint32_t>(bits >> 32);
            low_ |= (static_cast<std::uint32_t>(bits) & 0xff000000u) >> 8 * i;
        }
    }

private:
    using Words = std::uint64_t __attribute__((vector_size(4 * sizeof(std::uint64_t))));
    using QuadWord = std::uint32_t __attribute__((vector_size(4 * sizeof(std::uint32_t))));
    static constexpr Words places = {0, 8, 16, 24};

    std::uint32_t high_[N], low_;  // the low bytes, the first number's on top
};

}  // namespace pmc

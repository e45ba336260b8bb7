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

// N <= 4 numbers of 40 bits each: doubles with a mantissa of 28 bits. Those that a float can hold are held exactly.
template <int N>
class Reals40 {
public:
    double get(int i) const { return std::bit_cast<double>(std::uint64_t(high_[i]) << 32 | ((low_ << 8 * i) & 0xff000000u)); }
    void set(const double (&values)[N], std::uint32_t dither) {
        low_ = 0;
        for (int i = 0; i < N; ++i) {
            const std::uint64_t bits = std::bit_cast<std::uint64_t>(values[i]) + (dither >> 8);
            high_[i] = static_cast<std::uint32_t>(bits >> 32);
            low_ |= (static_cast<std::uint32_t>(bits) & 0xff000000u) >> 8 * i;
        }
    }

private:
    std::uint32_t high_[N], low_;  // the low bytes, the first number's on top
};

}  // namespace pmc

// Numbers in 40 bits and in a float against their neighbours.
#include <algorithm>
#include <array>
#include <bit>
#include <cfloat>
#include <cmath>
#include <cstring>
#include <limits>
#include <utility>

#include <rounding.hpp>

#include "piece.hpp"

namespace {

bool same(double a, double b) { return std::bit_cast<std::uint64_t>(a) == std::bit_cast<std::uint64_t>(b); }

double any_double() {
    for (;;) {
        const double value = std::bit_cast<double>(generator());
        if (std::isfinite(value)) return value;
    }
}
float any_float() {
    const float extremes[] = {0.0f, -0.0f, FLT_MAX, -FLT_MAX, FLT_MIN, std::numeric_limits<float>::denorm_min(), std::numeric_limits<float>::infinity()};
    if (below(8) == 0) return extremes[below(7)];
    for (;;) {
        const float value = std::bit_cast<float>(static_cast<std::uint32_t>(generator()));
        if (value == value) return value;
    }
}
// Of the size that sums have.
double usual_double() {
    const double mantissa = 1.0 + static_cast<double>(generator() >> 12) * 0x1p-52;
    return std::ldexp(below(2) ? mantissa : -mantissa, static_cast<int>(below(60)) - 30);
}

// The largest number with a mantissa of `bits` that is not above |value|, with its sign; and its last place.
std::pair<double, double> towards_zero(double value, int bits) {
    const int exponent = std::max(value == 0.0 ? DBL_MIN_EXP : std::ilogb(value), DBL_MIN_EXP - 1) - bits;
    return {std::ldexp(std::trunc(std::ldexp(value, -exponent)), exponent), std::copysign(std::ldexp(1.0, exponent), value)};
}
bool is_neighbour(double rounded, double value, int bits) {
    const auto [lower, place] = towards_zero(value, bits);
    return same(rounded, lower) || (lower != value && same(rounded, lower + place));
}

template <int N>
std::array<double, 4> through(const std::array<double, 4>& values, std::uint32_t dither) {
    pmc::Reals40<N> kept;
    kept.set(pmc::Quad{values[0], values[1], values[2], values[3]}, dither);
    if (N < 4) {
        pmc::Reals40<N> again;
        again.set(pmc::Quad{values[0], values[1], values[2], 1e-3 - values[3]}, dither);
        require(!std::memcmp(&kept, &again, sizeof(kept)), "nothing is taken of what is beyond the last");
    }
    pmc::Quad all;
    kept.get(all);
    for (int i = 0; i < N; ++i) require(same(kept.get(i), all[i]), "a number is the same alone and with the others");
    for (int i = N; i < 4; ++i) require(same(all[i], 0.0), "beyond the last there is 0");
    return {all[0], all[1], all[2], all[3]};
}

template <int N>
void reals() {
    at = "Reals40<" + std::to_string(N) + ">";
    static_assert(sizeof(pmc::Reals40<N>) == 4 * (N + 1));
    std::array<double, 4> values;
    for (int k = 0; k < 100'000; ++k) {
        const auto dither = below(16) ? static_cast<std::uint32_t>(generator()) : ~0u;
        for (double& v : values) v = any_float();
        if (k % 4 == 0) values[3] = N > 3 ? values[3] : std::numeric_limits<double>::quiet_NaN();
        auto kept = through<N>(values, dither);
        for (int i = 0; i < N; ++i) require(same(kept[i], values[i]), "what a float can hold is held exactly");
        for (double& v : values) v = below(2) ? any_double() : usual_double();
        kept = through<N>(values, dither);
        for (int i = 0; i < N; ++i) require(is_neighbour(kept[i], values[i], 28), "a number becomes one of its neighbours");
    }
    for (int k = 0; k < 200; ++k) {
        for (double& v : values) v = usual_double();
        // In last places: how often each number was rounded away from 0, and how often it should.
        const auto even = [&](std::uint32_t dithers, auto&& dither, double most) {
            double up[N] = {};
            for (std::uint32_t n = 0; n < dithers; ++n) {
                const auto kept = through<N>(values, dither(n));
                for (int i = 0; i < N; ++i) up[i] += (kept[i] - towards_zero(values[i], 28).first) / towards_zero(values[i], 28).second;
            }
            for (int i = 0; i < N; ++i) {
                const auto [lower, place] = towards_zero(values[i], 28);
                require(std::abs(up[i] - dithers * ((values[i] - lower) / place)) < most, "rounding has no bias");
            }
        };
        const auto start = static_cast<std::uint32_t>(generator());
        even(1024, [&](std::uint32_t n) { return start + (n << 22); }, 1.0 + 1e-3);
        // A golden-ratio sequence of n numbers is out of step with its expectation by less than log n, or so.
        even(1000, [&](std::uint32_t n) { return pmc::dither(start + n); }, 1.0 + std::log(1000.0));
    }
}

void floats() {
    at = "rounded";
    for (int k = 0; k < 100'000; ++k) {
        const auto dither = static_cast<std::uint32_t>(generator());
        const float exact = any_float();
        if (std::isfinite(exact)) require(same(pmc::rounded(exact, dither), exact), "a float stays as it is");
        const double value = usual_double();
        require(is_neighbour(pmc::rounded(value, dither), value, 23), "a number becomes one of its neighbours");
    }
    for (const double value : {1e39, DBL_MAX, std::numeric_limits<double>::infinity()})
        require(pmc::rounded(value, ~0u) == FLT_MAX && pmc::rounded(-value, ~0u) == -FLT_MAX, "a float has an end");
    for (int k = 0; k < 200; ++k) {
        const double value = usual_double();
        const auto [lower, place] = towards_zero(value, 23);
        const auto start = static_cast<std::uint32_t>(generator());
        double up = 0.0;
        for (std::uint32_t n = 0; n < 1024; ++n) up += (pmc::rounded(value, start + (n << 22)) - lower) / place;
        require(std::abs(up - 1024 * ((value - lower) / place)) < 1.0 + 1e-3, "rounding has no bias");
    }
}

void test() {
    reals<4>();
    reals<3>();
    floats();
}

}  // namespace

int main() { return report(test); }

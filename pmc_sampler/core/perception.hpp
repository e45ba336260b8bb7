// Luminance and the threshold-versus-intensity function.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>

namespace pmc {

// Rec. 709 luminance of linear RGB.
constexpr double luminance(double r, double g, double b) { return 0.2126 * r + 0.7152 * g + 0.0722 * b; }
constexpr float luminance(float r, float g, float b) { return 0.2126f * r + 0.7152f * g + 0.0722f * b; }

// Just noticeable luminance difference at adaptation luminance L, both in cd/m2: the rod and cone curves of Ferwerda et al.
// 1996 (doi:10.1145/237170.237262) joined as in Ward Larson et al. 1997 (doi:10.1109/2945.646233). Zero, negative and
// denormal L give the darkness threshold 10^-2.86, infinity gives infinity, NaN gives NaN.
inline double tvi(double L) {
    if (L != L) return L;
    const double a = L > 0.0 ? std::log10(L) : -1e3;
    double exponent;
    if (a < -3.94)
        exponent = -2.86;
    else if (a < -1.44)
        exponent = std::pow(0.405 * a + 1.6, 2.18) - 2.86;
    else if (a < -0.0184)
        exponent = a - 0.395;
    else if (a < 1.9)
        exponent = std::pow(0.249 * a + 0.65, 2.7) - 0.72;
    else
        exponent = a - 1.255;
    return std::pow(10.0, exponent);
}

// 1 / tvi^2 by linear interpolation between exact values, 32 to the octave: within 0.3 % away from tvi's two small jumps and 0.6 %
// about its kink near 1 cd/m2. It
// steers the sampler, where pow and log10 for every sample would cost more than all else; figures use tvi itself.
class InverseSquareTvi {
public:
    InverseSquareTvi() {
        for (std::int32_t i = 0; i < entries; ++i) {
            const double t = tvi(std::bit_cast<float>(low + (i << shift)));
            values_[i] = static_cast<float>(1.0 / (t * t));
        }
    }
    // Without branches: many are computed side by side.
    [[gnu::always_inline]] float operator()(float L) const {
        const std::int32_t offset = std::max(std::bit_cast<std::int32_t>(L), low) - low, i = std::min(offset >> shift, entries - 2);
        const float t = static_cast<float>(offset & ((1 << shift) - 1)) * (1.0f / (1 << shift));
        const float between = values_[i] + t * (values_[i + 1] - values_[i]);
        // The curve is a straight line from 79 cd/m2 on, at 10^-1.255 of the luminance.
        const float inverse = 17.988709f / std::max(L, 1.0f);
        return offset >> shift > entries - 2 ? inverse * inverse : between;
    }

private:
    static constexpr std::int32_t shift = 18, low = (127 - 14) << 23;  // from 2^-14 cd/m2, below the rods' threshold knee
    static constexpr std::int32_t entries = (21 << 5) + 1;             // to 2^7 = 128 cd/m2
    std::array<float, entries> values_{};
};

}  // namespace pmc

// Pixel filters as distributions: a uniform number in [0, 1) to an offset from the pixel's centre.
#pragma once

#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "config.hpp"

namespace pmc {

class FilterSampler {
public:
    FilterSampler(Filter filter, double radius) : trivial_(filter == Filter::box && radius == 0.5) {
        // The cumulative distribution by the midpoint rule on a fine grid, then its inverse at equal steps of probability.
        constexpr int fine = 1 << 14;
        std::vector<double> cdf(fine + 1, 0.0);
        for (int i = 0; i < fine; ++i) cdf[i + 1] = cdf[i] + weight(filter, (i + 0.5) / fine * 2.0 - 1.0);
        int j = 0;
        for (int i = 0; i <= steps; ++i) {
            const double target = cdf[fine] * i / steps;
            while (j < fine - 1 && cdf[j + 1] < target) ++j;
            const double width = cdf[j + 1] - cdf[j];
            const double place = (j + (width > 0.0 ? std::min(1.0, (target - cdf[j]) / width) : 0.0)) / fine;
            inverse_[i] = static_cast<float>((place * 2.0 - 1.0) * radius);
        }
    }
    bool trivial() const { return trivial_; }  // the offset is u - 0.5: nothing to look up
    float operator()(float u) const {
        const float scaled = u * steps;
        const int i = static_cast<int>(scaled);
        return inverse_[i] + (scaled - static_cast<float>(i)) * (inverse_[i + 1] - inverse_[i]);
    }

private:
    static constexpr int steps = 4096;
    // x in [-1, 1] of the filter's radius.
    static double weight(Filter filter, double x) {
        constexpr double pi = std::numbers::pi;
        switch (filter) {
            case Filter::tent:
                return 1.0 - std::abs(x);
            case Filter::gaussian: {
                // Standard deviation a quarter of the radius, lowered to reach zero at the radius, as in Mitsuba and pbrt.
                const double s = 4.0 * x;
                return std::max(0.0, std::exp(-0.5 * s * s) - std::exp(-8.0));
            }
            case Filter::blackman_harris: {
                const double t = pi * (x + 1.0);
                return 0.35875 - 0.48829 * std::cos(t) + 0.14128 * std::cos(2 * t) - 0.01168 * std::cos(3 * t);
            }
            case Filter::box:
                break;
        }
        return 1.0;
    }
    bool trivial_;
    std::array<float, steps + 2> inverse_{};
};

}  // namespace pmc

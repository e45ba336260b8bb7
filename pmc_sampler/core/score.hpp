// What beta owes to a pixel's samples other than their number.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "config.hpp"
#include "multiversion.hpp"
#include "perception.hpp"
#include "pixel_sums.hpp"

namespace pmc {

// var / tvi^2, or the paper's var / tvi, of luminance. Bounded, so that sums and powers of it stay finite.
template <Beta rule>
[[gnu::always_inline]] inline float scored(double variance, double mean, const InverseSquareTvi& inverse_square_tvi, double white) {
    const double inverse_square = inverse_square_tvi(static_cast<float>(mean * white));
    const double value = rule == Beta::gain ? variance * white * white * inverse_square : variance * white * std::sqrt(inverse_square);
    return static_cast<float>(std::min(value, 1e18));
}

PMC_MULTIVERSION inline void score_by_gain(const Moments& m, const InverseSquareTvi& tvi, double white, float* scores) {
    for (std::size_t i = 0; i < m.size; ++i) scores[i] = scored<Beta::gain>(m.variance[i], m.mean[i], tvi, white);
}
PMC_MULTIVERSION inline void score_by_variance(const Moments& m, const InverseSquareTvi& tvi, double white, float* scores) {
    for (std::size_t i = 0; i < m.size; ++i) scores[i] = scored<Beta::variance>(m.variance[i], m.mean[i], tvi, white);
}

class Score {
public:
    // white: the luminance of 1 in cd/m2.
    Score(Beta rule, double white) : rule_(rule), white_(white) {}

    float operator()(double variance, double mean) const { return rule_ == Beta::gain ? by_gain(variance, mean) : scored<Beta::variance>(variance, mean, tvi_, white_); }
    float by_gain(double variance, double mean) const { return scored<Beta::gain>(variance, mean, tvi_, white_); }
    void operator()(const Moments& moments, float* scores) const {
        if (rule_ == Beta::gain)
            score_by_gain(moments, tvi_, white_, scores);
        else
            score_by_variance(moments, tvi_, white_, scores);
    }

private:
    Beta rule_;
    double white_;
    InverseSquareTvi tvi_;
};

}  // namespace pmc

// What is computed for all pixels of a tile at once: their weights, and how often each is drawn. Column by column side by side,
// since the pixels of a row lie together in memory.
#pragma once

#include <algorithm>
#include <cstdint>

#include "multiversion.hpp"
#include "tiling.hpp"

namespace pmc {

struct TileWeights {
    float pixel[Tiling::area], column[Tiling::side];  // and their sums down the columns
};

// score / (drawn + passes)^2: the gain of one more sample. A count is negative from 2^31 samples on: such a pixel gets no more,
// lest its count run over.
PMC_MULTIVERSION inline void gains(const float* score, const std::uint32_t* drawn, float passes, float* gain) {
    for (std::uint32_t i = 0; i < Tiling::area; ++i) {
        const auto count = static_cast<std::int32_t>(drawn[i]);
        const float inverse = 1.0f / (static_cast<float>(count) + passes);
        gain[i] = count < 0 ? 0.0f : score[i] * inverse * inverse;
    }
}

PMC_MULTIVERSION inline void square(float* values) {
    for (std::uint32_t i = 0; i < Tiling::area; ++i) values[i] *= values[i];
}

PMC_MULTIVERSION inline void sum_columns(const float* values, float* sums) {
    float sum[Tiling::side] = {};
    for (std::uint32_t row = 0; row < Tiling::side; ++row)
        for (std::uint32_t c = 0; c < Tiling::side; ++c) sum[c] += values[row * Tiling::side + c];
    for (std::uint32_t c = 0; c < Tiling::side; ++c) sums[c] = sum[c];
}

// Sum of weight^2 / n, n being drawn + passes: what SystematicDraw::growth() is made of.
PMC_MULTIVERSION inline double crowding(const float* weights, const std::uint32_t* drawn, float passes) {
    double sum[Tiling::side] = {};
    for (std::uint32_t row = 0; row < Tiling::side; ++row) {
        for (std::uint32_t c = 0; c < Tiling::side; ++c) {
            const std::uint32_t i = row * Tiling::side + c;
            const double weight = weights[i];
            sum[c] += weight * weight / static_cast<double>(static_cast<float>(static_cast<std::int32_t>(drawn[i])) + passes);
        }
    }
    double total = 0.0;
    for (std::uint32_t c = 0; c < Tiling::side; ++c) total += sum[c];
    return total;
}

// Draws lie at the whole numbers from 0 on of `scale` times the running sum of weights, which goes down one column after the other
// and is start[c], above -1, at the head of each. counts: how many lie within each pixel. No more than up_to[c] are made before
// the end of a column; passed[c] were before its head.
PMC_MULTIVERSION inline void count_draws(const float* weights, double scale, const double* start, const double* up_to, const std::int32_t* passed, std::int32_t* counts) {
    double at[Tiling::side];
    std::int32_t before[Tiling::side];
    for (std::uint32_t c = 0; c < Tiling::side; ++c) at[c] = start[c], before[c] = passed[c];
    for (std::uint32_t row = 0; row < Tiling::side; ++row) {
        for (std::uint32_t c = 0; c < Tiling::side; ++c) {
            at[c] += scale * static_cast<double>(weights[row * Tiling::side + c]);
            const double end = std::min(at[c], up_to[c]);
            const auto whole = static_cast<std::int32_t>(end);
            const std::int32_t now = whole + (static_cast<double>(whole) < end);  // the numbers below `end`
            counts[row * Tiling::side + c] = now - before[c];
            before[c] = now;
        }
    }
}

}  // namespace pmc

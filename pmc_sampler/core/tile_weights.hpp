// What is computed for all pixels of a tile at once: their weights, and how often each is drawn. Column by column side by side,
// since the pixels of a row lie together in memory.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "multiversion.hpp"
#include "tiling.hpp"

namespace pmc {

struct TileWeights {
    float inverse[Tiling::area];  // of the pixels' numbers of samples
    float pixel[Tiling::area], column[Tiling::side];  // their weights, and these summed down the columns
};

// 1 / (drawn + passes), or -1 from 2^31 samples on, where a count is negative.
PMC_MULTIVERSION inline void inverses(const std::uint32_t* drawn, float passes, float* inverse) {
    for (std::uint32_t i = 0; i < Tiling::area; ++i) {
        const auto count = static_cast<std::int32_t>(drawn[i]);
        const float one_over = 1.0f / (static_cast<float>(count) + passes);
        inverse[i] = count < 0 ? -1.0f : one_over;
    }
}

// score / n^2: the gain of one more sample. A pixel without an inverse gets no more, lest its count run over.
PMC_MULTIVERSION inline void gains(const float* score, const float* inverse, float* gain) {
    for (std::uint32_t i = 0; i < Tiling::area; ++i) gain[i] = inverse[i] < 0.0f ? 0.0f : score[i] * inverse[i] * inverse[i];
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

// Sum of weight^2 / n: what SystematicDraw::growth() is made of.
PMC_MULTIVERSION inline double crowding(const float* weights, const float* inverse) {
    double sum[Tiling::side] = {};
    for (std::uint32_t row = 0; row < Tiling::side; ++row) {
        for (std::uint32_t c = 0; c < Tiling::side; ++c) {
            const double weight = weights[row * Tiling::side + c];
            sum[c] += weight * weight * static_cast<double>(inverse[row * Tiling::side + c]);
        }
    }
    double total = 0.0;
    for (std::uint32_t c = 0; c < Tiling::side; ++c) total += sum[c];
    return total;
}

// How often a tile's pixels are drawn. Draws lie at the whole numbers from 0 on of `scale` times the running sum of weights, which
// is `place`, above -1, at the head of the first column and goes down one column after the other. drawn: a bit for each pixel, 64 in
// a word, set where it is drawn at all. There are no more than `most` draws.
PMC_MULTIVERSION inline void count_draws(const TileWeights& w, double scale, double place, double most, std::int32_t* counts, std::uint64_t* drawn) {
    double at[Tiling::side], up_to[Tiling::side];
    std::int32_t before[Tiling::side];
    for (std::uint32_t c = 0; c < Tiling::side; ++c) {
        at[c] = place;
        place += scale * static_cast<double>(w.column[c]);
        up_to[c] = place;
    }
    up_to[Tiling::side - 1] = most;
    for (double& draws : up_to) draws = std::min(std::max(std::ceil(draws), 0.0), most);
    before[0] = 0;
    for (std::uint32_t c = 1; c < Tiling::side; ++c) before[c] = static_cast<std::int32_t>(up_to[c - 1]);
    for (std::uint32_t row = 0; row < Tiling::side; ++row) {
        for (std::uint32_t c = 0; c < Tiling::side; ++c) {
            at[c] += scale * static_cast<double>(w.pixel[row * Tiling::side + c]);
            const double end = std::min(at[c], up_to[c]);
            const auto whole = static_cast<std::int32_t>(end);
            const std::int32_t now = whole + (static_cast<double>(whole) < end);  // the numbers below `end`
            counts[row * Tiling::side + c] = now - before[c];
            before[c] = now;
        }
    }
    for (std::uint32_t word = 0; word < Tiling::area / 64; ++word) {
        std::uint64_t bits = 0;
        for (std::uint64_t i = 0; i < 64; ++i) bits |= static_cast<std::uint64_t>(counts[64 * word + i] > 0) << i;
        drawn[word] = bits;
    }
}

}  // namespace pmc

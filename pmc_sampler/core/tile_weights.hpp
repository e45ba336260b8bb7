// What is computed for all pixels of a tile at once: their weights, and how often each is drawn. Column by column side by side,
// since the pixels of a row lie together in memory.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "multiversion.hpp"
#include "tiling.hpp"

namespace pmc {

struct TileWeights {
    float inverse[Tiling::area];  // of the pixels' numbers of samples
    float pixel[Tiling::area], column[Tiling::side];  // their weights, and these summed down the columns
};

// Weights by score, or by score / n^2, the gain of one more sample; squared or not. n: drawn + passes. From 2^31 samples on, where
// a count is negative, a pixel gets no more, lest its count run over.
PMC_MULTIVERSION inline void weigh_pixels(const float* score, const std::uint32_t* drawn, float passes, bool by_gain, bool squared, TileWeights& w) {
    for (std::uint32_t i = 0; i < Tiling::area; ++i) {
        const auto count = static_cast<std::int32_t>(drawn[i]);
        const float inverse = 1.0f / (static_cast<float>(count) + passes);
        float weight = by_gain ? score[i] * inverse * inverse : score[i];
        weight = count < 0 ? 0.0f : weight;
        w.inverse[i] = count < 0 ? 0.0f : inverse;
        w.pixel[i] = squared ? weight * weight : weight;
    }
}

PMC_MULTIVERSION inline void sum_columns(TileWeights& w) {
    float sum[Tiling::side] = {};
    for (std::uint32_t row = 0; row < Tiling::side; ++row)
        for (std::uint32_t c = 0; c < Tiling::side; ++c) sum[c] += w.pixel[row * Tiling::side + c];
    for (std::uint32_t c = 0; c < Tiling::side; ++c) w.column[c] = sum[c];
}

// Sum of weight^2 / n: what SystematicDraw::growth() is made of.
PMC_MULTIVERSION inline double crowding(const TileWeights& w) {
    double sum[Tiling::side] = {};
    for (std::uint32_t row = 0; row < Tiling::side; ++row) {
        for (std::uint32_t c = 0; c < Tiling::side; ++c) {
            const double weight = w.pixel[row * Tiling::side + c];
            sum[c] += weight * weight * static_cast<double>(w.inverse[row * Tiling::side + c]);
        }
    }
    double total = 0.0;
    for (std::uint32_t c = 0; c < Tiling::side; ++c) total += sum[c];
    return total;
}

// How often a tile's pixels are drawn. Draws lie where `scale` times the running sum of weights, which is `place`, from 0 on and below 1,
// at the head of the first column and goes down one column after the other, comes to a whole number. drawn: a bit for each pixel,
// 64 in a word, set where it is drawn at all. There are no more than `most` draws.
PMC_MULTIVERSION inline void count_draws(const TileWeights& w, double scale, double place, double most, std::int32_t* counts, std::uint64_t* drawn) {
    using Row = float __attribute__((vector_size(Tiling::side * sizeof(float))));
    using Counts = std::int32_t __attribute__((vector_size(Tiling::side * sizeof(std::int32_t))));
    // Each column from the last whole number before its head: floats suffice for what is left, and must not round it up to the next.
    constexpr float below_one = 1.0f - 0x1p-24f;
    Row at, up_to;
    for (std::uint32_t c = 0; c < Tiling::side; ++c) {
        const auto before = static_cast<double>(static_cast<std::int64_t>(place));
        at[c] = std::min(static_cast<float>(place - before), below_one);
        place = c + 1 < Tiling::side ? std::min(place + scale * static_cast<double>(w.column[c]), most) : most;
        up_to[c] = static_cast<float>(static_cast<double>(static_cast<std::int64_t>(place)) - before);
    }
    // In two steps: where weights are next to nothing, their scale is beyond floats.
    const float large = scale > 0x1p100 ? 0x1p100f : 1.0f, rest = static_cast<float>(scale / static_cast<double>(large));
    Counts until = {};
    for (std::uint32_t row = 0; row < Tiling::side; ++row) {
        Row weight;
        std::memcpy(&weight, w.pixel + row * Tiling::side, sizeof(Row));
        at += weight * large * rest;
        const Counts now = __builtin_convertvector(at < up_to ? at : up_to, Counts), draws = now - until;
        std::memcpy(counts + row * Tiling::side, &draws, sizeof(Counts));
        until = now;
    }
    // From bytes of 0 or 1 to bits: eight by one multiplication.
    constexpr std::uint64_t gather = std::endian::native == std::endian::little ? 0x0102040810204080u : 0x8040201008040201u;
    alignas(8) std::uint8_t any[Tiling::area];
    for (std::uint32_t i = 0; i < Tiling::area; ++i) any[i] = counts[i] > 0;
    for (std::uint32_t word = 0; word < Tiling::area / 64; ++word) {
        drawn[word] = 0;
        for (std::uint32_t byte = 0; byte < 8; ++byte) {
            std::uint64_t eight;
            std::memcpy(&eight, any + 64 * word + 8 * byte, 8);
            drawn[word] |= (eight * gather >> 56) << 8 * byte;
        }
    }
}

}  // namespace pmc

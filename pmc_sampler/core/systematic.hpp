// Systematic sampling of pixels in proportion to their weight (beta to its power): one random offset, equal steps of the
// cumulative weight (paper, section 6, "deterministic sampling"). Draws come out tile by tile.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <vector>

#include "film.hpp"

namespace pmc {

class SystematicDraw {
public:
    // Tiles are summed in blocks of fixed size: a sum's rounding must not depend on the number of threads.
    static constexpr std::size_t block = 64;

    // Brings the film's sums of weights up to date; `passes` of the pool are drawn. `beside` is called meanwhile, on one thread.
    SystematicDraw(Film& film, float passes, ThreadPool& threads) : SystematicDraw(film, passes, threads, [] {}) {}
    template <class Beside>
    SystematicDraw(Film& film, float passes, ThreadPool& threads, Beside&& beside) : film_(film), starts_((film.tiling.tiles() + block - 1) / block + 1, 0.0) {
        const std::size_t tiles = film.tiling.tiles();
        std::vector<double> crowding(starts_.size() - 1, 0.0);
        threads.run(starts_.size() - 1, [&](std::size_t b) {
            const std::size_t first = b * block, last = std::min(tiles, first + block);
            film.weigh(first, last, passes);
            double sum = 0.0;
            for (std::size_t t = first; t < last; ++t) {
                sum += film.tile_weight(t);
                crowding[b] += film.tile_crowding(t);
            }
            starts_[b + 1] = sum;
        }, beside);
        for (std::size_t b = 1; b < starts_.size(); ++b) {
            if (starts_[b] > 0.0) last_ = b - 1;
            starts_[b] += starts_[b - 1];
        }
        for (const double of_block : crowding) crowding_ += of_block;
    }

    double total() const { return starts_.back(); }
    // By what factor each draw would raise the number of samples of the pixel that it goes to, on average over draws.
    double growth() const { return total() > 0.0 ? crowding_ / total() / total() : 0.0; }

    // Writes the slots of `count` draws; offset in [0, 1). total() must be above 0. starts: how many draws come before each tile, one
    // entry more than there are tiles; none where nobody asks. `beside` is called meanwhile, on one thread.
    template <class Beside>
    void operator()(std::size_t count, float offset, std::uint32_t* slots, std::uint32_t* starts, ThreadPool& threads, Beside&& beside) const {
        const double scale = static_cast<double>(count) / total();
        // Draw i lies where the cumulative weight comes to i + 1, in these units. At a weight: its place, and the draws before it.
        const auto place = [&](double weight) { return weight * scale + offset; };
        const auto before = [&](double weight) { return std::min(count, static_cast<std::size_t>(place(weight))); };
        const std::size_t tiles = film_.tiling.tiles();
        threads.run(starts_.size() - 1, [&](std::size_t b) {
            const std::size_t first = b * block, last = std::min(tiles, first + block), block_end = b >= last_ ? count : before(starts_[b + 1]);
            std::size_t last_with_weight = last;  // takes what rounding leaves over
            while (last_with_weight > first && !(film_.tile_weight(--last_with_weight) > 0.0)) {
            }
            double weight = starts_[b];
            std::size_t i = b > last_ ? count : std::min(before(weight), block_end);
            for (std::size_t t = first; t < last; ++t) {
                if (starts) starts[t] = static_cast<std::uint32_t>(i);
                if (!(film_.tile_weight(t) > 0.0)) continue;
                const double tile_end = weight + film_.tile_weight(t);
                const std::size_t end = t == last_with_weight ? block_end : std::clamp(before(tile_end), i, block_end);
                // Below 1 by its definition, and by rounding no longer where the weights from there on are next to nothing.
                if (end > i) draw(static_cast<std::uint32_t>(t), std::min(place(weight) - static_cast<double>(i), 1.0 - 0x1p-53), scale, end - i, slots + i);
                weight = tile_end;
                i = end;
            }
        }, beside);
        if (starts) starts[tiles] = static_cast<std::uint32_t>(count);
    }

private:
    // Writes `count` slots of a tile, at whose head the cumulative weight is `place` of the way to the first.
    void draw(std::uint32_t tile, double place, double scale, std::size_t count, std::uint32_t* slots) const {
        TileWeights w;
        film_.weights(tile, w);
        std::int32_t counts[Tiling::area];
        std::uint64_t drawn[Tiling::area / 64];
        count_draws(w, scale, place, static_cast<double>(count), counts, drawn);
        std::size_t n = 0;
        for (std::uint32_t word = 0; word < Tiling::area / 64; ++word) {
            for (std::uint64_t bits = drawn[word]; bits; bits &= bits - 1) {
                const std::uint32_t i = 64 * word + static_cast<std::uint32_t>(std::countr_zero(bits));
                // As good as always one, so that one needs no branch that is hard to predict.
                if (n < count) slots[n++] = tile * Tiling::area + i;
                for (std::int32_t k = 1; k < counts[i] && n < count; ++k) slots[n++] = tile * Tiling::area + i;
            }
        }
        if (n == count) return;
        // The sums are rounded, each in its own way: a draw that falls between them goes to the pixel with the largest weight.
        const auto some = std::max_element(std::begin(w.pixel), std::end(w.pixel)) - std::begin(w.pixel);
        for (; n < count; ++n) slots[n] = tile * Tiling::area + static_cast<std::uint32_t>(some);
    }

    const Film& film_;
    std::vector<double> starts_;
    double crowding_ = 0.0;
    std::size_t last_ = 0;  // block with weight
};

}  // namespace pmc

// Systematic sampling of pixels in proportion to their weight (beta to its power): one random offset, equal steps of the
// cumulative weight (paper, section 6, "deterministic sampling"). Draws come out tile by tile.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <vector>

#include "film.hpp"

namespace pmc {

class SystematicDraw {
public:
    // Tiles are summed in blocks of fixed size: a sum's rounding must not depend on the number of threads.
    static constexpr std::size_t block = 64;

    // Brings the film's sums of weights up to date; `passes` of the pool are drawn.
    SystematicDraw(Film& film, float passes, ThreadPool& threads) : film_(film), starts_((film.tiling.tiles() + block - 1) / block + 1, 0.0) {
        const std::size_t tiles = film.tiling.tiles();
        threads.run(starts_.size() - 1, [&](std::size_t b) {
            const std::size_t first = b * block, last = std::min(tiles, first + block);
            film.weigh(first, last, passes);
            double sum = 0.0;
            for (std::size_t t = first; t < last; ++t) sum += film.tile_weight(t);
            starts_[b + 1] = sum;
        });
        for (std::size_t b = 1; b < starts_.size(); ++b) starts_[b] += starts_[b - 1];
        for (std::size_t t = 0; t < tiles; ++t) crowding_ += film.tile_crowding(t);
    }

    double total() const { return starts_.back(); }
    // By what factor each draw would raise the number of samples of the pixel that it goes to, on average over draws.
    double growth() const { return total() > 0.0 ? crowding_ / total() / total() : 0.0; }

    // Writes `count` slots, tile by tile; offset in [0, 1). total() must be above 0.
    void operator()(std::size_t count, float offset, std::uint32_t* slots, ThreadPool& threads) const {
        const double scale = static_cast<double>(count) / total();
        // Draw i lies where the cumulative weight passes i, in these units. At a weight: its place, and the draws before it.
        const auto place = [&](double weight) { return weight * scale - offset; };
        const auto before = [&](double weight) {
            const double draws = std::ceil(place(weight));
            return draws <= 0.0 ? std::size_t(0) : std::min(count, static_cast<std::size_t>(draws));
        };
        const std::size_t tiles = film_.tiling.tiles(), blocks = starts_.size() - 1;
        threads.run(blocks, [&](std::size_t b) {
            const std::size_t last = std::min(tiles, (b + 1) * block), block_end = b + 1 == blocks ? count : before(starts_[b + 1]);
            double weight = starts_[b];
            for (std::size_t t = b * block, i = before(weight), end; t < last && i < block_end; ++t, i = end) {
                const double tile_end = weight + film_.tile_weight(t);
                end = t + 1 == last ? block_end : std::min(block_end, before(tile_end));
                if (end > i) draw(static_cast<std::uint32_t>(t), place(weight) - static_cast<double>(i), scale, end - i, slots + i);
                weight = tile_end;
            }
        });
    }

private:
    // Writes `count` slots of a tile, at whose head the cumulative weight is `place` draws from the first.
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
                for (std::int32_t k = 0; k < counts[i]; ++k) slots[n++] = tile * Tiling::area + i;
            }
        }
        // The sums are rounded, each in its own way: a draw that falls between them goes to some pixel.
        for (; n < count; ++n) slots[n] = some_slot(tile);
    }

    // A pixel with weight in the first tile from `tile` on that has one, or before it.
    std::uint32_t some_slot(std::size_t tile) const {
        const std::size_t tiles = film_.tiling.tiles();
        for (std::size_t step = 0; step < tiles; ++step) {
            const std::size_t t = (tile + step) % tiles;
            if (!(film_.tile_weight(t) > 0.0)) continue;
            TileWeights w;
            film_.weights(static_cast<std::uint32_t>(t), w);
            for (std::uint32_t i = 0; i < Tiling::area; ++i)
                if (w.pixel[i] > 0.0f) return static_cast<std::uint32_t>(t * Tiling::area) + i;
        }
        return 0;
    }

    const Film& film_;
    std::vector<double> starts_;
    double crowding_ = 0.0;
};

}  // namespace pmc

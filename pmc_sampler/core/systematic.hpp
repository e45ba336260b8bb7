// Systematic sampling of pixels in proportion to their weight (beta to its power): one random offset, equal steps of the
// cumulative weight (paper, section 6, "deterministic sampling"). Draws come out in slot order.
#pragma once

#include <algorithm>
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
    }

    double total() const { return starts_.back(); }

    // Writes `count` slots, in order; offset in [0, 1). total() must be above 0.
    void operator()(std::size_t count, float offset, std::uint32_t* slots, ThreadPool& threads) const {
        const double step = total() / static_cast<double>(count);
        // Draw i lies where the cumulative weight passes (i + offset) * step.
        const auto first_at = [&](double weight) {
            const double i = std::ceil(weight / step - offset);
            return i <= 0.0 ? std::size_t(0) : std::min(count, static_cast<std::size_t>(i));
        };
        const std::size_t tiles = film_.tiling.tiles(), blocks = starts_.size() - 1;
        threads.run(blocks, [&](std::size_t b) {
            std::size_t i = first_at(starts_[b]);
            const std::size_t end = b + 1 == blocks ? count : first_at(starts_[b + 1]);
            double next = (static_cast<double>(i) + offset) * step, weight = starts_[b];
            std::uint32_t last = 0;  // the last pixel of any weight
            bool found = false;
            Film::TileWeights w;
            const auto draw = [&](std::uint32_t slot) {
                for (; i < end && next < weight; next = (static_cast<double>(++i) + offset) * step) slots[i] = slot;
            };
            for (std::size_t t = b * block; t < std::min(tiles, (b + 1) * block) && i < end; ++t) {
                if (weight + film_.tile_weight(t) <= next) {  // nothing falls into this tile
                    weight += film_.tile_weight(t);
                    continue;
                }
                film_.weights(static_cast<std::uint32_t>(t), w);
                const double tile_end = weight + film_.tile_weight(t);
                for (std::uint32_t r = 0; r < Tiling::side; ++r) {
                    const double row_end = weight + w.row[r];
                    if (row_end <= next) {
                        weight = row_end;
                        continue;
                    }
                    for (std::uint32_t s = r * Tiling::side; s < (r + 1) * Tiling::side; ++s) {
                        if (!(w.pixel[s] > 0.0f)) continue;
                        weight += w.pixel[s];
                        last = static_cast<std::uint32_t>(t) * Tiling::area + s;
                        found = true;
                        draw(last);
                    }
                    weight = row_end;
                    if (found) draw(last);
                }
                weight = tile_end;
            }
            // The sums above are rounded: a draw that falls between them goes to the last pixel passed.
            if (i < end && !found) last = some_slot(b * block);
            for (; i < end; ++i) slots[i] = last;
        });
    }

private:
    // A pixel with weight in the first tile from `tile` on that has one, or before it.
    std::uint32_t some_slot(std::size_t tile) const {
        const std::size_t tiles = film_.tiling.tiles();
        for (std::size_t step = 0; step < tiles; ++step) {
            const std::size_t t = (tile + step) % tiles;
            if (!(film_.tile_weight(t) > 0.0)) continue;
            Film::TileWeights w;
            film_.weights(static_cast<std::uint32_t>(t), w);
            for (std::uint32_t i = 0; i < Tiling::area; ++i)
                if (w.pixel[i] > 0.0f) return static_cast<std::uint32_t>(t * Tiling::area) + i;
        }
        return 0;
    }

    const Film& film_;
    std::vector<double> starts_;
};

}  // namespace pmc

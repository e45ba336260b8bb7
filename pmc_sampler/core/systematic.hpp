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
    static constexpr std::size_t block = 256;

    SystematicDraw(const Film& film, ThreadPool& threads) : film_(film), starts_((film.tiling.tiles() + block - 1) / block + 1, 0.0) {
        const std::size_t tiles = film.tiling.tiles();
        threads.run(starts_.size() - 1, [&](std::size_t b) {
            double sum = 0.0;
            for (std::size_t t = b * block; t < std::min(tiles, (b + 1) * block); ++t) sum += film.tile_weight[t];
            starts_[b + 1] = sum;
        });
        for (std::size_t b = 1; b < starts_.size(); ++b) starts_[b] += starts_[b - 1];
    }

    double total() const { return starts_.back(); }

    // Writes `count` slots, in order; offset in [0, 1). total() must be above 0.
    void operator()(std::size_t count, float offset, std::uint32_t* slots, ThreadPool& threads) const {
        const double step = total() / static_cast<double>(count);
        const auto index_at = [&](double weight) {  // draws whose place lies below `weight`
            const double i = std::ceil(weight / step - offset);
            return i <= 0.0 ? std::size_t(0) : std::min(count, static_cast<std::size_t>(i));
        };
        const std::size_t tiles = film_.tiling.tiles(), blocks = starts_.size() - 1;
        threads.run(blocks, [&](std::size_t b) {
            std::size_t i = index_at(starts_[b]);
            const std::size_t block_end = b + 1 == blocks ? count : index_at(starts_[b + 1]);
            const std::size_t last_tile = std::min(tiles, (b + 1) * block);
            double weight = starts_[b];
            std::size_t last_positive = last_slot_with_weight_before(b * block);
            for (std::size_t t = b * block; t < last_tile && i < block_end; ++t) {
                const double end = weight + film_.tile_weight[t];
                if (index_at(end) > i) {
                    double w = weight;
                    for (std::size_t s = t * Tiling::area; s < (t + 1) * Tiling::area && i < block_end; ++s) {
                        const double here = film_.weight(s);
                        if (here <= 0.0) continue;
                        w += here;
                        last_positive = s;
                        for (const std::size_t until = std::min(block_end, index_at(w)); i < until; ++i) slots[i] = static_cast<std::uint32_t>(s);
                    }
                }
                weight = end;
            }
            // Rounding may leave a draw between two sums of the same weights: it goes to the last pixel passed.
            for (; i < block_end; ++i) slots[i] = static_cast<std::uint32_t>(last_positive);
        });
    }

private:
    // Only for the draws that rounding leaves at the very start of a block; any pixel of weight will do.
    std::size_t last_slot_with_weight_before(std::size_t tile) const {
        for (std::size_t t = tile; t-- > 0;)
            if (film_.tile_weight[t] > 0.0)
                for (std::size_t s = (t + 1) * Tiling::area; s-- > t * Tiling::area;)
                    if (film_.weight(s) > 0.0f) return s;
        for (std::size_t t = tile; t < film_.tiling.tiles(); ++t)
            if (film_.tile_weight[t] > 0.0)
                for (std::size_t s = t * Tiling::area; s < (t + 1) * Tiling::area; ++s)
                    if (film_.weight(s) > 0.0f) return s;
        return 0;
    }

    const Film& film_;
    std::vector<double> starts_;
};

}  // namespace pmc

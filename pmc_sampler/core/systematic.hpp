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

// Where draws go: evenly spaced ones place members of the population, the others are samples themselves. Each kind lies in the
// order of the draws, so tile by tile.
class Shares {
public:
    // draws, and how many of them are members'; direct and member: room for those of each kind. starts: the direct ones before each
    // tile, one entry more than there are tiles; none where nobody asks.
    Shares(std::size_t draws, std::size_t members, std::uint32_t* direct, std::uint32_t* member, std::uint32_t* starts)
        : draws_(draws), members_(members), direct_(direct), member_(member), starts_(starts) {}

    struct Writer {
        std::uint32_t *direct, *member;
        std::size_t due, members, draws;

        void put(std::uint32_t slot) {
            due += members;
            const bool is_member = due >= draws;
            due -= is_member ? draws : 0;
            *(is_member ? member : direct)++ = slot;
        }
    };
    // For draw i and those that follow it.
    Writer from(std::size_t i) const {
        const std::size_t placed = i * members_ / draws_;
        return {direct_ + (i - placed), member_ + placed, i * members_ % draws_, members_, draws_};
    }
    void start(std::size_t tile, std::size_t i) const {
        if (starts_) starts_[tile] = static_cast<std::uint32_t>(i - i * members_ / draws_);
    }

private:
    std::size_t draws_, members_;
    std::uint32_t *direct_, *member_, *starts_;
};

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

    // Makes `count` draws; offset in [0, 1). total() must be above 0. `beside` is called meanwhile, on one thread.
    void operator()(std::size_t count, float offset, const Shares& to, ThreadPool& threads) const {
        (*this)(count, offset, to, threads, [] {});
    }
    template <class Beside>
    void operator()(std::size_t count, float offset, const Shares& to, ThreadPool& threads, Beside&& beside) const {
        const double scale = static_cast<double>(count) / total();
        // Draw i lies where the cumulative weight passes i, in these units. At a weight: its place, and the draws before it.
        const auto place = [&](double weight) { return weight * scale - offset; };
        const auto before = [&](double weight) {
            const double draws = std::ceil(place(weight));
            return draws <= 0.0 ? std::size_t(0) : std::min(count, static_cast<std::size_t>(draws));
        };
        const std::size_t tiles = film_.tiling.tiles();
        threads.run(starts_.size() - 1, [&](std::size_t b) {
            const std::size_t first = b * block, last = std::min(tiles, first + block), block_end = b >= last_ ? count : before(starts_[b + 1]);
            std::size_t last_with_weight = last;  // takes what rounding leaves over
            while (last_with_weight > first && !(film_.tile_weight(--last_with_weight) > 0.0)) {
            }
            double weight = starts_[b];
            std::size_t i = b > last_ ? count : std::min(before(weight), block_end);
            for (std::size_t t = first; t < last; ++t) {
                to.start(t, i);
                if (!(film_.tile_weight(t) > 0.0)) continue;
                const double tile_end = weight + film_.tile_weight(t);
                const std::size_t end = t == last_with_weight ? block_end : std::clamp(before(tile_end), i, block_end);
                // Above -1 by its definition, and by rounding no longer where the weights until then are next to nothing.
                if (end > i) draw(static_cast<std::uint32_t>(t), std::max(place(weight) - static_cast<double>(i), -1.0 + 0x1p-53), scale, end - i, to.from(i));
                weight = tile_end;
                i = end;
            }
        }, beside);
        to.start(tiles, count);
    }

private:
    // Writes `count` slots of a tile, at whose head the cumulative weight is `place` draws from the first.
    void draw(std::uint32_t tile, double place, double scale, std::size_t count, Shares::Writer to) const {
        TileWeights w;
        film_.weights(tile, w);
        std::int32_t counts[Tiling::area];
        std::uint64_t drawn[Tiling::area / 64];
        count_draws(w, scale, place, static_cast<double>(count), counts, drawn);
        std::size_t n = 0;
        for (std::uint32_t word = 0; word < Tiling::area / 64; ++word) {
            for (std::uint64_t bits = drawn[word]; bits; bits &= bits - 1) {
                const std::uint32_t i = 64 * word + static_cast<std::uint32_t>(std::countr_zero(bits));
                for (std::int32_t k = 0; k < counts[i] && n < count; ++k, ++n) to.put(tile * Tiling::area + i);
            }
        }
        if (n == count) return;
        // The sums are rounded, each in its own way: a draw that falls between them goes to the pixel with the largest weight.
        const auto some = std::max_element(std::begin(w.pixel), std::end(w.pixel)) - std::begin(w.pixel);
        for (; n < count; ++n) to.put(tile * Tiling::area + static_cast<std::uint32_t>(some));
    }

    const Film& film_;
    std::vector<double> starts_;
    double crowding_ = 0.0;
    std::size_t last_ = 0;  // block with weight
};

}  // namespace pmc

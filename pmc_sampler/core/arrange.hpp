// From proposals (film slots in any order) to a batch: sorted by tile and pixel, each sample with its index, scramble and place.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "batch.hpp"
#include "film.hpp"
#include "filter.hpp"
#include "memory.hpp"
#include "multiversion.hpp"
#include "parallel.hpp"
#include "random.hpp"
#include "tiling.hpp"

namespace pmc {

// Proposals in the order of their making; those of the pool come last, with the pass they belong to.
struct Proposals {
    Buffer<std::uint32_t> slot;
    Buffer<std::uint8_t> tag;
    Buffer<std::uint32_t> pass;  // of the last pass.size() proposals
    std::size_t size() const { return slot.size(); }
};

// The points of a pixel's low-discrepancy sequence are shared out once and for all: the first `reserved` are the pool's, a pass
// each, and what steering adds goes on from there. So all samples of a pixel are a stretch of one sequence, and are stratified
// together; yet which point a pool sample gets, and with it its expected value, depends on nothing that was seen. Passes beyond
// the reserve have a sequence of their own.
struct Sequences {
    std::uint32_t shared, beyond;  // keys
    std::uint32_t reserved;

    explicit Sequences(std::uint32_t seed) : shared(mix(seed, 2)), beyond(mix(seed, 1)), reserved(~0u) {}
};

// Scrambles from keys, in place, and places in the pixel's square in [0, 1)^2, for samples [0, n).
PMC_MULTIVERSION inline void draw_places(const std::uint32_t* pixel, const std::uint32_t* index, std::size_t n, std::uint32_t* scramble, Point2* places) {
    for (std::size_t i = 0; i < n; ++i) {
        const std::uint32_t s = mix(scramble[i], pixel[i]);
        scramble[i] = s;
        places[i] = sobol_pair(s, index[i], 0);
    }
}

class Arranger {
public:
    Arranger(const Tiling& tiling, Sequences sequences, Filter filter, double filter_radius)
        : tiling_(tiling), sequences_(sequences), filter_(filter, filter_radius) {}

    std::uint32_t reserved() const { return sequences_.reserved; }
    void reserve(std::uint32_t passes) { sequences_.reserved = passes; }

    // Advances film.drawn.
    void operator()(const Proposals& proposals, Film& film, Batch& batch, ThreadPool& threads) {
        const std::size_t n = proposals.size(), tiles = tiling_.tiles();
        const std::size_t first_pass = n - proposals.pass.size();
        // A stable counting sort by tile: one histogram for each chunk of proposals, so that the order is that of the proposals
        // whatever the number of chunks.
        const std::size_t chunks = std::max<std::size_t>(1, std::min<std::size_t>(threads.size(), n / 8192));
        counts_.resize(chunks * tiles);
        const std::uint32_t* slot = proposals.slot.data();
        threads.run(chunks, [&](std::size_t c) {
            std::uint32_t* count = counts_.data() + c * tiles;
            std::fill_n(count, tiles, 0u);
            for (std::size_t i = n * c / chunks; i < n * (c + 1) / chunks; ++i) ++count[slot[i] / Tiling::area];
        });
        starts_.resize(tiles + 1);
        std::uint32_t total = 0;
        for (std::size_t t = 0; t < tiles; ++t) {
            starts_[t] = total;
            for (std::size_t c = 0; c < chunks; ++c) {
                const std::uint32_t count = counts_[c * tiles + t];
                counts_[c * tiles + t] = total;
                total += count;
            }
        }
        starts_[tiles] = total;
        entries_.resize(n);
        threads.run(chunks, [&](std::size_t c) {
            std::uint32_t* next = counts_.data() + c * tiles;
            for (std::size_t i = n * c / chunks; i < n * (c + 1) / chunks; ++i) {
                const std::uint32_t pass = i >= first_pass ? proposals.pass[i - first_pass] : 0;
                entries_[next[slot[i] / Tiling::area]++] = {static_cast<std::uint32_t>(i), pass, static_cast<std::uint8_t>(slot[i] % Tiling::area), proposals.tag[i]};
            }
        });
        batch.positions.resize(n);
        batch.pixel.resize(n);
        batch.index.resize(n);
        batch.scramble.resize(n);
        batch.slot.resize(n);
        batch.tag.resize(n);
        batch.place.resize(batch.iteration_samples);
        threads.ranges(tiles, 4, [&](std::size_t first, std::size_t last) {
            for (std::size_t t = first; t < last; ++t)
                if (starts_[t] < starts_[t + 1]) arrange_tile(static_cast<std::uint32_t>(t), film, batch);
        });
    }

private:
    struct Entry {
        std::uint32_t proposal, pass;
        std::uint8_t local, tag;
    };

    void arrange_tile(std::uint32_t tile, Film& film, Batch& batch) {
        const std::size_t begin = starts_[tile], end = starts_[tile + 1];
        std::uint32_t next[Tiling::area] = {};
        film.touch(tile);
        const std::uint32_t base = tile * Tiling::area, x0 = tiling_.x(base), y0 = tiling_.y(base);
        for (std::size_t i = begin; i < end; ++i) ++next[entries_[i].local];
        std::uint32_t place = static_cast<std::uint32_t>(begin);
        for (std::uint32_t& count : next) {
            const std::uint32_t c = count;
            count = place;
            place += c;
        }
        for (std::size_t i = begin; i < end; ++i) {
            const Entry& e = entries_[i];
            const std::uint32_t p = next[e.local]++;
            batch.slot[p] = base + e.local;
            batch.tag[p] = e.tag;
            batch.pixel[p] = (y0 + e.local / Tiling::side) * tiling_.width + x0 + e.local % Tiling::side;
            // The pool visits a pixel once in a pass.
            const bool adaptive = !(e.tag & Tag::pool), beyond = !adaptive && e.pass >= sequences_.reserved;
            const std::uint32_t drawn = film.drawn[base + e.local];
            batch.index[p] = adaptive ? sequences_.reserved + drawn : beyond ? e.pass - sequences_.reserved : e.pass;
            batch.scramble[p] = beyond ? sequences_.beyond : sequences_.shared;
            film.drawn[base + e.local] = drawn + adaptive;
            if (e.proposal - batch.first < batch.iteration_samples) batch.place[e.proposal - batch.first] = p;
        }
        draw_places(&batch.pixel[begin], &batch.index[begin], end - begin, &batch.scramble[begin], &batch.positions[begin]);
        if (filter_.trivial()) {
            for (std::size_t p = begin; p < end; ++p) {
                const std::uint32_t local = batch.slot[p] - base;
                batch.positions[p].x = in_pixel(x0 + local % Tiling::side, batch.positions[p].x);
                batch.positions[p].y = in_pixel(y0 + local / Tiling::side, batch.positions[p].y);
            }
        } else {
            for (std::size_t p = begin; p < end; ++p) {
                const std::uint32_t local = batch.slot[p] - base;
                batch.positions[p].x = static_cast<float>(x0 + local % Tiling::side) + 0.5f + filter_(batch.positions[p].x);
                batch.positions[p].y = static_cast<float>(y0 + local / Tiling::side) + 0.5f + filter_(batch.positions[p].y);
            }
        }
    }

    Tiling tiling_;
    Sequences sequences_;
    FilterSampler filter_;
    Buffer<std::uint32_t> counts_, starts_;
    Buffer<Entry> entries_;
};

}  // namespace pmc

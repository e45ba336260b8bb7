// From proposals (film slots in any order) to a batch: sorted by tile, each sample with its index, scramble and place.
#pragma once

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <span>
#include <utility>

#include "batch.hpp"
#include "film.hpp"
#include "filter.hpp"
#include "memory.hpp"
#include "multiversion.hpp"
#include "parallel.hpp"
#include "pool.hpp"
#include "random.hpp"
#include "tiling.hpp"

namespace pmc {

// Proposals in the order of their making; members that the pool placed come last, with the pass they belong to. Samples that were
// drawn from beta lie apart, tile by tile already, and the pool's are read tile by tile.
struct Proposals {
    Buffer<std::uint32_t> slot;
    Buffer<std::uint8_t> tag;
    Buffer<std::uint32_t> pass;  // of the last pass.size() proposals
    const Pool::Stretch* pool = nullptr;
    Buffer<std::uint32_t> direct, direct_starts;  // slots, and how many come before each tile
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

// Where samples of one row of tiles lie.
struct TileRow {
    std::uint32_t first_tile, y0, width;

    TileRow(const Tiling& tiling, std::uint32_t tile) : first_tile(tile / tiling.columns * tiling.columns), y0(tile / tiling.columns * Tiling::side), width(tiling.width) {}
    [[gnu::always_inline]] std::uint32_t x(std::uint32_t slot) const { return (slot / Tiling::area - first_tile) * Tiling::side + slot % Tiling::side; }
    [[gnu::always_inline]] std::uint32_t y(std::uint32_t slot) const { return y0 + slot % Tiling::area / Tiling::side; }
};

// Pixels, scrambles from keys, in place, and places in the pixel's square in [0, 1)^2.
PMC_MULTIVERSION inline void draw_places(const TileRow row, const std::uint32_t* slot, const std::uint32_t* index, std::size_t n, std::uint32_t* pixel, std::uint32_t* scramble,
                                         Point2* places) {
    for (std::size_t i = 0; i < n; ++i) {
        pixel[i] = row.y(slot[i]) * row.width + row.x(slot[i]);
        const std::uint32_t s = mix(scramble[i], pixel[i]);
        scramble[i] = s;
        places[i] = sobol_pair(s, index[i], 0);
    }
}

// From places in the pixels' squares to positions.
PMC_MULTIVERSION inline void put_in_pixels(const TileRow row, const std::uint32_t* slot, const Point2* places, std::size_t n, Point2* positions) {
    for (std::size_t i = 0; i < n; ++i)
        positions[i] = {in_pixel(static_cast<float>(static_cast<std::int32_t>(row.x(slot[i]))), places[i].x),
                        in_pixel(static_cast<float>(static_cast<std::int32_t>(row.y(slot[i]))), places[i].y)};
}

class Arranger {
public:
    Arranger(const Tiling& tiling, Sequences sequences, Filter filter, double filter_radius)
        : tiling_(tiling), sequences_(sequences), filter_(filter, filter_radius) {}

    std::uint32_t reserved() const { return sequences_.reserved; }
    void reserve(std::uint32_t passes) { sequences_.reserved = passes; }

    // Advances film.drawn.
    void operator()(const Proposals& proposals, Film& film, Batch& batch, ThreadPool& threads) {
        const std::size_t tiles = tiling_.tiles(), direct = proposals.direct.size(), n = proposals.slot.size() + direct + proposals.pool->size();
        const std::size_t chunks = sort(proposals, threads);
        find_starts(proposals, chunks, threads);
        batch.positions.renew(n);
        batch.pixel.renew(n);
        batch.index.renew(n);
        batch.scramble.renew(n);
        batch.slot.renew(n);
        batch.tag.renew(n);
        batch.place.renew(batch.iteration_samples);
        threads.ranges(tiles, 4, [&](std::size_t first, std::size_t last) {
            for (std::size_t t = first, group = first; t < last; ++t) {
                arrange_tile(static_cast<std::uint32_t>(t), chunks, proposals, film, batch);
                if (t + 1 - group == together || t + 1 == last || (t + 1) % tiling_.columns == 0) {
                    place(TileRow(tiling_, static_cast<std::uint32_t>(t)), batch, starts_[group], starts_[t + 1]);
                    group = t + 1;
                }
            }
        });
    }

private:
    struct Entry {
        std::uint32_t proposal;
        std::uint8_t local, tag;
    };
    static constexpr std::size_t together = 8;  // tiles whose samples are placed at once: many, but still in the nearest caches

    // A stable counting sort of the proposals by tile, in several chunks: each for itself, so that no two threads write side by side.
    // Their number.
    std::size_t sort(const Proposals& proposals, ThreadPool& threads) {
        const std::size_t n = proposals.slot.size(), tiles = tiling_.tiles();
        const std::size_t chunks = std::max<std::size_t>(1, std::min<std::size_t>(threads.size(), n / 1024));
        chunk_starts_.resize(chunks * (tiles + 1));
        entries_.resize(n);
        threads.run(chunks, [&](std::size_t c) {
            const std::size_t first = n * c / chunks, last = n * (c + 1) / chunks;
            const std::uint32_t* const slot = proposals.slot.data();
            const std::uint8_t* const tag = proposals.tag.data();
            // How many there are in each tile, where its first goes, and in the end where the next tile's does: one place on each time.
            std::uint32_t* const next = chunk_starts_.data() + c * (tiles + 1);
            std::fill_n(next, tiles + 1, 0u);
            for (std::size_t i = first; i < last; ++i) ++next[slot[i] / Tiling::area + 1];
            std::uint32_t total = 0;
            for (std::size_t t = 1; t <= tiles; ++t) total += std::exchange(next[t], total);
            Entry* const entries = entries_.data() + first;
            for (std::size_t i = first; i < last; ++i)
                entries[next[slot[i] / Tiling::area + 1]++] = {static_cast<std::uint32_t>(i), static_cast<std::uint8_t>(slot[i] % Tiling::area), tag[i]};
        });
        return chunks;
    }
    // Those of a tile in one of the chunks.
    std::span<const Entry> sorted(std::size_t chunk, std::size_t chunks, std::size_t tile) const {
        const std::uint32_t* const start = chunk_starts_.data() + chunk * (tiling_.tiles() + std::size_t(1)) + tile;
        return entries_.span().subspan(entries_.size() * chunk / chunks + start[0], start[1] - start[0]);
    }

    // Where the samples of each tile begin.
    void find_starts(const Proposals& proposals, std::size_t chunks, ThreadPool& threads) {
        const std::size_t tiles = tiling_.tiles();
        starts_.resize(tiles + 1);
        starts_[0] = 0;
        threads.ranges(tiles, 256, [&](std::size_t first, std::size_t last) {
            for (std::size_t t = first; t < last; ++t) {
                std::uint32_t count = proposals.direct.size() ? proposals.direct_starts[t + 1] - proposals.direct_starts[t] : 0;
                for (std::size_t c = 0; c < chunks; ++c) count += static_cast<std::uint32_t>(sorted(c, chunks, t).size());
                starts_[t + 1] = count + proposals.pool->count(static_cast<std::uint32_t>(t));
            }
        });
        for (std::size_t t = 1; t <= tiles; ++t) starts_[t] += starts_[t - 1];
    }

    // The samples of a tile: those of beta, pixel by pixel, the proposals, the pool's.
    void arrange_tile(std::uint32_t tile, std::size_t chunks, const Proposals& proposals, Film& film, Batch& batch) {
        std::size_t p = starts_[tile];
        if (p == starts_[tile + 1]) return;
        film.touch(tile);
        const std::uint32_t base = tile * Tiling::area;
        std::uint32_t* const slots = batch.slot.data(), *const index = batch.index.data(), *const scramble = batch.scramble.data(), *const drawn = &film.drawn[base];
        std::uint8_t* const tags = batch.tag.data();
        const Sequences sequences = sequences_;
        const auto put_adaptive = [&](std::uint32_t local, std::uint8_t tag) {
            slots[p] = base + local;
            tags[p] = tag;
            index[p] = sequences.reserved + drawn[local]++;
            scramble[p++] = sequences.shared;
        };
        const auto put_pool = [&](std::uint32_t local, std::uint32_t pass) {  // it visits a pixel once in a pass
            const bool beyond = pass >= sequences.reserved;
            slots[p] = base + local;
            tags[p] = Tag::pool | Tag::no_kernel;
            index[p] = beyond ? pass - sequences.reserved : pass;
            scramble[p++] = beyond ? sequences.beyond : sequences.shared;
        };
        if (proposals.direct.size())
            for (std::size_t i = proposals.direct_starts[tile]; i < proposals.direct_starts[tile + 1]; ++i) put_adaptive(proposals.direct[i] % Tiling::area, Tag::no_kernel);
        const std::size_t first_pass = proposals.slot.size() - proposals.pass.size();
        for (std::size_t c = 0; c < chunks; ++c) {
            for (const Entry& e : sorted(c, chunks, tile)) {
                if (e.proposal < batch.iteration_samples) batch.place[e.proposal] = static_cast<std::uint32_t>(p);
                if (e.proposal < first_pass)
                    put_adaptive(e.local, e.tag);
                else
                    put_pool(e.local, proposals.pass[e.proposal - first_pass]);
            }
        }
        proposals.pool->in_tile(tile, put_pool);
    }

    // From pixels to places in them or, by the filter, around them.
    void place(const TileRow row, Batch& batch, std::size_t begin, std::size_t end) const {
        Point2 u[256];
        for (std::size_t first = begin, n; first < end; first += n) {
            n = std::min(end - first, std::size(u));
            const std::uint32_t* slot = &batch.slot[first];
            draw_places(row, slot, &batch.index[first], n, &batch.pixel[first], &batch.scramble[first], u);
            Point2* at = &batch.positions[first];
            if (filter_.trivial())
                put_in_pixels(row, slot, u, n, at);
            else
                for (std::size_t i = 0; i < n; ++i)
                    at[i] = {static_cast<float>(row.x(slot[i])) + 0.5f + filter_(u[i].x), static_cast<float>(row.y(slot[i])) + 0.5f + filter_(u[i].y)};
        }
    }

    Tiling tiling_;
    Sequences sequences_;
    FilterSampler filter_;
    Buffer<std::uint32_t> starts_;  // of each tile in the batch
    Buffer<std::uint32_t> chunk_starts_;  // chunk by chunk, of each tile among the chunk's entries
    Buffer<Entry> entries_;
};

}  // namespace pmc

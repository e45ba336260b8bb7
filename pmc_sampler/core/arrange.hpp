// From proposals (film slots in any order) to a batch: sorted by tile and pixel, each sample with its index, scramble and place.
#pragma once

#include <algorithm>
#include <bit>
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
#include "random.hpp"
#include "tiling.hpp"

namespace pmc {

// Proposals in the order of their making; those of the pool come last, with the pass they belong to. Samples that were drawn from
// beta lie apart, tile by tile already.
struct Proposals {
    Buffer<std::uint32_t> slot;
    Buffer<std::uint8_t> tag;
    Buffer<std::uint32_t> pass;  // of the last pass.size() proposals
    Buffer<std::uint32_t> direct, direct_starts;  // slots, and how many come before each tile (Shares)
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
        const std::size_t n = proposals.slot.size(), tiles = tiling_.tiles(), direct = proposals.direct.size();
        const std::size_t first_pass = n - proposals.pass.size();
        // A stable counting sort by tile: one histogram for each chunk of proposals, so that the order is that of the proposals
        // whatever the number of chunks.
        const std::size_t chunks = std::max<std::size_t>(1, std::min<std::size_t>(threads.size(), n / 16384));
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
        batch.positions.renew(n + direct);
        batch.pixel.renew(n + direct);
        batch.index.renew(n + direct);
        batch.scramble.renew(n + direct);
        batch.slot.renew(n + direct);
        batch.tag.renew(n + direct);
        batch.place.renew(batch.iteration_samples);
        threads.ranges(tiles, 4, [&](std::size_t first, std::size_t last) {
            const auto start = [&](std::size_t t) { return starts_[t] + (direct ? proposals.direct_starts[t] : 0); };
            for (std::size_t t = first, group = first; t < last; ++t) {
                const auto of_beta = direct ? proposals.direct.span().subspan(proposals.direct_starts[t], proposals.direct_starts[t + 1] - proposals.direct_starts[t])
                                            : std::span<const std::uint32_t>();
                const std::span<const Entry> others = entries_.span().subspan(starts_[t], starts_[t + 1] - starts_[t]);
                if (!of_beta.empty() || !others.empty()) arrange_tile(static_cast<std::uint32_t>(t), start(t), of_beta, others, film, batch);
                if (t + 1 - group == together || t + 1 == last) {
                    place(batch, start(group), start(t + 1));
                    group = t + 1;
                }
            }
        });
    }

private:
    struct Entry {
        std::uint32_t proposal, pass;
        std::uint8_t local, tag;
    };
    static constexpr std::size_t together = 8;  // tiles whose samples are placed at once: many, but still in the nearest caches

    // The samples of a tile, `begin` the first of them in the batch: sorted by pixel, and in each those of beta first.
    void arrange_tile(std::uint32_t tile, std::size_t begin, std::span<const std::uint32_t> of_beta, std::span<const Entry> others, Film& film, Batch& batch) {
        film.touch(tile);
        const std::uint32_t base = tile * Tiling::area, x0 = tiling_.x(base), y0 = tiling_.y(base);
        std::uint32_t next[Tiling::area] = {};
        std::uint64_t seen[Tiling::area / 64] = {};  // a bit for each pixel that has samples: often few of the tile's have
        const auto count = [&](std::uint32_t local) {
            ++next[local];
            seen[local / 64] |= std::uint64_t(1) << local % 64;
        };
        for (const std::uint32_t slot : of_beta) count(slot % Tiling::area);
        for (const Entry& e : others) count(e.local);
        auto place = static_cast<std::uint32_t>(begin);
        for (std::uint32_t word = 0; word < Tiling::area / 64; ++word)
            for (std::uint64_t bits = seen[word]; bits; bits &= bits - 1) place += std::exchange(next[64 * word + static_cast<std::uint32_t>(std::countr_zero(bits))], place);
        const auto put = [&](std::uint32_t local, std::uint8_t tag, std::uint32_t pass) {
            const std::uint32_t p = next[local]++;
            batch.slot[p] = base + local;
            batch.tag[p] = tag;
            const std::uint32_t x = x0 + local % Tiling::side, y = y0 + local / Tiling::side;
            batch.pixel[p] = y * tiling_.width + x;
            batch.positions[p] = {static_cast<float>(x), static_cast<float>(y)};
            // The pool visits a pixel once in a pass.
            const bool adaptive = !(tag & Tag::pool), beyond = !adaptive && pass >= sequences_.reserved;
            const std::uint32_t drawn = film.drawn[base + local];
            batch.index[p] = adaptive ? sequences_.reserved + drawn : beyond ? pass - sequences_.reserved : pass;
            batch.scramble[p] = beyond ? sequences_.beyond : sequences_.shared;
            film.drawn[base + local] = drawn + adaptive;
            return p;
        };
        for (const std::uint32_t slot : of_beta) put(slot % Tiling::area, Tag::no_kernel, 0);
        for (const Entry& e : others) {
            const std::uint32_t p = put(e.local, e.tag, e.pass);
            if (e.proposal < batch.iteration_samples) batch.place[e.proposal] = p;
        }
    }

    // From pixels' corners to places in them or, by the filter, around them.
    void place(Batch& batch, std::size_t begin, std::size_t end) const {
        Point2 u[256];
        for (std::size_t first = begin, n; first < end; first += n) {
            n = std::min(end - first, std::size(u));
            draw_places(&batch.pixel[first], &batch.index[first], n, &batch.scramble[first], u);
            Point2* at = &batch.positions[first];
            if (filter_.trivial())
                for (std::size_t i = 0; i < n; ++i) at[i] = {in_pixel(at[i].x, u[i].x), in_pixel(at[i].y, u[i].y)};
            else
                for (std::size_t i = 0; i < n; ++i) at[i] = {at[i].x + 0.5f + filter_(u[i].x), at[i].y + 0.5f + filter_(u[i].y)};
        }
    }

    Tiling tiling_;
    Sequences sequences_;
    FilterSampler filter_;
    Buffer<std::uint32_t> counts_, starts_;
    Buffer<Entry> entries_;
};

}  // namespace pmc

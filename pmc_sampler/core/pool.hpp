// The stratified pool (paper, section 4.3.2): every pixel once in each pass, in an order whose every stretch covers the image
// evenly. Place r of a pass names one pixel in each tile, by a (0,2)-sequence in the tile; tiles follow in golden-ratio steps.
#pragma once

#include <cstdint>
#include <numeric>
#include <vector>

#include "random.hpp"
#include "tiling.hpp"

namespace pmc {

class Pool {
public:
    // A part of the pool's order, to be read tile by tile. Of a place of a pass it has all tiles, but for its first and last.
    class Stretch {
    public:
        std::size_t size() const { return size_; }

        // Calls emit(local, pass) for its pixels in a tile, in their order; `local`: the pixel's place in its tile.
        template <class Emit>
        void in_tile(std::uint32_t tile, Emit&& emit) const {
            std::uint32_t pass = 0, flip = flips_of(tile, pass);
            const bool at_border = tiling_.at_border(tile);
            for (const Place& p : places_) {
                if (!p.whole && !(some_[tile] & (&p == &places_.front() ? in_first : in_last))) continue;
                if (p.pass != pass) flip = flips_of(tile, pass = p.pass);
                const std::uint32_t local = p.local ^ flip;
                if (!at_border || tiling_.inside(tile * Tiling::area + local)) emit(local, pass);
            }
        }

    private:
        friend class Pool;
        struct Place {
            std::uint32_t local, pass;
            bool whole;
        };
        enum : std::uint8_t { in_first = 1, in_last = 2 };

        explicit Stretch(const Tiling& tiling, std::uint32_t seed) : tiling_(tiling), seed_(seed) {}
        // The exclusive or keeps the sequence's strata and gives each tile and pass an order of its own.
        std::uint32_t flips_of(std::uint32_t tile, std::uint32_t pass) const { return hash32(tile ^ mix(seed_, pass)) & (Tiling::area - 1); }

        Tiling tiling_;
        std::uint32_t seed_;
        std::size_t size_ = 0;
        std::vector<Place> places_;
        std::vector<std::uint8_t> some_;  // of each tile, whether it is in the first and in the last place
    };

    Pool(const Tiling& tiling, std::uint32_t seed)
        : tiling_(tiling), seed_(hash32(seed ^ 0x5a4c9e1bu)), stride_(golden(tiling.tiles())), stretch_(tiling, seed_) {
        for (std::uint32_t tile = 0; tile < tiling.tiles(); ++tile)
            if (tiling.at_border(tile)) at_border_.push_back(tile);
    }

    // The next `count` pixels of the pool; until the next are taken.
    const Stretch& take(std::size_t count) {
        const std::uint32_t tiles = tiling_.tiles();
        Stretch& s = stretch_;
        s.size_ = count;
        s.places_.clear();
        s.some_.assign(tiles, 0);
        while (count > 0) {
            const std::uint32_t step = static_cast<std::uint32_t>(cursor_ % tiles);
            const auto pass = static_cast<std::uint32_t>(cursor_ / tiling_.slots()), rank = static_cast<std::uint32_t>(cursor_ % tiling_.slots() / tiles);
            const std::uint32_t local = in_tile(rank);
            std::size_t pixels = tiles;
            for (const std::uint32_t tile : at_border_) pixels -= !tiling_.inside(tile * Tiling::area + (local ^ s.flips_of(tile, pass)));
            const bool whole = step == 0 && pixels <= count;
            const auto which = static_cast<std::uint8_t>(s.places_.empty() ? Stretch::in_first : Stretch::in_last);
            s.places_.push_back({local, pass, whole});
            if (whole) {
                count -= pixels;
                cursor_ += tiles;
            } else {
                walk(count, [&](std::uint32_t slot, std::uint32_t) { s.some_[slot / Tiling::area] |= which; });
            }
        }
        return s;
    }
    // The same one by one, as emit(slot, pass) in the order of the pool.
    template <class Emit>
    void take(std::size_t count, Emit&& emit) {
        while (count > 0) walk(count, emit);
    }

    std::uint64_t cursor() const { return cursor_; }
    void set_cursor(std::uint64_t cursor) { cursor_ = cursor; }

private:
    // Calls emit(slot, pass) for the pixels that are left of a place, or as many as `count`, which becomes less by their number.
    template <class Emit>
    void walk(std::size_t& count, Emit&& emit) {
        const std::uint32_t tiles = tiling_.tiles();
        const auto pass = static_cast<std::uint32_t>(cursor_ / tiling_.slots()), rank = static_cast<std::uint32_t>(cursor_ % tiling_.slots() / tiles);
        auto step = static_cast<std::uint32_t>(cursor_ % tiles);
        const std::uint32_t start = mix(seed_ ^ pass, rank) % tiles, local = in_tile(rank);
        auto tile = static_cast<std::uint32_t>((start + std::uint64_t(step) * stride_) % tiles);
        for (; step < tiles && count > 0; ++step, ++cursor_) {
            const std::uint32_t slot = tile * Tiling::area + (local ^ stretch_.flips_of(tile, pass));
            tile += stride_;
            if (tile >= tiles) tile -= tiles;
            if (!at_border_.empty() && !tiling_.inside(slot)) continue;
            emit(slot, pass);
            --count;
        }
    }

    // The rank-th point of the Sobol (0,2)-sequence on the 16x16 grid.
    static std::uint32_t in_tile(std::uint32_t rank) {
        std::uint32_t t = rank;
        t ^= (t >> 1) & 0x55u;
        t ^= (t >> 2) & 0x33u;
        t ^= (t >> 4) & 0x0fu;
        const std::uint32_t x = reverse_bits(rank) >> 28, y = reverse_bits(t) >> 28;
        return y * Tiling::side + x;
    }
    static std::uint32_t golden(std::uint32_t tiles) {
        std::uint32_t stride = static_cast<std::uint32_t>(tiles * 0.6180339887498949);
        while (stride > 1 && std::gcd(stride, tiles) != 1) --stride;
        return stride ? stride % tiles : 0;
    }

    Tiling tiling_;
    std::uint32_t seed_, stride_;
    std::uint64_t cursor_ = 0;  // counts slots, padding included
    std::vector<std::uint32_t> at_border_;  // tiles with padding
    Stretch stretch_;
};

}  // namespace pmc

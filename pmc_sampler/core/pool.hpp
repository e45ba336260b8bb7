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
    // A part of the pool's order, to be read tile by tile.
    class Stretch {
    public:
        std::size_t size() const { return size_; }

        // Calls emit(local, pass) for its pixels in a tile, a pixel's passes in turn; `local`: the pixel's place in its tile.
        template <class Emit>
        void in_tile(std::uint32_t tile, Emit&& emit) const {
            const bool at_border = tiling_.at_border(tile);
            const auto one = [&](std::uint32_t local, std::uint32_t pass) {
                if (!at_border || tiling_.inside(tile * Tiling::area + local)) emit(local, pass);
            };
            std::uint32_t pass = 0, flip = flip_of(tile, pass);
            for (const Round& round : rounds_) {
                if (round.passes > 0) {  // the samples of a pixel together
                    for (std::uint32_t local = 0; local < Tiling::area; ++local)
                        for (std::uint32_t k = 0; k < round.passes; ++k) one(local, round.pass + k);
                } else if (some_[tile] & round.tiles) {
                    if (round.pass != pass) flip = flip_of(tile, pass = round.pass);
                    one(round.local ^ flip, pass);
                }
            }
        }
        // How many those are.
        std::uint32_t count(std::uint32_t tile) const {
            std::uint32_t count = 0;
            if (tiling_.at_border(tile))
                in_tile(tile, [&](std::uint32_t, std::uint32_t) { ++count; });
            else
                for (const Round& round : rounds_) count += round.passes > 0 ? round.passes * Tiling::area : (some_[tile] & round.tiles) != 0;
            return count;
        }

    private:
        friend class Pool;
        enum Tiles : std::uint8_t { all = 1, of_first = 2, of_last = 4 };
        struct Round {  // one place of a pass in each of its tiles; or whole passes, from `pass` on
            std::uint32_t local, pass, passes;
            Tiles tiles;
        };

        Stretch(const Tiling& tiling, std::uint32_t seed) : tiling_(tiling), seed_(seed) {}
        // The exclusive or keeps the sequence's strata and gives each tile and pass an order of its own.
        std::uint32_t flip_of(std::uint32_t tile, std::uint32_t pass) const { return hash32(tile ^ mix(seed_, pass)) & (Tiling::area - 1); }

        Tiling tiling_;
        std::uint32_t seed_;
        std::size_t size_ = 0;
        std::vector<Round> rounds_;       // of all tiles, but for the first and the last
        std::vector<std::uint8_t> some_;  // which Tiles each tile is one of
    };

    Pool(const Tiling& tiling, std::uint32_t seed)
        : tiling_(tiling), seed_(hash32(seed ^ 0x5a4c9e1bu)), stride_(golden(tiling.tiles())), stretch_(tiling, seed_) {
        for (std::uint32_t tile = 0; tile < tiling.tiles(); ++tile)
            if (tiling.at_border(tile)) at_border_.push_back(tile);
    }

    // The next `count` pixels of the pool; until the next are taken.
    const Stretch& take(std::size_t count) {
        Stretch& s = stretch_;
        s.size_ = count;
        s.rounds_.clear();
        s.some_.assign(tiling_.tiles(), Stretch::all);
        while (count > 0) {
            if (cursor_ % tiling_.slots() == 0 && tiling_.pixels() <= count) {
                const std::size_t passes = count / tiling_.pixels();
                s.rounds_.push_back({0, pass(), static_cast<std::uint32_t>(passes), Stretch::all});
                cursor_ += passes * tiling_.slots();
                count -= passes * tiling_.pixels();
                continue;
            }
            const std::uint32_t local = in_tile(rank());
            std::size_t pixels = tiling_.tiles();
            for (const std::uint32_t tile : at_border_) pixels -= !tiling_.inside(tile * Tiling::area + (local ^ s.flip_of(tile, pass())));
            if (cursor_ % tiling_.tiles() == 0 && pixels <= count) {
                s.rounds_.push_back({local, pass(), 0, Stretch::all});
                cursor_ += tiling_.tiles();
                count -= pixels;
            } else {
                const Stretch::Tiles tiles = s.rounds_.empty() ? Stretch::of_first : Stretch::of_last;
                s.rounds_.push_back({local, pass(), 0, tiles});
                walk(count, [&](std::uint32_t tile) { s.some_[tile] |= tiles; });
            }
        }
        return s;
    }
    // The same one by one, as emit(slot, pass) in the order of the pool.
    template <class Emit>
    void take(std::size_t count, Emit&& emit) {
        while (count > 0) {
            const std::uint32_t pass = this->pass(), local = in_tile(rank());
            walk(count, [&](std::uint32_t tile) { emit(tile * Tiling::area + (local ^ stretch_.flip_of(tile, pass)), pass); });
        }
    }

    std::uint64_t cursor() const { return cursor_; }
    void set_cursor(std::uint64_t cursor) { cursor_ = cursor; }

private:
    std::uint32_t pass() const { return static_cast<std::uint32_t>(cursor_ / tiling_.slots()); }
    std::uint32_t rank() const { return static_cast<std::uint32_t>(cursor_ % tiling_.slots() / tiling_.tiles()); }

    // Calls visit(tile) for the tiles of which a place of a pass has pixels left, or as many as `count`, which becomes less by their
    // number.
    template <class Visit>
    void walk(std::size_t& count, Visit&& visit) {
        const std::uint32_t tiles = tiling_.tiles(), pass = this->pass(), start = mix(seed_ ^ pass, rank()) % tiles, local = in_tile(rank());
        auto step = static_cast<std::uint32_t>(cursor_ % tiles);
        auto tile = static_cast<std::uint32_t>((start + std::uint64_t(step) * stride_) % tiles);
        for (; step < tiles && count > 0; ++step, ++cursor_) {
            const std::uint32_t here = tile;
            tile += stride_;
            if (tile >= tiles) tile -= tiles;
            if (!at_border_.empty() && !tiling_.inside(here * Tiling::area + (local ^ stretch_.flip_of(here, pass)))) continue;
            visit(here);
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

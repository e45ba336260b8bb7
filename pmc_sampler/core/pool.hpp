// The stratified pool (paper, section 4.3.2): every pixel once in each pass, in an order whose every stretch covers the image
// evenly. Place r of a pass names one pixel in each tile, by a (0,2)-sequence in the tile; tiles follow in golden-ratio steps.
#pragma once

#include <cstdint>
#include <numeric>

#include "parallel.hpp"
#include "random.hpp"
#include "tiling.hpp"

namespace pmc {

class Pool {
public:
    Pool(const Tiling& tiling, std::uint32_t seed) : tiling_(tiling), seed_(hash32(seed ^ 0x5a4c9e1bu)), stride_(golden(tiling.tiles())) {}

    // Calls emit(slot, pass) for the next `count` pixels of the pool.
    template <class Emit>
    void take(std::size_t count, Emit&& emit) {
        cursor_ = from(cursor_, count, emit);
    }
    // Writes them.
    void take(std::size_t count, std::uint32_t* slots, std::uint32_t* passes, ThreadPool& threads) {
        const auto piece = [&](std::size_t first, std::size_t last) {
            std::size_t i = first;
            return from(cursor_ + first, last - first, [&](std::uint32_t slot, std::uint32_t pass) {
                slots[i] = slot;
                passes[i++] = pass;
            });
        };
        if (tiling_.has_padding()) {  // how many places there are before a piece, only those before can tell
            cursor_ = piece(0, count);
        } else {
            threads.ranges(count, 16384, piece);
            cursor_ += count;
        }
    }

    std::uint64_t cursor() const { return cursor_; }
    void set_cursor(std::uint64_t cursor) { cursor_ = cursor; }

private:
    // Calls emit(slot, pass) for `count` pixels from a place on, and returns the place after them.
    template <class Emit>
    std::uint64_t from(std::uint64_t cursor, std::size_t count, Emit&& emit) const {
        const std::uint32_t tiles = tiling_.tiles();
        const bool padded = tiling_.has_padding();
        while (count > 0) {
            const std::uint32_t pass = static_cast<std::uint32_t>(cursor / tiling_.slots());
            const std::uint64_t place = cursor % tiling_.slots();
            const std::uint32_t rank = static_cast<std::uint32_t>(place / tiles);
            std::uint32_t step = static_cast<std::uint32_t>(place % tiles);
            const std::uint32_t start = mix(seed_ ^ pass, rank) % tiles;
            std::uint32_t tile = static_cast<std::uint32_t>((start + std::uint64_t(step) * stride_) % tiles);
            const std::uint32_t local = in_tile(rank), key = mix(seed_, pass);
            for (; step < tiles && count > 0; ++step, ++cursor) {
                // The exclusive or keeps the sequence's strata and gives each tile and pass an order of its own.
                const std::uint32_t slot = tile * Tiling::area + (local ^ (hash32(tile ^ key) & (Tiling::area - 1)));
                tile += stride_;
                if (tile >= tiles) tile -= tiles;
                if (padded && !tiling_.inside(slot)) continue;
                emit(slot, pass);
                --count;
            }
        }
        return cursor;
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
};

}  // namespace pmc

// A stretch of the pool, read tile by tile, against the pool one by one.
#include <algorithm>
#include <compare>

#include <pool.hpp>

#include "piece.hpp"

namespace {

struct Visit {
    std::uint32_t slot, pass;
    auto operator<=>(const Visit&) const = default;
};

// By slot; the passes of a pixel as they came.
std::vector<Visit> by_tile(const pmc::Pool::Stretch& stretch, const pmc::Tiling& tiling) {
    std::vector<Visit> visits;
    for (std::uint32_t tile = 0; tile < tiling.tiles(); ++tile) {
        const std::size_t first = visits.size();
        stretch.in_tile(tile, [&](std::uint32_t local, std::uint32_t pass) {
            require(local < pmc::Tiling::area, "a pixel lies in its tile");
            visits.push_back({tile * pmc::Tiling::area + local, pass});
        });
        require(stretch.count(tile) == visits.size() - first, "a stretch counts what it has in a tile");
        const auto by_slot = [](const Visit& a, const Visit& b) { return a.slot < b.slot; };
        std::stable_sort(visits.begin() + static_cast<std::ptrdiff_t>(first), visits.end(), by_slot);
    }
    return visits;
}

std::vector<Visit> one_by_one(pmc::Pool& pool, std::size_t count) {
    std::vector<Visit> visits;
    pool.take(count, [&](std::uint32_t slot, std::uint32_t pass) {
        require(visits.empty() || visits.back().pass <= pass, "the pool goes from pass to pass");
        visits.push_back({slot, pass});
    });
    std::sort(visits.begin(), visits.end());
    return visits;
}

// How many to take next, of `left` until the end of a pass.
std::size_t some(std::size_t pixels, std::size_t left) {
    const auto n = static_cast<std::uint32_t>(pixels);
    switch (below(8)) {
    case 0: return 0;
    case 1: return 1;
    case 2: return 2 + below(20);
    case 3: return left;
    case 4: return left + pixels * below(4);
    case 5: return pixels * (1 + below(3));
    case 6: return 1 + below(n);
    default: return 1 + below(4 * n);
    }
}

void follow_pool(std::uint32_t width, std::uint32_t height, int takes) {
    const pmc::Tiling tiling(width, height);
    const auto seed = static_cast<std::uint32_t>(generator());
    pmc::Pool a(tiling, seed), b(tiling, seed);
    std::vector<std::uint32_t> passes(tiling.slots(), 0);  // that each pixel had
    std::size_t taken = 0;
    for (int k = 0; k < takes; ++k) {
        const std::size_t pixels = tiling.pixels(), count = some(pixels, pixels - taken % pixels);
        at = size_of(width, height) + ", seed " + std::to_string(seed) + ", " + std::to_string(count) + " after " + std::to_string(taken);
        if (below(2)) std::swap(a, b);
        const pmc::Pool::Stretch& stretch = a.take(count);
        const std::vector<Visit> visits = by_tile(stretch, tiling);
        require(stretch.size() == count && visits.size() == count, "a stretch is as long as was asked for");
        require(std::is_sorted(visits.begin(), visits.end()), "the passes of a pixel follow in turn");
        require(visits == one_by_one(b, count), "a stretch has the pixels that come one by one");
        // Padding that follows the last pixel may be left behind or not: what comes next is the same.
        require(a.cursor() == b.cursor() || tiling.pixels() < tiling.slots(), "both ways end at the same place");
        taken += count;
        for (const Visit& v : visits) {
            require(tiling.inside(v.slot), "a pixel lies in the image");
            require(v.pass == passes[v.slot]++, "a pixel comes once in each pass");
        }
        for (std::uint32_t slot = 0; slot < passes.size(); ++slot)
            require(!tiling.inside(slot) || passes[slot] - taken / pixels <= (taken % pixels ? 1 : 0), "a pass ends before the next begins");
        if (below(4) == 0) {
            pmc::Pool again(tiling, seed);
            again.set_cursor(a.cursor());
            std::swap(a, again);
        }
    }
}

void test() {
    const Size sizes[] = {{1, 1}, {1, 9}, {13, 1}, {15, 16}, {16, 16}, {17, 16}, {32, 16}, {33, 21}, {48, 48}, {64, 48}, {100, 37}};
    for (const auto& [width, height] : sizes)
        for (int k = 0; k < 3; ++k) follow_pool(width, height, 30);
    for (int k = 0; k < 60; ++k) {
        const bool whole = below(3) == 0;
        follow_pool(whole ? 16 * (1 + below(5)) : 1 + below(80), whole ? 16 * (1 + below(5)) : 1 + below(60), 20);
    }
}

}  // namespace

int main() { return report(test); }

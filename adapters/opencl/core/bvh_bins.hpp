// What a split by the surface area heuristic (SAH) weighs, and the best split of a range by bins (Wald 2007,
// doi:10.1109/RT.2007.4342588).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <limits>

#include "bvh_box.hpp"

namespace bvh {

inline constexpr int bin_count = 16;

// What the chance that a ray meets a box, and the work within it, are taken to grow with.
struct Measure {
    std::size_t packet = 1;  // primitives that are tested together
    double margin = 1;

    Measure() = default;
    Measure(std::size_t together, const Box& all) : packet(together) {
        double side = 0;
        for (int a = 0; a < 3; ++a) side = std::max(side, double(all.upper[a]) - all.lower[a]);
        if (side > 0) margin = 1e-7 * side;
    }
    // Half the surface. The margin keeps lines and points apart, whose surface is 0: for them the extent counts. Doubles hold
    // the squares of any float, the largest and the smallest.
    double area(const Box& b) const {
        const double x = double(b.upper[0]) - b.lower[0] + margin, y = double(b.upper[1]) - b.lower[1] + margin,
                     z = double(b.upper[2]) - b.lower[2] + margin;
        return x * y + y * z + z * x;
    }
    std::size_t packets(std::size_t count) const { return (count + packet - 1) / packet; }
};

struct Extent {
    Box box = Box::nothing(), centres = Box::nothing();

    void add(const Primitive& p) {
        float c[4];
        p.centre(c);
        box.add(p.box);
        centres.add_point(c);
    }
    void add(const Extent& e) {
        box.add(e.box);
        centres.add(e.centres);
    }
};

// From a centre to its bin on each axis. An axis without extent, or with one so small that the scale overflows, has but one
// bin; on any other the least centre falls in the first bin and the greatest in the last.
struct Grid {
    float origin[3], scale[3];

    explicit Grid(const Box& centres) {
        for (int a = 0; a < 3; ++a) {
            origin[a] = centres.lower[a];
            scale[a] = bin_count / (centres.upper[a] - centres.lower[a]);
            if (!std::isfinite(scale[a])) scale[a] = 0;
        }
    }
    bool flat() const { return scale[0] == 0 && scale[1] == 0 && scale[2] == 0; }
    int bin(const Primitive& p, int a) const {
        return std::min(bin_count - 1, static_cast<int>((p.centre(a) - origin[a]) * scale[a]));
    }
};

struct Bins {
    Box box[3][bin_count];
    std::uint32_t count[3][bin_count] = {};

    Bins() {
        for (auto& axis : box) std::fill(std::begin(axis), std::end(axis), Box::nothing());
    }
    void add(const Primitive& p, const Grid& grid) {
        for (int a = 0; a < 3; ++a) {
            const int k = grid.bin(p, a);
            box[a][k].add(p.box);
            ++count[a][k];
        }
    }
    void add(const Bins& b) {
        for (int a = 0; a < 3; ++a)
            for (int k = 0; k < bin_count; ++k) {
                box[a][k].add(b.box[a][k]);
                count[a][k] += b.count[a][k];
            }
    }
};

struct Split {
    double cost = std::numeric_limits<double>::infinity();
    int axis = 0, bin = 0;  // bins up to this one go left

    bool left(const Primitive& p, const Grid& grid) const { return grid.bin(p, axis) <= bin; }
};

// The split between two bins at the least cost, with primitives on both sides; its cost stays infinite where no axis has one.
inline Split best_split(const Bins& bins, const Grid& grid, const Measure& measure) {
    Split best;
    for (int a = 0; a < 3; ++a) {
        if (grid.scale[a] == 0) continue;
        double right_cost[bin_count];
        Box box = Box::nothing();
        std::size_t count = 0;
        for (int k = bin_count - 1; k > 0; --k) {
            if (bins.count[a][k]) box.add(bins.box[a][k]);
            count += bins.count[a][k];
            right_cost[k] = count ? measure.area(box) * measure.packets(count) : std::numeric_limits<double>::infinity();
        }
        box = Box::nothing();
        count = 0;
        for (int k = 0; k < bin_count - 1; ++k) {
            if (!bins.count[a][k]) continue;
            box.add(bins.box[a][k]);
            count += bins.count[a][k];
            const double cost = measure.area(box) * measure.packets(count) + right_cost[k + 1];
            if (cost < best.cost) best = {cost, a, k};
        }
    }
    return best;
}

}  // namespace bvh

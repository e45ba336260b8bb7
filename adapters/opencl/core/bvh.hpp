// A bounding volume hierarchy, eight children wide, over boxes: a binary tree (bvh_binary.hpp), cut into wide nodes
// (bvh_wide.hpp). The result depends on the boxes and the packet size alone: how work is cut into pieces never depends on the
// number of threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "../../../pmc_sampler/core/parallel.hpp"
#include "bvh_binary.hpp"
#include "bvh_box.hpp"
#include "bvh_wide.hpp"

namespace bvh {

// What is wrong with a box; nothing, if it has no fault.
inline const char* fault(const float* lower, const float* upper) {
    const char* found = nullptr;
    for (int a = 0; a < 3; ++a) {
        if (!(std::isfinite(lower[a]) && std::isfinite(upper[a]))) return "has a corner that is not finite";
        if (lower[a] > upper[a]) found = "has lower > upper";
    }
    return found;
}

// Throws std::invalid_argument for the first box with a fault.
inline std::vector<Primitive> read(std::size_t count, const float* lower, const float* upper, pmc::ThreadPool& pool) {
    std::vector<Primitive> primitives(count);
    std::atomic<bool> faulty{false};
    pool.ranges(count, piece, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            Primitive& p = primitives[i];
            std::copy_n(lower + 3 * i, 3, p.box.lower);
            std::copy_n(upper + 3 * i, 3, p.box.upper);
            p.number(static_cast<std::uint32_t>(i));
            if (fault(p.box.lower, p.box.upper)) faulty = true;
        }
    });
    for (std::size_t i = 0; faulty && i < count; ++i)
        if (const char* found = fault(primitives[i].box.lower, primitives[i].box.upper))
            throw std::invalid_argument("box " + std::to_string(i) + " " + found);
    return primitives;
}

// The corners are count triples of floats each, count from 1 to max_primitives; packet is at least 1.
inline Tree build(std::size_t count, const float* lower, const float* upper, std::size_t packet, unsigned threads) {
    pmc::ThreadPool pool(threads);
    return WideBuilder(BinaryBuilder(read(count, lower, upper, pool), packet, pool).build(), pool).build();
}

}  // namespace bvh

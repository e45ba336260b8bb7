// A batch of positions: what a renderer reads, and beside it what the sampler needs to put the answers back.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "memory.hpp"
#include "random.hpp"

namespace pmc {

// Who proposed a sample: bits 0 and 1 the kernel's radius, or none; bit 2 the pool's stream, whose sequence is its own.
struct Tag {
    static constexpr std::uint8_t no_kernel = 3, kernel_mask = 3, pool = 4;
};

struct Batch {
    // For the renderer, in an order that keeps neighbours in the image together; see the Python class for each.
    Buffer<Point2> positions;
    Buffer<std::uint32_t> pixel, index, scramble;
    std::uint64_t number = 0;
    std::uint64_t owner = 0;  // the sampler that drew it

    std::size_t size() const { return pixel.size(); }

    // For the sampler.
    Buffer<std::uint32_t> slot;  // film slot of each sample
    Buffer<std::uint8_t> tag;
    std::uint64_t iteration_samples = 0;   // proposals of the population: all moves of each member, then the regenerated
    std::vector<std::uint32_t> evaluated;  // those regenerated members
    std::uint64_t first = 0;               // the first of these proposals
    Buffer<std::uint32_t> place;           // where the sample of each of these proposals lies in the batch
};

}  // namespace pmc

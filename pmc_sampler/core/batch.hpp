// A batch of positions: what a renderer reads, and beside it what the sampler needs to put the answers back.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <utility>
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
    Buffer<std::uint32_t> place;           // where the sample of each of these proposals lies in the batch
};

// Batches that nobody holds any more, to be filled again: memory that was never touched costs more than what is written to it.
class Batches {
public:
    std::shared_ptr<Batch> take() {
        std::unique_ptr<Batch> batch;
        {
            const std::lock_guard lock(spare_->mutex);
            if (!spare_->batches.empty()) {
                batch = std::move(spare_->batches.back());
                spare_->batches.pop_back();
            }
        }
        if (!batch) batch = std::make_unique<Batch>();
        batch->iteration_samples = 0;
        batch->evaluated.clear();
        // The last to hold it may be another thread, or outlive the sampler.
        return {batch.release(), [to = std::weak_ptr<Spare>(spare_)](Batch* used) {
                    std::unique_ptr<Batch> kept(used);
                    const auto spare = to.lock();
                    if (!spare) return;
                    const std::lock_guard lock(spare->mutex);
                    if (spare->batches.size() < spare->most) spare->batches.push_back(std::move(kept));
                }};
    }
    // No batch will be taken any more.
    void end() {
        const std::lock_guard lock(spare_->mutex);
        spare_->most = 0;
        spare_->batches.clear();
    }

private:
    struct Spare {
        Spare() { batches.reserve(most); }  // so that to put one back needs no memory
        std::size_t most = 2;
        std::mutex mutex;
        std::vector<std::unique_ptr<Batch>> batches;
    };
    std::shared_ptr<Spare> spare_ = std::make_shared<Spare>();
};

}  // namespace pmc

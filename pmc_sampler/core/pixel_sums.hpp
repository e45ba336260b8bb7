// What every sample changes in its pixel, and how.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "batch.hpp"
#include "multiversion.hpp"
#include "perception.hpp"
#include "rounding.hpp"
#include "tiling.hpp"

namespace pmc {

inline constexpr std::array<double, 1024> reciprocals = [] {
    std::array<double, 1024> table{};
    for (int i = 1; i < 1024; ++i) table[i] = 1.0 / i;
    return table;
}();

// Divisions by small counts are the dearest part of a sample; these are looked up. 0 for 0.
[[gnu::always_inline]] inline double reciprocal(std::uint32_t n) { return n < reciprocals.size() ? reciprocals[n] : 1.0 / n; }

// One cache line.
struct PixelSums {
    double sum[3];            // of radiance, all samples
    Reals40<4> m2;            // sums of squared deviations from the mean: red, green, blue, luminance
    float half_mean[3];       // mean radiance of every other sample
    std::uint32_t n, n_pool;  // samples, and those of them from the pool

    std::uint32_t n_half() const { return n / 2 + n % 2; }
    // Of luminance; 0 where there are too few samples to tell.
    double variance() const { return n < 2 ? 0.0 : m2.get(3) * reciprocal(n - 1); }
    double mean() const { return luminance(sum[0], sum[1], sum[2]) * reciprocal(n); }
};
static_assert(sizeof(PixelSums) == 64);

[[gnu::always_inline]] inline double of_luminance(const Quad& rgb) {
    const Quad parts = rgb * Quad{0.2126, 0.7152, 0.0722, 0.0};
    return parts[0] + parts[1] + parts[2];
}

// The sums while samples are added. Deviations are taken from the mean before each sample (Welford 1962,
// doi:10.1080/00401706.1962.10490022), as n x - sum, which is exactly 0 where all are equal: a large mean with a tiny spread loses
// nothing. What is kept in fewer bits is rounded once, at the end. Red, green, blue and luminance lie side by side: all is done to
// four numbers at once. Inlined by force, to be compiled for the instruction set of whoever calls it.
class RunningSums {
public:
    [[gnu::always_inline]] explicit RunningSums(const PixelSums& p) : n(p.n), next_(reciprocal(n)) {
        const Quad sum = {p.sum[0], p.sum[1], p.sum[2], 0.0}, half = {p.half_mean[0], p.half_mean[1], p.half_mean[2], 0.0};
        sum_ = sum;
        half_ = half;
        p.m2.get(m2_);
    }

    [[gnu::always_inline]] void add(const float* rgb) {
        const Quad x = {rgb[0], rgb[1], rgb[2], 0.0};
        const double count = n;
        inverse_ = next_;
        next_ = reciprocal(n + 1);
        Quad deviation = (x * count - sum_) * inverse_;
        deviation[3] = of_luminance(deviation);
        m2_ += deviation * deviation * (count * next_);
        sum_ += x;
        // A weight of 0, reciprocal(0), costs less than a branch that nobody can predict.
        half_ += (x - half_) * reciprocal((n / 2 + 1) & (n % 2 - 1));
        ++n;
    }
    [[gnu::always_inline]] void store(PixelSums& p) const {
        const std::uint32_t rounding = dither(n);
        for (int c = 0; c < 3; ++c) p.sum[c] = sum_[c];
        p.m2.set(m2_, rounding);
        // Rounding to the nearest float does for as many samples as most pixels have.
        for (int c = 0; c < 3; ++c) p.half_mean[c] = n < 4096 ? static_cast<float>(half_[c]) : rounded(half_[c], rounding);
        p.n = n;
    }
    // Of luminance, once a sample was added; the variance of a single one is 0.
    [[gnu::always_inline]] double variance() const { return m2_[3] * inverse_; }
    [[gnu::always_inline]] double mean() const { return of_luminance(sum_) * next_; }

    std::uint32_t n;

private:
    Quad sum_ = {}, half_ = {}, m2_ = {};
    double inverse_ = 0.0, next_;  // of the number of samples but one, and of the number of samples
};

// Samples with their radiance: a stretch of a batch, tile by tile.
struct Told {
    const std::uint32_t* slot;
    const std::uint8_t* tag;
    const float* radiance;
    std::size_t stride;  // floats a sample
    std::size_t size;

    // They are worked through in blocks, each in several steps while it is in the nearest caches. Where the block ends that begins
    // at `first`: with a tile or, in one that has many, a whole number of blocks after its beginning. So how the samples of a pixel
    // are parted, and their sums rounded, does not depend on what part of a batch this is.
    static constexpr std::size_t block = 256;
    std::size_t end_of_block(std::size_t first) const {
        if (first + block >= size) return size;
        std::size_t end = first + block;
        while (end > first && slot[end - 1] / Tiling::area == slot[end] / Tiling::area) --end;
        return end > first ? end : first + block;
    }
};

// Which samples of a block the pool drew, and which a kernel proposed.
struct Origins {
    std::uint32_t of_pool[Told::block], of_kernels[Told::block];
    std::size_t in_pool = 0, by_kernels = 0;

    Origins(const Told& told, std::size_t first, std::size_t last) {
        for (std::size_t i = first; i < last; ++i) {
            of_pool[in_pool] = of_kernels[by_kernels] = static_cast<std::uint32_t>(i);
            in_pool += (told.tag[i] & Tag::pool) != 0;
            by_kernels += (told.tag[i] & Tag::kernel_mask) != Tag::no_kernel;
        }
    }
};

// Moments of luminance of pixels.
struct Moments {
    std::uint32_t slot[Told::block];
    double variance[Told::block], mean[Told::block];
    std::size_t size = 0;
};

// Adds samples [first, last), a block, and notes the moments of their pixels. all_of_pool: nobody else draws any.
PMC_MULTIVERSION inline void add_to_sums(PixelSums* sums, const Told& told, std::size_t first, std::size_t last, bool all_of_pool, Moments& moments) {
    // The film is larger than the caches and samples jump about in it: what is needed `ahead` samples on is fetched now.
    constexpr std::size_t ahead = 64;
    const std::uint32_t* const slot = told.slot;
    const std::size_t end = told.size - 1, stride = told.stride;
    const float* radiance = told.radiance + first * stride;
    std::size_t changed = 0;
    for (std::size_t i = first; i < last;) {
        const std::uint32_t at = slot[i];
        PixelSums& p = sums[at];
        RunningSums running(p);
        do {
            __builtin_prefetch(&sums[slot[std::min(i + ahead, end)]], 1);
            running.add(radiance);
            radiance += stride;
        } while (++i < last && slot[i] == at);
        running.store(p);
        if (all_of_pool) p.n_pool = p.n;
        moments.slot[changed] = at;
        moments.variance[changed] = running.variance();
        moments.mean[changed++] = running.mean();
    }
    moments.size = changed;
}

// Where all samples of pixels [first, last), a block at most, are the pool's: the means of the pool's own, their squared deviations of
// luminance to `m2`, if any, and the moments of the pixels that have samples.
PMC_MULTIVERSION inline void copy_to_pool(const PixelSums* sums, Reals40<3>* means, float* m2, std::uint32_t first, std::uint32_t last, Moments& moments) {
    std::size_t sampled = 0;
    for (std::uint32_t slot = first; slot < last; ++slot) {
        const PixelSums& p = sums[slot];
        const double weight = reciprocal(p.n);
        means[slot].set(Quad{p.sum[0], p.sum[1], p.sum[2], 0.0} * weight, dither(p.n));
        if (m2) m2[slot] = static_cast<float>(std::min<double>(p.m2.get(3), std::numeric_limits<float>::max()));
        moments.slot[sampled] = slot;
        moments.variance[sampled] = p.variance();
        moments.mean[sampled] = p.mean();
        sampled += p.n > 0;
    }
    moments.size = sampled;
}

// Adds the pool's samples to the means of the pool's own, and their squared deviations of luminance to `m2`, if any.
PMC_MULTIVERSION inline void add_to_pool(PixelSums* sums, Reals40<3>* means, float* m2, const Told& told, const Origins& origins) {
    for (std::size_t k = 0; k < origins.in_pool; ++k) {
        const std::size_t i = origins.of_pool[k];
        const std::uint32_t slot = told.slot[i], n = ++sums[slot].n_pool;
        const double weight = reciprocal(n);
        const float* rgb = told.radiance + i * told.stride;
        Quad mean;
        means[slot].get(mean);
        const Quad deviation = Quad{rgb[0], rgb[1], rgb[2], 0.0} - mean;
        if (m2) {
            const double d = of_luminance(deviation);
            // Never infinite: what it is multiplied by may be 0.
            m2[slot] = std::min(m2[slot] + static_cast<float>(d * d * (n - 1) * weight), std::numeric_limits<float>::max());
        }
        mean += deviation * weight;
        means[slot].set(mean, dither(n));
    }
}

}  // namespace pmc

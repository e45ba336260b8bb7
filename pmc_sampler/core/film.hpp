// The film: sums of radiance in every pixel, and what steers the sampler because it is a function of them.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "batch.hpp"
#include "config.hpp"
#include "memory.hpp"
#include "parallel.hpp"
#include "perception.hpp"
#include "tiling.hpp"

namespace pmc {

struct PixelSums {
    double sum[3];              // of radiance, all samples
    double m2_luminance;        // sum of squared deviations of luminance from its mean
    float m2[3];                // the same of each channel
    float pool_mean[3];         // mean radiance of the pool's samples alone
    float half_mean[3];         // mean radiance of every other sample
    std::uint32_t n, n_pool;    // samples, and those of them from the pool
    std::uint32_t strategy[3];  // samples that each radius of the kernel proposed

    std::uint32_t n_half() const { return n / 2 + n % 2; }
    double mean_luminance() const { return n ? luminance(sum[0], sum[1], sum[2]) / n : 0.0; }
    double variance_luminance() const { return n > 1 ? m2_luminance / (n - 1) : 0.0; }
};
static_assert(sizeof(PixelSums) == 88, "with beta and drawn: 96 bytes a pixel");

class Film {
public:
    Film(std::uint32_t width, std::uint32_t height, const Config& config, std::uint32_t aovs)
        : tiling(width, height), sums(tiling.slots()), drawn(tiling.slots()), tile_weight(tiling.tiles()),
          aov_sums(tiling.slots() * aovs), aovs(aovs), beta_(tiling.slots()), tile_settled_(tiling.tiles()), white_(config.white_luminance), rule_(config.beta), power_(config.beta_power), live_(config.adapt_beta_every == 1) {}

    // Adds a batch; radiance holds 3 + aovs floats a sample. Samples that are not finite or negative are left out, and their
    // number returned. `luminances`, if any, receives each sample's, NaN where it was left out.
    std::uint64_t add(const Batch& batch, const float* radiance, float* luminances, ThreadPool& threads) {
        std::atomic<std::uint64_t> rejected{0};
        const std::uint32_t* slot = batch.slot.data();
        const std::size_t n = batch.size();
        // A range gives its first tile to the range before, unless it is the first, and goes on to the end of its last.
        const auto boundary = [&](std::size_t i) {
            while (i > 0 && i < n && slot[i] / Tiling::area == slot[i - 1] / Tiling::area) ++i;
            return i;
        };
        threads.ranges(n, 2048, [&](std::size_t first, std::size_t last) {
            std::uint64_t bad = 0;
            for (std::size_t i = boundary(first), end = boundary(last); i < end;) {
                const std::uint32_t tile = slot[i] / Tiling::area;
                for (; i < end && slot[i] / Tiling::area == tile;) {
                    std::size_t stop = i + 1;
                    while (stop < end && slot[stop] == slot[i]) ++stop;
                    bad += add_pixel(batch, radiance, luminances, i, stop);
                    i = stop;
                }
                if (live_) weigh_tile(tile);
            }
            rejected += bad;
        });
        samples += n - rejected;
        return rejected;
    }

    // beta of every pixel anew: where it is not kept up to date sample by sample (Config::adapt_beta_every above 1).
    void adapt_beta(ThreadPool& threads) {
        threads.ranges(tiling.tiles(), 16, [&](std::size_t first, std::size_t last) {
            for (std::size_t tile = first; tile < last; ++tile) {
                for (std::size_t s = tile * Tiling::area; s < (tile + 1) * Tiling::area; ++s)
                    if (sums[s].n) set_beta(s, gain_of(sums[s]));
                weigh_tile(static_cast<std::uint32_t>(tile));
            }
        });
    }

    float beta(std::size_t slot) const { return std::fabs(beta_[slot]); }
    // beta to the power with which pixels are drawn.
    float weight(std::size_t slot) const { return raised(beta(slot)); }

    // Share of pixels whose standard error of luminance exceeds tvi, or that have fewer than two samples.
    double visible_noise() const {
        std::uint64_t settled = 0;
        for (std::uint32_t tile = 0; tile < tiling.tiles(); ++tile) settled += tile_settled_[tile];
        return 1.0 - static_cast<double>(settled) / static_cast<double>(tiling.pixels());
    }

    // A sample's channels: radiance finite and not negative, the others finite.
    static bool valid(const float* v, std::uint32_t aovs) {
        bool ok = true;
        for (int c = 0; c < 3; ++c) ok &= v[c] >= 0.0f && v[c] <= std::numeric_limits<float>::max();
        for (std::uint32_t c = 3; c < 3 + aovs; ++c) ok &= std::isfinite(v[c]);
        return ok;
    }

    Tiling tiling;
    Zeroed<PixelSums> sums;
    Zeroed<std::uint32_t> drawn;  // samples drawn from each pixel's adaptive sequence: the next one's index
    Zeroed<double> tile_weight;   // sum of weight() over each tile
    Zeroed<double> aov_sums;
    std::uint32_t aovs;
    std::uint64_t samples = 0;

    template <class Archive>
    void archive(Archive& a) {
        a.array("film.sums", sums);
        a.array("film.drawn", drawn);
        a.array("film.beta", beta_);
        a.array("film.tile_weight", tile_weight);
        a.array("film.tile_settled", tile_settled_);
        a.array("film.aov_sums", aov_sums);
        a.value("film.samples", samples);
    }

private:
    // Samples [first, last) of one pixel. Deviations are taken from the mean so far (from the first sample, at the start),
    // so that a large mean with a tiny spread loses nothing: M2' = M2 + sum d^2 - (sum d)^2 / n'.
    std::uint64_t add_pixel(const Batch& batch, const float* radiance, float* luminances, std::size_t first, std::size_t last) {
        const std::size_t slot = batch.slot[first];
        const std::uint32_t channels = 3 + aovs;
        PixelSums& p = sums[slot];
        std::uint64_t rejected = 0;
        std::uint32_t n = p.n, n_pool = p.n_pool, half = 0;
        double shift[4] = {}, d1[4] = {}, d2[4] = {}, pool_sum[3] = {}, half_sum[3] = {};
        bool shifted = n > 0;
        if (shifted) {
            const double inverse = 1.0 / n;
            for (int c = 0; c < 3; ++c) shift[c] = p.sum[c] * inverse;
            shift[3] = luminance(shift[0], shift[1], shift[2]);
        }
        for (std::size_t i = first; i < last; ++i) {
            const float* v = radiance + i * channels;
            if (!valid(v, aovs)) {
                ++rejected;
                if (luminances) luminances[i] = std::numeric_limits<float>::quiet_NaN();
                continue;
            }
            const double x[4] = {v[0], v[1], v[2], luminance(double(v[0]), double(v[1]), double(v[2]))};
            if (luminances) luminances[i] = static_cast<float>(x[3]);
            if (!shifted) {
                std::copy(x, x + 4, shift);
                shifted = true;
            }
            for (int c = 0; c < 4; ++c) {
                const double d = x[c] - shift[c];
                d1[c] += d;
                d2[c] += d * d;
            }
            if (n % 2 == 0) {
                ++half;
                for (int c = 0; c < 3; ++c) half_sum[c] += x[c];
            }
            ++n;
            const std::uint8_t tag = batch.tag[i];
            if (tag & Tag::pool) {
                ++n_pool;
                for (int c = 0; c < 3; ++c) pool_sum[c] += x[c];
            }
            if ((tag & Tag::kernel_mask) != Tag::no_kernel) ++p.strategy[tag & Tag::kernel_mask];
            for (std::uint32_t c = 0; c < aovs; ++c) aov_sums[slot * aovs + c] += v[3 + c];
        }
        if (n == p.n) return rejected;
        const std::uint32_t n_half = p.n_half() + half, added = n - p.n, added_pool = n_pool - p.n_pool;
        const double inverse = 1.0 / n;
        for (int c = 0; c < 3; ++c) {
            p.sum[c] += d1[c] + added * shift[c];
            p.m2[c] = static_cast<float>(std::max(0.0, p.m2[c] + d2[c] - d1[c] * d1[c] * inverse));
        }
        p.m2_luminance = std::max(0.0, p.m2_luminance + d2[3] - d1[3] * d1[3] * inverse);
        if (half)
            for (int c = 0; c < 3; ++c) p.half_mean[c] = static_cast<float>(p.half_mean[c] + (half_sum[c] - half * double(p.half_mean[c])) / n_half);
        if (added_pool)
            for (int c = 0; c < 3; ++c) p.pool_mean[c] = static_cast<float>(p.pool_mean[c] + (pool_sum[c] - added_pool * double(p.pool_mean[c])) / n_pool);
        p.n = n;
        p.n_pool = n_pool;
        set_beta(slot, live_ ? gain_of(p) : beta(slot));
        return rejected;
    }

    float gain_of(const PixelSums& p) const {
        const double variance = p.variance_luminance();
        if (!(variance > 0.0)) return 0.0f;
        const double threshold = table()(static_cast<float>(p.mean_luminance() * white_)) / white_;
        const double n = p.n;
        const double value = rule_ == Beta::gain ? variance / (threshold * threshold * n * n) : variance / threshold;
        return static_cast<float>(std::min(value, 1e18));  // so that sums and powers of it stay finite
    }

    void set_beta(std::size_t slot, float value) {
        const PixelSums& p = sums[slot];
        bool settled = false;
        if (p.n > 1) {
            const double threshold = table()(static_cast<float>(p.mean_luminance() * white_)) / white_;
            settled = p.variance_luminance() <= threshold * threshold * p.n;
        }
        const std::size_t tile = slot / Tiling::area;
        tile_settled_[tile] = static_cast<std::uint16_t>(tile_settled_[tile] + settled - std::signbit(beta_[slot]));
        beta_[slot] = settled ? -value : value;
    }

    void weigh_tile(std::uint32_t tile) {
        double total = 0.0;
        const std::size_t first = std::size_t(tile) * Tiling::area;
        for (std::size_t s = first; s < first + Tiling::area; ++s) total += weight(s);
        tile_weight[tile] = total;
    }

    float raised(float beta) const {
        if (power_ == 1.0) return beta;
        if (power_ == 1.5) return beta * std::sqrt(beta);
        return beta > 0.0f ? static_cast<float>(std::pow(double(beta), power_)) : 0.0f;
    }

    static const TviTable& table() {
        static const TviTable instance;
        return instance;
    }

    Zeroed<float> beta_;  // its sign bit is set where the pixel is settled
    Zeroed<std::uint16_t> tile_settled_;
    double white_;
    Beta rule_;
    double power_;
    bool live_;
};

}  // namespace pmc

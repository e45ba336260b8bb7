// The film: sums of radiance in every pixel, and what steers the sampler because it is a function of them.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>

#include "batch.hpp"
#include "config.hpp"
#include "memory.hpp"
#include "parallel.hpp"
#include "perception.hpp"
#include "tiling.hpp"

namespace pmc {

// What every sample changes: one cache line.
struct PixelSums {
    double sum[3];            // of radiance, all samples
    double m2_luminance;      // sum of squared deviations of luminance from its mean
    float m2[3];              // the same of each channel
    float half_mean[3];       // mean radiance of every other sample
    std::uint32_t n, n_pool;  // samples, and those of them from the pool

    std::uint32_t n_half() const { return n / 2 + n % 2; }
};
inline constexpr std::array<double, 1024> reciprocals = [] {
    std::array<double, 1024> table{};
    for (int i = 1; i < 1024; ++i) table[i] = 1.0 / i;
    return table;
}();

static_assert(sizeof(PixelSums) == 64);

class Film {
public:
    // watch_noise: keep visible_noise() at hand even where nothing steers by it.
    Film(std::uint32_t width, std::uint32_t height, const Config& config, std::uint32_t aovs, bool watch_noise = false)
        : tiling(width, height), sums(tiling.slots()), pool_mean(tiling.slots()), strategy(tiling.slots()), drawn(tiling.slots()), tile_weight(tiling.tiles()),
          aov_sums(tiling.slots() * aovs), aovs(aovs), beta_(tiling.slots()), tile_settled_(tiling.tiles()), white_(config.white_luminance),
          per_white_(1.0 / config.white_luminance), rule_(config.beta), power_(config.beta_power), uniform_(config.is_uniform()), steers_(!uniform_ || watch_noise),
          live_(steers_ && config.adapt_beta_every == 1) {}

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
                const std::size_t start = i;
                for (; i < end && slot[i] / Tiling::area == tile; ++i) {
                    if (i + ahead < end) fetch(slot[i + ahead], batch.tag[i + ahead]);
                    bad += !add_sample(slot[i], batch.tag[i], radiance + i * (3 + aovs), luminances ? luminances + i : nullptr);
                }
                // For each sample, not for each pixel: the branch between the two costs more than the work.
                if (steers_)
                    for (std::size_t j = start; j < i; ++j) steer(slot[j]);
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
                    if (sums[s].n) set_state(s, state(s));
                weigh_tile(static_cast<std::uint32_t>(tile));
            }
        });
    }

    float beta(std::size_t slot) const { return steers_ ? std::fabs(beta_[slot]) : state(slot).beta; }
    // Weight with which each pixel of a tile is drawn, beta to its power, and their sums over the tile's rows.
    struct TileWeights {
        float pixel[Tiling::area], row[Tiling::side];
    };
    void weights(std::uint32_t tile, TileWeights& w) const {
        const float* from = beta_.data() + std::size_t(tile) * Tiling::area;
        if (power_ == 1.5)
            for (std::uint32_t i = 0; i < Tiling::area; ++i) w.pixel[i] = std::fabs(from[i]) * std::sqrt(std::fabs(from[i]));
        else if (power_ == 1.0)
            for (std::uint32_t i = 0; i < Tiling::area; ++i) w.pixel[i] = std::fabs(from[i]);
        else
            for (std::uint32_t i = 0; i < Tiling::area; ++i) w.pixel[i] = from[i] != 0.0f ? static_cast<float>(std::pow(std::fabs(double(from[i])), power_)) : 0.0f;
        for (std::uint32_t r = 0; r < Tiling::side; ++r) {
            // In fours, so that the sum is the same however the compiler vectorises.
            float sum[4] = {};
            for (std::uint32_t i = 0; i < Tiling::side; ++i) sum[i % 4] += w.pixel[r * Tiling::side + i];
            w.row[r] = (sum[0] + sum[1]) + (sum[2] + sum[3]);
        }
    }

    // Samples of a pixel that are drawn and not told yet count as taken: without that, the batches drawn meanwhile would all go
    // to the same pixels. `more` were drawn just now; `passes` of the pool stand in for the pixel's own count of its samples.
    void anticipate(std::size_t slot, std::uint32_t more, float passes) {
        if (rule_ != Beta::gain) return;
        const float after = static_cast<float>(drawn[slot]) + passes;
        const float share = 1.0f - static_cast<float>(more) / after;
        beta_[slot] *= share * share;
    }
    bool live() const { return live_; }
    void weigh_tile(std::uint32_t tile) {
        TileWeights w;
        weights(tile, w);
        double total = 0.0;
        for (float row : w.row) total += row;
        tile_weight[tile] = total;
    }

    // Share of pixels whose standard error of luminance exceeds tvi, or that have fewer than two samples.
    double visible_noise() const {
        std::uint64_t count = 0;
        if (steers_)
            for (std::uint32_t tile = 0; tile < tiling.tiles(); ++tile) count += tile_settled_[tile];
        else
            for (std::size_t slot = 0; slot < sums.size(); ++slot) count += state(slot).settled;
        return 1.0 - static_cast<double>(count) / static_cast<double>(tiling.pixels());
    }

    static constexpr std::size_t bytes_per_pixel =
        sizeof(PixelSums) + sizeof(float[3]) + sizeof(std::uint32_t[3]) + sizeof(std::uint32_t) + sizeof(float);

    // A sample's channels: radiance finite and not negative, the others finite.
    static bool valid(const float* v, std::uint32_t aovs) {
        bool ok = true;
        for (int c = 0; c < 3; ++c) ok &= v[c] >= 0.0f && v[c] <= std::numeric_limits<float>::max();
        for (std::uint32_t c = 3; c < 3 + aovs; ++c) ok &= std::isfinite(v[c]);
        return ok;
    }

    Tiling tiling;
    Zeroed<PixelSums> sums;
    Zeroed<std::array<float, 3>> pool_mean;          // mean radiance of the pool's samples alone; of no use where all are
    Zeroed<std::array<std::uint32_t, 3>> strategy;   // samples that each radius of the kernel proposed
    Zeroed<std::uint32_t> drawn;  // samples drawn from each pixel's adaptive sequence: the next one's index
    Zeroed<double> tile_weight;   // sum of weight() over each tile
    Zeroed<double> aov_sums;
    std::uint32_t aovs;
    std::uint64_t samples = 0;

    template <class Archive>
    void archive(Archive& a) {
        a.array("film.sums", sums);
        a.array("film.pool_mean", pool_mean);
        a.array("film.strategy", strategy);
        a.array("film.drawn", drawn);
        a.array("film.beta", beta_);
        a.array("film.tile_weight", tile_weight);
        a.array("film.tile_settled", tile_settled_);
        a.array("film.aov_sums", aov_sums);
        a.value("film.samples", samples);
    }

private:
    using Pair = double __attribute__((vector_size(2 * sizeof(double))));

    // The film is larger than the caches and samples jump about in it: what is needed `ahead` samples on is fetched now.
    static constexpr std::size_t ahead = 12;
    void fetch(std::size_t slot, std::uint8_t tag) const {
        __builtin_prefetch(&sums[slot], 1);
        if ((tag & Tag::pool) && !uniform_) __builtin_prefetch(&pool_mean[slot], 1);
        if ((tag & Tag::kernel_mask) != Tag::no_kernel) __builtin_prefetch(&strategy[slot], 1);
    }

    // One sample; false where it is left out. Its deviation is taken from the mean before it (Welford 1962,
    // doi:10.1080/00401706.1962.10490022), so that a large mean with a tiny spread loses nothing.
    bool add_sample(std::size_t slot, std::uint8_t tag, const float* v, float* luminance_out) {
        if (!valid(v, aovs)) {
            if (luminance_out) *luminance_out = std::numeric_limits<float>::quiet_NaN();
            return false;
        }
        PixelSums& p = sums[slot];
        const std::uint32_t n = p.n;
        const double r = v[0], g = v[1], b = v[2], y = luminance(r, g, b), inverse = reciprocal(n), share = n * reciprocal(n + 1);
        if (luminance_out) *luminance_out = static_cast<float>(y);
        // Red, green, blue and luminance in two vectors of the width that every x86-64 and 64-bit Arm processor has.
        // They are read as they were written, whole: a processor passes a value on from its last write at once only then.
        Pair sum_rg;
        std::memcpy(&sum_rg, p.sum, sizeof sum_rg);
        const Pair x_rg = {r, g}, x_by = {b, y};
        const Pair sum_by = {p.sum[2], luminance(sum_rg[0], sum_rg[1], p.sum[2])};
        const Pair d_rg = x_rg - sum_rg * inverse, d_by = x_by - sum_by * inverse;
        const Pair m2_rg = d_rg * d_rg * share, m2_by = d_by * d_by * share, now_rg = sum_rg + x_rg;
        std::memcpy(p.sum, &now_rg, sizeof now_rg);
        p.sum[2] = sum_by[0] + b;
        p.m2_luminance += m2_by[1];
        p.m2[0] += static_cast<float>(m2_rg[0]);
        p.m2[1] += static_cast<float>(m2_rg[1]);
        p.m2[2] += static_cast<float>(m2_by[0]);
        // A weight of 0 costs less than a branch that nobody can predict.
        const float half_weight = static_cast<float>(reciprocal(n / 2 + 1) * double(1 - n % 2));
        for (int c = 0; c < 3; ++c) p.half_mean[c] += (v[c] - p.half_mean[c]) * half_weight;
        p.n = n + 1;
        if (tag & Tag::pool) {
            ++p.n_pool;
            if (!uniform_) {
                const float weight = static_cast<float>(reciprocal(p.n_pool));
                for (int c = 0; c < 3; ++c) pool_mean[slot][c] += (v[c] - pool_mean[slot][c]) * weight;
            }
        }
        const std::uint32_t kernel = tag & Tag::kernel_mask;
        std::uint32_t nowhere = 0;
        ++*(kernel == Tag::no_kernel ? &nowhere : &strategy[slot][kernel]);
        for (std::uint32_t c = 0; c < aovs; ++c) aov_sums[slot * aovs + c] += v[3 + c];
        return true;
    }

    // Divisions by small counts are the dearest part of a sample; these are looked up.
    static double reciprocal(std::uint32_t n) {
        return n < reciprocals.size() ? reciprocals[n] : 1.0 / n;
    }

    // tvi at the pixel's mean, in radiance units.
    double threshold(const PixelSums& p) const {
        return table_(static_cast<float>(luminance(p.sum[0], p.sum[1], p.sum[2]) * reciprocal(p.n) * white_)) * per_white_;
    }

    struct State {
        float beta;
        bool settled;
    };
    State state(std::size_t slot) const {
        const PixelSums& p = sums[slot];
        if (p.n < 2) return {0.0f, false};
        const double variance = p.m2_luminance * reciprocal(p.n - 1);
        const double t = threshold(p), n = double(p.n_pool) + std::max(p.n - p.n_pool, drawn[slot]);
        const double value = variance / (rule_ == Beta::gain ? t * t * n * n : t);
        // Bounded, so that sums and powers of it stay finite.
        return {static_cast<float>(std::min(value, 1e18)), variance <= t * t * p.n};
    }

    void steer(std::size_t slot) {
        State now = state(slot);
        if (!live_) now.beta = std::fabs(beta_[slot]);
        set_state(slot, now);
    }

    void set_state(std::size_t slot, State now) {
        const std::size_t tile = slot / Tiling::area;
        tile_settled_[tile] = static_cast<std::uint16_t>(tile_settled_[tile] + now.settled - std::signbit(beta_[slot]));
        beta_[slot] = now.settled ? -now.beta : now.beta;
    }

    Zeroed<float> beta_;  // its sign bit is set where the pixel is settled
    Zeroed<std::uint16_t> tile_settled_;
    double white_, per_white_;
    Beta rule_;
    double power_;
    bool uniform_, steers_, live_;
    TviTable table_;
};

}  // namespace pmc

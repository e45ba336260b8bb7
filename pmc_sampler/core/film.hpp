// The film: sums of radiance in every pixel, and what steers the sampler because it is a function of them.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "batch.hpp"
#include "config.hpp"
#include "memory.hpp"
#include "multiversion.hpp"
#include "parallel.hpp"
#include "pixel_sums.hpp"
#include "rounding.hpp"
#include "score.hpp"
#include "smoother.hpp"
#include "tile_weights.hpp"
#include "tiling.hpp"

namespace pmc {

// Whether all values are from `lowest` to `highest`; NaN is not.
PMC_MULTIVERSION inline bool all_within(const float* values, std::size_t n, float lowest, float highest) {
    std::uint32_t outside = 0;
    for (std::size_t i = 0; i < n; ++i) outside |= static_cast<std::uint32_t>(!(values[i] >= lowest)) | static_cast<std::uint32_t>(!(values[i] <= highest));
    return !outside;
}

class Film {
public:
    // is_signed: radiance may be negative, as single samples of a spectral renderer are outside the gamut of RGB.
    Film(std::uint32_t width, std::uint32_t height, const Config& config, std::uint32_t aovs, bool is_signed = false)
        : tiling(width, height), sums(tiling.slots()), pool_mean(tiling.slots()), pool_m2(config.is_unbiased() ? tiling.slots() : 0), strategy(tiling.slots()), drawn(tiling.slots()),
          aov_sums(tiling.slots() * aovs), aovs(aovs), is_signed(is_signed), score(config.beta, config.white_luminance), scores_(tiling.slots()), tiles_(tiling.tiles()),
          rule_(config.beta), power_(config.beta_power), uniform_(config.is_uniform()), unbiased_(config.is_unbiased()), live_(!uniform_ && !unbiased_ && config.adapt_beta_every == 1) {}

    // Adds a batch; radiance holds 3 + aovs floats a sample. Samples that are not valid() are left out, and their number returned;
    // `clean` where there are none.
    std::uint64_t add(const Batch& batch, const float* radiance, bool clean, ThreadPool& threads) {
        std::atomic<std::uint64_t> rejected{0};
        const std::uint32_t* slot = batch.slot.data();
        const std::size_t n = batch.size();
        // A range gives its first tile to the range before, unless it is the first, and goes on to the end of its last.
        const auto boundary = [&](std::size_t i) {
            while (i > 0 && i < n && slot[i] / Tiling::area == slot[i - 1] / Tiling::area) ++i;
            return i;
        };
        threads.ranges(n, 2048, [&](std::size_t first, std::size_t last) {
            const std::size_t begin = boundary(first), end = boundary(last), channels = 3 + aovs;
            if (clean) return add_valid({slot + begin, batch.tag.data() + begin, radiance + begin * channels, channels, end - begin});
            std::vector<std::uint32_t> slots;
            std::vector<std::uint8_t> tags;
            std::vector<float> values;
            for (std::size_t i = begin; i < end; ++i) {
                const float* v = radiance + i * channels;
                if (!valid(v)) continue;
                slots.push_back(slot[i]);
                tags.push_back(batch.tag[i]);
                values.insert(values.end(), v, v + channels);
            }
            rejected += end - begin - slots.size();
            add_valid({slots.data(), tags.data(), values.data(), channels, slots.size()});
        });
        samples += n - rejected;
        return rejected;
    }

    // From now on the pool's samples are told apart from others; until then all are the pool's, and cost less.
    void part(ThreadPool& threads) {
        if (parted_) return;
        parted_ = true;
        static_assert(Tiling::area <= Told::block);
        threads.ranges(tiling.tiles(), 4, [&](std::size_t first, std::size_t last) {
            Moments moments;
            for (auto tile = static_cast<std::uint32_t>(first); tile < last; ++tile) {
                const std::uint32_t begin = tile * Tiling::area, end = begin + Tiling::area;
                // Where no samples fell nothing is written: memory comes into being where it is touched.
                if (std::all_of(&sums[begin], &sums[begin] + Tiling::area, [](const PixelSums& p) { return p.n == 0; })) continue;
                copy_to_pool(sums.data(), pool_mean.data(), unbiased_ ? pool_m2.data() : nullptr, begin, end, moments);
                if (live_) note_scores(moments);
            }
        });
    }
    bool parted() const { return parted_; }

    // The density of every pixel anew: where it is not kept up to date sample by sample (Config::adapt_beta_every above 1).
    void adapt_beta(ThreadPool& threads) {
        threads.ranges(tiling.tiles(), 16, [&](std::size_t first, std::size_t last) {
            for (std::size_t tile = first; tile < last; ++tile) {
                for (std::size_t s = tile * Tiling::area; s < (tile + 1) * Tiling::area; ++s) scores_[s] = score(sums[s].variance(), sums[s].mean());
                tiles_[tile].stale = true;
            }
        });
    }

    // The density of the unbiased estimator. Pixels have the colours of a chessboard, and the samples of different pixels are
    // independent. So if how often a pixel is sampled follows from pixels of the other colour alone, and from those of their
    // samples alone that are taken whatever was seen (the pool's), it is independent of the pixel's own values, and their mean has
    // the right expectation at every count. What a pixel is given for its standard deviation in units of tvi is the mean of those
    // around it, of the other colour.
    void guide(ThreadPool& threads) {
        const Smoother smooth(tiling.width, tiling.height, guide_sigma);
        const auto over = [&](std::uint32_t colour, auto&& visit) {
            threads.ranges(tiling.height, 8, [&](std::size_t first, std::size_t last) {
                for (auto y = static_cast<std::uint32_t>(first); y < last; ++y)
                    for (std::uint32_t x = (y + colour) % 2; x < tiling.width; x += 2) visit(std::size_t(y) * tiling.width + x, tiling.slot(x, y));
            });
        };
        std::vector<float> image(tiling.pixels());
        const bool first = guide_share_.empty();
        guide_share_.resize(tiling.pixels());
        for (std::uint32_t colour = 0; colour < 2; ++colour) {
            if (first) {  // how much of the smoother's weight is the other colour's: a half, but at the borders
                std::fill(image.begin(), image.end(), 0.0f);
                over(1 - colour, [&](std::size_t i, std::size_t) { image[i] = 1.0f; });
                smooth(image, threads);
                over(colour, [&](std::size_t i, std::size_t) { guide_share_[i] = image[i]; });
            }
            std::fill(image.begin(), image.end(), 0.0f);
            over(1 - colour, [&](std::size_t i, std::size_t slot) {
                const std::uint32_t n = sums[slot].n_pool;
                const auto& mean = pool_mean[slot];
                if (n > 1) image[i] = std::sqrt(score(pool_m2[slot] * reciprocal(n - 1), luminance(mean.get(0), mean.get(1), mean.get(2))));
            });
            smooth(image, threads);
            over(colour, [&](std::size_t i, std::size_t slot) {
                const float s = guide_share_[i] > 0.0f ? image[i] / guide_share_[i] : 0.0f;
                scores_[slot] = s * s;
            });
        }
    }
    // Only pixels of one colour have weight from now on.
    void select(std::uint32_t colour) {
        colour_ = colour;
        for (std::size_t t = 0; t < tiling.tiles(); ++t) tiles_[t].stale = true;
    }

    // beta as the sampler sees it (Config::beta), not normalised.
    float beta(std::size_t slot) const {
        const PixelSums& p = sums[slot];
        const double value = uniform_ || (live_ && !parted_) ? score(p.variance(), p.mean()) : scores_[slot];
        return static_cast<float>(rule_ == Beta::gain && p.n ? value / (double(p.n) * p.n) : value);
    }

    // Weight with which each pixel of a tile is drawn, beta to its power. Samples that are drawn and not told yet count as taken:
    // without that, the batches drawn meanwhile would all go to the same pixels. The passes of the pool stand in for the pixel's
    // own count of its samples.
    void weights(std::uint32_t tile, TileWeights& w) const {
        const std::size_t first = std::size_t(tile) * Tiling::area;
        weigh_pixels(scores_.data() + first, drawn.data() + first, tiles_[tile].passes, rule_ == Beta::gain, power_ == 2.0, w);
        if (power_ != 1.0 && power_ != 2.0)
            for (float& v : w.pixel) v = v > 0.0f ? static_cast<float>(std::pow(double(v), power_)) : 0.0f;
        if (unbiased_)  // some weight for each, so that the other colour has no say in whether there is any
            for (std::uint32_t i = 0; i < Tiling::area; ++i)
                w.pixel[i] = (i + i / Tiling::side) % 2 == colour_ && tiling.inside(tile * Tiling::area + i) ? std::max(w.pixel[i], 1e-30f) : 0.0f;
        sum_columns(w);
    }
    // Brings the sums of tiles [first, last) up to date; `passes` of the pool are drawn.
    void weigh(std::size_t first, std::size_t last, float passes) {
        TileWeights w;
        for (std::size_t t = first; t < last; ++t) {
            if (!tiles_[t].stale) continue;
            // Field by field: the bytes between them stay 0, and checkpoints equal bit for bit.
            tiles_[t].weight = 0.0;
            tiles_[t].passes = std::max(passes, 1.0f);
            tiles_[t].stale = false;
            weights(static_cast<std::uint32_t>(t), w);
            for (float column : w.column) tiles_[t].weight += column;
            tiles_[t].crowding = crowding(w);
        }
    }
    double tile_weight(std::size_t tile) const { return tiles_[tile].weight; }
    double tile_crowding(std::size_t tile) const { return tiles_[tile].crowding; }
    void touch(std::size_t tile) { tiles_[tile].stale |= !uniform_ && (live_ || rule_ == Beta::gain); }

    static constexpr double guide_sigma = 2.0;  // pixels
    static constexpr std::size_t bytes_per_pixel =
        sizeof(PixelSums) + sizeof(Reals40<3>) + sizeof(std::uint16_t[3]) + sizeof(std::uint32_t) + sizeof(float);

    // How many of n samples are not valid(); 3 + aovs floats each.
    std::size_t invalid(const float* radiance, std::size_t n, ThreadPool& threads) const {
        std::atomic<std::size_t> found{0};
        threads.ranges(n, 8192, [&](std::size_t first, std::size_t last) {
            if (all_valid(radiance + first * (3 + aovs), last - first)) return;
            std::size_t bad = 0;
            for (std::size_t i = first; i < last; ++i) bad += !valid(radiance + i * (3 + aovs));
            found += bad;
        });
        return found;
    }

    // A sample's channels: radiance finite and, unless it is signed, not negative; the others finite.
    bool valid(const float* v) const {
        bool ok = true;
        const float highest = std::numeric_limits<float>::max(), lowest = is_signed ? -highest : 0.0f;
        for (int c = 0; c < 3; ++c) ok &= v[c] >= lowest && v[c] <= highest;
        for (std::uint32_t c = 3; c < 3 + aovs; ++c) ok &= std::isfinite(v[c]);
        return ok;
    }

    // Luminance of the i-th of some samples, NaN where it is not valid().
    struct Luminances {
        const Film& film;
        const float* radiance;

        const float* sample(std::size_t i) const { return radiance + i * (3 + film.aovs); }
        void fetch(std::size_t i) const { __builtin_prefetch(sample(i)); }
        float operator()(std::size_t i) const {
            const float* v = sample(i);
            return film.valid(v) ? static_cast<float>(luminance(double(v[0]), double(v[1]), double(v[2]))) : std::numeric_limits<float>::quiet_NaN();
        }
    };
    Luminances luminance_of(const float* radiance) const { return {*this, radiance}; }

    // Whether n samples are valid(), at a glance; false where it cannot tell, as of channels after RGB that are negative.
    bool all_valid(const float* radiance, std::size_t n) const {
        const float highest = std::numeric_limits<float>::max();
        return all_within(radiance, n * (3 + aovs), is_signed ? -highest : 0.0f, highest);
    }

    Tiling tiling;
    Zeroed<PixelSums> sums;
    Zeroed<Reals40<3>> pool_mean;  // mean radiance of the pool's samples alone, once parted()
    Zeroed<float> pool_m2;  // squared deviations of luminance of these samples, once parted(); for the unbiased estimator only
    Zeroed<std::array<std::uint16_t, 3>> strategy;  // samples that each radius proposed; all three are halved before one runs over
    Zeroed<std::uint32_t> drawn;  // samples drawn from each pixel's adaptive sequence: the next one's index
    Zeroed<double> aov_sums;
    std::uint32_t aovs;
    bool is_signed;
    std::uint64_t samples = 0;
    const Score score;

    template <class Archive>
    void archive(Archive& a) {
        a.array("film.sums", sums);
        a.array("film.pool_mean", pool_mean);
        a.array("film.pool_m2", pool_m2);
        a.array("film.strategy", strategy);
        a.array("film.drawn", drawn);
        a.array("film.score", scores_);
        a.array("film.tiles", tiles_);
        a.array("film.aov_sums", aov_sums);
        a.value("film.samples", samples);
        std::uint8_t parted = parted_;
        a.value("film.parted", parted);
        parted_ = parted != 0;
        if constexpr (Archive::reading)
            if (!steers()) throw std::runtime_error("the checkpoint's film is damaged: it has weights that no samples give");
    }

private:
    // Whether what is drawn from is finite and not negative.
    bool steers() const {
        const auto sound = [](double value) { return value >= 0.0 && value <= std::numeric_limits<float>::max(); };
        for (std::size_t i = 0; i < scores_.size(); ++i)
            if (!sound(scores_[i])) return false;
        for (std::size_t t = 0; t < tiles_.size(); ++t)
            if (!(tiles_[t].weight >= 0.0 && std::isfinite(tiles_[t].weight) && tiles_[t].crowding >= 0.0 && sound(tiles_[t].passes))) return false;
        return true;
    }

    void add_valid(const Told& told) {
        Moments moments;
        for (std::size_t first = 0, last; first < told.size; first = last) {
            last = told.end_of_block(first);
            if (!parted_) {
                add_to_sums(sums.data(), told, first, last, true, moments);
            } else {
                if (live_)
                    for (std::size_t i = first; i < last; ++i) __builtin_prefetch(&scores_[told.slot[i]], 1);
                const Origins origins(told, first, last);
                for (std::size_t k = 0; k < origins.in_pool; ++k) __builtin_prefetch(&pool_mean[told.slot[origins.of_pool[k]]], 1);
                for (std::size_t k = 0; k < origins.by_kernels; ++k) __builtin_prefetch(&strategy[told.slot[origins.of_kernels[k]]], 1);
                add_to_sums(sums.data(), told, first, last, false, moments);
                add_to_pool(sums.data(), pool_mean.data(), unbiased_ ? pool_m2.data() : nullptr, told, origins);
                for (std::size_t k = 0; k < origins.by_kernels; ++k) {
                    const std::size_t i = origins.of_kernels[k];
                    count_strategy(strategy[told.slot[i]], told.tag[i] & Tag::kernel_mask);
                }
                if (live_) note_scores(moments);
            }
            for (std::size_t i = first; aovs && i < last; ++i)
                for (std::uint32_t c = 0; c < aovs; ++c) aov_sums[std::size_t(told.slot[i]) * aovs + c] += told.radiance[i * told.stride + 3 + c];
        }
    }

    void note_scores(const Moments& moments) {
        float scores[Told::block];
        score(moments, scores);
        for (std::size_t i = 0; i < moments.size; ++i) {
            scores_[moments.slot[i]] = scores[i];
            tiles_[moments.slot[i] / Tiling::area].stale = true;
        }
    }

    static void count_strategy(std::array<std::uint16_t, 3>& counts, std::uint32_t kernel) {
        if (counts[kernel] == std::numeric_limits<std::uint16_t>::max())
            for (std::uint16_t& c : counts) c /= 2;
        ++counts[kernel];
    }

    struct Tile {
        double weight;    // sum of weights() over the tile
        double crowding;  // sum of their squares over the pixels' numbers of samples
        float passes;     // of the pool, when these were summed
        bool stale;       // the sums are older than what they are sums of
    };

    Zeroed<float> scores_;  // what beta owes to each pixel's samples other than their number
    Zeroed<Tile> tiles_;
    Beta rule_;
    double power_;
    bool uniform_, unbiased_, live_, parted_ = false;
    std::uint32_t colour_ = 0;
    std::vector<float> guide_share_;
};

}  // namespace pmc

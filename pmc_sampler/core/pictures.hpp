// Pictures of a film, row by row from the top left, in the renderer's radiance units unless said.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "film.hpp"
#include "population.hpp"
#include "smoother.hpp"

namespace pmc {

// Calls write(i, slot) for every pixel i.
template <class Write>
void for_each_pixel(const Film& film, ThreadPool& threads, Write&& write) {
    const Tiling& t = film.tiling;
    threads.ranges(t.height, 8, [&](std::size_t first, std::size_t last) {
        for (std::size_t y = first; y < last; ++y)
            for (std::uint32_t x = 0; x < t.width; ++x) write(y * t.width + x, std::size_t(t.slot(x, static_cast<std::uint32_t>(y))));
    });
}

// Mean of all samples of a pixel (3 floats a pixel), 0 where there is none. Consistent; at finite counts biased low where rare
// bright paths steer the sampler (Kirk and Arvo 1991, doi:10.1145/127719.122735).
inline void plain_mean(const Film& film, float* out, ThreadPool& threads) {
    for_each_pixel(film, threads, [&](std::size_t i, std::size_t slot) {
        const PixelSums& p = film.sums[slot];
        for (int c = 0; c < 3; ++c) out[3 * i + c] = p.n ? static_cast<float>(p.sum[c] / p.n) : 0.0f;
    });
}

// The plain mean P with the energy that it lacks. The pool's mean U is unbiased, for no pool sample's being taken depends on
// any value; D = U - P is noise and what steering cost. In each channel it is shared out among the neighbours by weights w that
// fall to 0 where the channel is black:  image = P + w B(D / B(w)),  B a symmetric smoother, so that the sum over the image is
// that of U. What its neighbours cannot take, for one pixel outshines them, stays where it is: the sum is the same.
inline void corrected_mean(const Film& film, const Config& config, float* out, ThreadPool& threads) {
    plain_mean(film, out, threads);
    if (config.correction == 0.0 || !film.parted()) return;  // else the means are the same
    const UsualArithmetic usual;
    const Tiling& t = film.tiling;
    const std::size_t n = t.pixels();
    const Smoother smooth(t.width, t.height, config.correction_sigma);
    const float knee = static_cast<float>(config.correction_knee);
    constexpr double highest = std::numeric_limits<float>::max();
    const double lowest = film.is_signed ? -highest : 0.0;
    std::vector<float> weight(n), spread(n), mean(n), residual(n), kept(n), ones(n, 1.0f);
    smooth(ones, threads);
    for (int c = 0; c < 3; ++c) {
        // The largest value becomes 1/2 to 1: products and quotients of any radiance stay within floats.
        float largest = 0.0f;
        for (std::size_t i = 0; i < n; ++i) largest = std::max(largest, std::abs(out[3 * i + c]));
        if (largest == 0.0f) continue;
        int exponent;
        std::frexp(largest, &exponent);
        const double scale = std::ldexp(1.0, -exponent), unscale = std::ldexp(1.0, exponent);
        for (std::size_t i = 0; i < n; ++i) mean[i] = weight[i] = static_cast<float>(scale * std::max(0.0f, out[3 * i + c]));
        smooth(mean, threads);
        for (std::size_t i = 0; i < n; ++i) {
            mean[i] /= ones[i];
            spread[i] = weight[i] = weight[i] > 0.0f ? weight[i] / (weight[i] + knee * mean[i]) : 0.0f;
        }
        smooth(spread, threads);
        for_each_pixel(film, threads, [&](std::size_t i, std::size_t slot) {
            residual[i] = kept[i] = 0.0f;
            if (!film.sums[slot].n_pool) return;
            const float lacking = static_cast<float>(scale * (film.pool_mean[slot].get(c) - out[3 * i + c]));
            if (lacking == 0.0f) return;
            // What the neighbours would change by, as a share of what they are. Far beyond what rare bright paths bring, next to
            // nothing is moved; a lower limit would leave such paths standing as specks. How bright they are, in units of the
            // mean, follows from their spread: it is the lower value where they are alike, the higher where some are bright and
            // take most of it. What is taken away must be there, so that the lower counts; what is added does less harm.
            const float most = lacking > 0.0f ? 2.0f : 0.5f;
            const float brightness = lacking > 0.0f ? std::max(knee, spread[i]) : std::min(1.0f, knee / std::max(1.0f - spread[i], knee));
            // In doubles: far below the brightest both products would be 0 in floats.
            const double present = double(spread[i]) * mean[i] * brightness;
            const double change = present > 0.0 ? double(smooth.share(i)) * std::abs(lacking) / present : std::numeric_limits<double>::infinity();
            const float share = change <= most ? 1.0f : static_cast<float>(std::pow(most / change, 4.0));
            residual[i] = share > 0.0f ? share * (lacking / spread[i]) : 0.0f;
            kept[i] = lacking - share * lacking;
        });
        smooth(residual, threads);
        for (std::size_t i = 0; i < n; ++i) {
            const double change = unscale * (double(weight[i]) * residual[i] + kept[i]);
            out[3 * i + c] = static_cast<float>(std::clamp(out[3 * i + c] + config.correction * change, lowest, highest));
        }
    }
}

// Mean of the pool's samples alone, unbiased at every count; all samples where all are the pool's.
inline void pool_mean(const Film& film, float* out, ThreadPool& threads) {
    if (!film.parted()) return plain_mean(film, out, threads);
    for_each_pixel(film, threads, [&](std::size_t i, std::size_t slot) {
        for (int c = 0; c < 3; ++c) out[3 * i + c] = static_cast<float>(film.pool_mean[slot].get(c));
    });
}

// Standard error of the plain mean (3 floats a pixel); infinity where fewer than two samples leave it unknown.
inline void standard_error(const Film& film, float* out, ThreadPool& threads) {
    for_each_pixel(film, threads, [&](std::size_t i, std::size_t slot) {
        const PixelSums& p = film.sums[slot];
        for (int c = 0; c < 3; ++c)
            out[3 * i + c] = p.n > 1 ? static_cast<float>(std::sqrt(p.m2.get(c) / (double(p.n) * (p.n - 1)))) : std::numeric_limits<float>::infinity();
    });
}

// Means of two disjoint halves of the samples (first, third, ... and second, fourth, ...), 0 where there is none.
inline void halves(const Film& film, float* first, float* second, ThreadPool& threads) {
    constexpr double highest = std::numeric_limits<float>::max();
    const double lowest = film.is_signed ? -highest : 0.0;
    for_each_pixel(film, threads, [&](std::size_t i, std::size_t slot) {
        const PixelSums& p = film.sums[slot];
        const std::uint32_t n1 = p.n_half(), n2 = p.n - n1;
        for (int c = 0; c < 3; ++c) {
            first[3 * i + c] = p.half_mean[c];
            const double rest = n2 ? (p.sum[c] - n1 * double(p.half_mean[c])) / n2 : 0.0;
            second[3 * i + c] = static_cast<float>(std::clamp(rest, lowest, highest));  // rounding may go beyond
        }
    });
}

// As in the paper's strategy images: red, green and blue are how often the first, second and third radius were used at the
// pixel, grey where no kernel was; the brightness is its sample count over the largest in the image.
inline void strategy(const Film& film, float* out, ThreadPool& threads) {
    std::uint32_t most = 1;
    for (std::size_t s = 0; s < film.sums.size(); ++s) most = std::max(most, film.sums[s].n);
    for_each_pixel(film, threads, [&](std::size_t i, std::size_t slot) {
        const PixelSums& p = film.sums[slot];
        const auto& count = film.strategy[slot];
        const double used = double(count[0]) + count[1] + count[2], density = double(p.n) / most;
        for (int k = 0; k < 3; ++k) out[3 * i + k] = static_cast<float>(density * (used > 0.0 ? count[k] / used : 1.0 / 3.0));
    });
}

}  // namespace pmc

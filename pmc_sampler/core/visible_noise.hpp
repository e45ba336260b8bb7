// The visible noise of a film.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <vector>

#include "film.hpp"

namespace pmc {

// Share of pixels that are not settled. A pixel is, once it has two samples, where the 90 % interval of its luminance is
// within tvi by the variance of its own samples, and by that of all samples `reach` pixels around it, each in units of its
// own pixel's tvi. The latter is for bright paths so rare that most pixels have met none yet: these have next to no variance
// of their own, and a mean that lacks what the paths bring.
inline double visible_noise(const Film& film, ThreadPool& threads) {
    constexpr float interval = 1.645f * 1.645f;  // standard errors, squared, that 90 % of a normal distribution lie within
    constexpr std::int64_t reach = 3;            // pixels; with less, single rare paths go unnoticed (docs/reliability.md, Budgets)
    const std::int64_t width = film.tiling.width, height = film.tiling.height;
    struct Pooled {
        float squares, freedom;  // sum of squared deviations over tvi^2, degrees of freedom
    };
    std::vector<Pooled> along(film.tiling.pixels());  // sums over 2 * reach + 1 pixels of a row
    threads.ranges(film.tiling.height, 4, [&](std::size_t first, std::size_t last) {
        std::vector<Pooled> row(film.tiling.width);
        for (std::size_t y = first; y < last; ++y) {
            for (std::int64_t x = 0; x < width; ++x) {
                const PixelSums& p = film.sums[film.tiling.slot(static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y))];
                const float freedom = p.n > 1 ? static_cast<float>(p.n - 1) : 0.0f;
                row[x] = {freedom * film.score.by_gain(p.variance(), p.mean()), freedom};
            }
            for (std::int64_t x = 0; x < width; ++x) {
                Pooled& to = along[y * film.tiling.width + x];
                to = {0.0f, 0.0f};
                for (std::int64_t i = std::max<std::int64_t>(x - reach, 0); i <= std::min(x + reach, width - 1); ++i) {
                    to.squares += row[i].squares;
                    to.freedom += row[i].freedom;
                }
            }
        }
    });
    std::atomic<std::uint64_t> settled{0};
    threads.ranges(film.tiling.height, 4, [&](std::size_t first, std::size_t last) {
        std::uint64_t count = 0;
        for (std::size_t y = first; y < last; ++y) {
            const std::int64_t low = std::max<std::int64_t>(std::int64_t(y) - reach, 0), high = std::min<std::int64_t>(std::int64_t(y) + reach, height - 1);
            for (std::int64_t x = 0; x < width; ++x) {
                const PixelSums& p = film.sums[film.tiling.slot(static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y))];
                const float n = static_cast<float>(p.n);
                if (p.n < 2 || interval * film.score.by_gain(p.variance(), p.mean()) > n) continue;
                Pooled around{0.0f, 0.0f};
                for (std::int64_t i = low; i <= high; ++i) {
                    around.squares += along[i * width + x].squares;
                    around.freedom += along[i * width + x].freedom;
                }
                count += interval * around.squares <= around.freedom * n;
            }
        }
        settled += count;
    });
    return 1.0 - static_cast<double>(settled) / static_cast<double>(film.tiling.pixels());
}

}  // namespace pmc

// A symmetric Gaussian smoother on an image: bilinear splat to a coarse grid, blur there, bilinear gather. Being symmetric
// (B equals its transpose) it lets the energy correction move radiance about without making or losing any.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include "parallel.hpp"

namespace pmc {

class Smoother {
public:
    // sigma in pixels.
    Smoother(std::uint32_t width, std::uint32_t height, double sigma)
        : width_(width), height_(height), cell_(std::max(1, static_cast<int>(sigma / 3.0))),
          columns_((width + cell_ - 1) / cell_), rows_((height + cell_ - 1) / cell_) {
        // Splat and gather widen by the variance of two tents of one cell.
        const double s = std::sqrt(std::max(sigma * sigma - cell_ * cell_ / 3.0, 0.01)) / cell_;
        const int reach = static_cast<int>(std::ceil(3.5 * s));
        for (int i = -reach; i <= reach; ++i) kernel_.push_back(std::exp(-0.5 * i * i / (s * s)));
        double sum = 0.0;
        for (double k : kernel_) sum += k;
        for (double& k : kernel_) k /= sum;
        column_share_ = shares(width, sigma);
        row_share_ = shares(height, sigma);
    }

    // About what share of a pixel, by its place in the image, it keeps and its neighbours get.
    float share(std::size_t pixel) const { return column_share_[pixel % width_] * row_share_[pixel / width_]; }

    // In place, one channel, row by row.
    void operator()(std::vector<float>& image, ThreadPool& threads) const {
        // Rows of the coarse grid gather what is splatted to them: each is owned by one task.
        std::vector<double> grid(std::size_t(columns_) * rows_, 0.0);
        threads.run(rows_, [&](std::size_t row) {
            double* line = &grid[row * columns_];
            const int low = std::max(0, (static_cast<int>(row) - 1) * cell_), high = std::min<int>(height_, (static_cast<int>(row) + 2) * cell_);
            for (int y = low; y < high; ++y) {
                const Place v = place(y, rows_);
                const double weight = (v.i == static_cast<int>(row) ? 1.0 - v.t : 0.0) + (v.j == static_cast<int>(row) ? v.t : 0.0);
                if (weight == 0.0) continue;
                for (std::uint32_t x = 0; x < width_; ++x) {
                    const Place u = place(static_cast<int>(x), columns_);
                    const double value = weight * image[std::size_t(y) * width_ + x];
                    line[u.i] += (1.0 - u.t) * value;
                    line[u.j] += u.t * value;
                }
            }
        });
        blur(grid, threads);
        const double scale = 1.0 / (double(cell_) * cell_);
        threads.ranges(height_, 8, [&](std::size_t first, std::size_t last) {
            for (std::size_t y = first; y < last; ++y) {
                const Place v = place(static_cast<int>(y), rows_);
                const double *upper = &grid[std::size_t(v.i) * columns_], *lower = &grid[std::size_t(v.j) * columns_];
                for (std::uint32_t x = 0; x < width_; ++x) {
                    const Place u = place(static_cast<int>(x), columns_);
                    const double a = upper[u.i] + u.t * (upper[u.j] - upper[u.i]), b = lower[u.i] + u.t * (lower[u.j] - lower[u.i]);
                    image[y * width_ + x] = static_cast<float>(scale * (a + v.t * (b - a)));
                }
            }
        });
    }

private:
    struct Place {
        int i, j;
        double t;
    };
    Place place(int x, std::uint32_t cells) const {
        const double c = (x + 0.5) / cell_ - 0.5;
        const int i = static_cast<int>(std::floor(c)), top = static_cast<int>(cells) - 1;
        return {std::clamp(i, 0, top), std::clamp(i + 1, 0, top), c - i};
    }
    // The peak of the Gaussian and of its reflections at both borders, of a row of so many pixels.
    static std::vector<float> shares(std::uint32_t size, double sigma) {
        std::vector<float> result(size);
        const auto at = [&](double distance) { return std::exp(-0.5 * distance * distance / (sigma * sigma)) / (std::sqrt(2.0 * std::numbers::pi) * sigma); };
        for (std::uint32_t i = 0; i < size; ++i)
            result[i] = static_cast<float>(std::clamp(at(0.0) + at(2.0 * i + 1.0) + at(2.0 * (size - i) - 1.0), 1.0 / size, 1.0));
        return result;
    }
    // Reflection at the borders keeps the matrix symmetric.
    static int fold(int i, int n) {
        while (i < 0 || i >= n) i = i < 0 ? -1 - i : 2 * n - 1 - i;
        return i;
    }
    void blur(std::vector<double>& grid, ThreadPool& threads) const {
        const int reach = static_cast<int>(kernel_.size() / 2), columns = static_cast<int>(columns_), rows = static_cast<int>(rows_);
        std::vector<double> other(grid.size());
        threads.run(rows_, [&](std::size_t y) {
            for (int x = 0; x < columns; ++x) {
                double sum = 0.0;
                for (int i = -reach; i <= reach; ++i) sum += kernel_[i + reach] * grid[y * columns_ + fold(x + i, columns)];
                other[y * columns_ + x] = sum;
            }
        });
        threads.run(rows_, [&](std::size_t y) {
            double* line = &grid[y * columns_];
            std::fill_n(line, columns, 0.0);
            for (int i = -reach; i <= reach; ++i) {
                const double* from = &other[std::size_t(fold(static_cast<int>(y) + i, rows)) * columns_];
                for (int x = 0; x < columns; ++x) line[x] += kernel_[i + reach] * from[x];
            }
        });
    }

    std::uint32_t width_, height_;
    int cell_;
    std::uint32_t columns_, rows_;
    std::vector<double> kernel_;
    std::vector<float> column_share_, row_share_;
};

}  // namespace pmc

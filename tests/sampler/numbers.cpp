// Long sums of the film, for tests to hold against exact ones.
//   numbers film FILE EACH CYCLES BATCH   the floats of FILE, each EACH times in a row, all of it CYCLES times, into one pixel
//   numbers beta UPDATES                  random samples into 48x48 pixels; the worst relative error of a tile's weight
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <pmc.hpp>

namespace {

pmc::Batch batch_of(std::size_t size) {
    pmc::Batch batch;
    batch.pixel.resize(size);
    batch.slot.resize(size);
    batch.tag.resize(size);
    std::fill_n(batch.slot.data(), size, 0u);
    std::fill_n(batch.tag.data(), size, std::uint8_t(pmc::Tag::pool | pmc::Tag::no_kernel));
    return batch;
}

void film(const char* file, std::uint64_t each, std::uint64_t cycles, std::size_t size) {
    std::ifstream in(file, std::ios::binary | std::ios::ate);
    std::vector<float> values(static_cast<std::size_t>(in.tellg()) / sizeof(float));
    in.seekg(0).read(reinterpret_cast<char*>(values.data()), static_cast<std::streamsize>(values.size() * sizeof(float)));
    if (!in || values.empty()) throw std::runtime_error("cannot read the file");
    pmc::ThreadPool threads(1);
    pmc::Film film(1, 1, {}, 0);
    film.part(threads);
    const std::uint64_t total = values.size() * each * cycles;
    pmc::Batch batch = batch_of(size), rest = batch_of(total % size);
    std::vector<float> radiance(3 * size);
    for (std::uint64_t told = 0; told < total;) {
        const pmc::Batch& next = total - told < size ? rest : batch;
        for (std::size_t i = 0; i < next.size(); ++i) {
            const float x = values[(told + i) / each % values.size()];
            radiance[3 * i] = x, radiance[3 * i + 1] = 0.5f * x, radiance[3 * i + 2] = 2.0f * x;
        }
        film.add(next, radiance.data(), false, threads);
        told += next.size();
    }
    const pmc::PixelSums& p = film.sums[0];
    std::printf("%llu", static_cast<unsigned long long>(film.samples));
    for (double sum : p.sum) std::printf(" %.17g", sum / p.n);
    for (int c = 0; c < 4; ++c) std::printf(" %.17g", p.m2.get(c) / p.n);
    for (int c = 0; c < 3; ++c) std::printf(" %.17g", film.pool_mean[0].get(c));
    for (float half : p.half_mean) std::printf(" %.17g", half);
    std::printf("\n");
}

void beta(std::uint64_t updates) {
    constexpr std::uint32_t side = 48;
    constexpr std::size_t size = 4 * side * side;
    pmc::ThreadPool threads(1);
    pmc::Film film(side, side, {}, 0);
    film.part(threads);
    pmc::Batch batch = batch_of(size);
    std::fill_n(batch.tag.data(), size, std::uint8_t(pmc::Tag::no_kernel));
    std::vector<float> radiance(3 * size);
    const std::size_t tiles = film.tiling.tiles();
    double worst = 0.0;
    for (std::uint64_t round = 0; round * size < updates; ++round) {
        // Every pixel has its brightness, over 24 powers of ten, and about a third of them are left out in a round.
        std::size_t n = 0;
        for (std::uint32_t slot = 0; slot < film.sums.size() && n < size; ++slot) {
            const pmc::Stream stream(7, static_cast<std::uint32_t>(round), slot);
            const float brightness = std::pow(10.0f, static_cast<float>(pmc::hash32(slot) % 24) - 12.0f);
            for (std::uint32_t k = stream.word(0) % 12; k > 4 && n < size; --k, ++n) {
                batch.slot[n] = slot;
                for (std::uint32_t c = 0; c < 3; ++c) radiance[3 * n + c] = brightness * stream.uniform(k, c + 1);
                ++film.drawn[slot];
            }
            film.touch(slot / pmc::Tiling::area);
        }
        for (; n < size; ++n) {
            batch.slot[n] = static_cast<std::uint32_t>(film.sums.size() - 1);
            for (std::uint32_t c = 0; c < 3; ++c) radiance[3 * n + c] = 1.0f;
        }
        film.add(batch, radiance.data(), false, threads);
        const pmc::SystematicDraw draw(film, 1.0f, threads);
        if ((round + 1) * size < updates && round % 1024) continue;
        long double total = 0.0L;
        for (std::uint32_t t = 0; t < tiles; ++t) {
            pmc::TileWeights w;
            film.weights(t, w);
            long double sum = 0.0L;
            for (float weight : w.pixel) sum += weight;
            total += sum;
            if (!(sum > 0.0L)) throw std::runtime_error("a tile has no weight");
            worst = std::max(worst, static_cast<double>(std::abs(film.tile_weight(t) / sum - 1.0L)));
        }
        worst = std::max(worst, static_cast<double>(std::abs(draw.total() / total - 1.0L)));
    }
    std::printf("%llu %.17g\n", static_cast<unsigned long long>(film.samples), worst);
}

}  // namespace

int main(int argc, char** argv) {
    try {
        if (argc == 6 && !std::strcmp(argv[1], "film"))
            film(argv[2], std::strtoull(argv[3], nullptr, 10), std::strtoull(argv[4], nullptr, 10), std::strtoull(argv[5], nullptr, 10));
        else if (argc == 3 && !std::strcmp(argv[1], "beta"))
            beta(std::strtoull(argv[2], nullptr, 10));
        else
            return 2;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}

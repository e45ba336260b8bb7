// A film that tells the pool's samples apart from the first against one that begins to later, and the sampler in a caller with
// arithmetic of its own.
#include <algorithm>
#include <cfenv>
#include <cmath>
#include <cstring>
#include <memory>
#include <vector>

#include <pmc.hpp>

#include "arithmetic.hpp"
#include "piece.hpp"

namespace {

bool near(double a, double b) { return std::abs(a - b) <= 1e-6 * std::max(std::abs(a), std::abs(b)); }

struct Samples {
    pmc::Batch batch;
    std::vector<float> radiance;
};

// Some of each pixel, of the pool alone or of kernels and beta, too. Brightness varies over ten powers of ten.
Samples some(const pmc::Tiling& tiling, bool of_pool) {
    Samples s;
    std::vector<std::uint32_t> slots;
    std::vector<std::uint8_t> tags;
    for (std::uint32_t slot = 0; slot < tiling.slots(); ++slot) {
        if (!tiling.inside(slot) || below(4) == 0) continue;
        const float brightness = std::pow(10.0f, static_cast<float>(pmc::hash32(slot) % 11) - 5.0f);
        for (std::uint32_t k = below(4); k > 0; --k) {
            slots.push_back(slot);
            tags.push_back(static_cast<std::uint8_t>(of_pool || below(2) ? pmc::Tag::pool | pmc::Tag::no_kernel : below(4)));
            for (int c = 0; c < 3; ++c) s.radiance.push_back(brightness * static_cast<float>(below(1000)));
        }
    }
    s.batch.pixel.resize(slots.size());
    s.batch.slot.resize(slots.size());
    s.batch.tag.resize(slots.size());
    std::copy(slots.begin(), slots.end(), s.batch.slot.data());
    std::copy(tags.begin(), tags.end(), s.batch.tag.data());
    return s;
}

void part_later(const pmc::Config& config) {
    const std::uint32_t width = 1 + below(90), height = 1 + below(70);
    at = size_of(width, height) + (config.is_unbiased() ? ", unbiased" : "");
    pmc::ThreadPool threads(1 + below(3));
    pmc::Film first(width, height, config, 0), later(width, height, config, 0);
    first.part(threads);
    for (const bool of_pool : {true, true, false, false}) {
        if (!of_pool) later.part(threads);
        const Samples s = some(first.tiling, of_pool);
        first.add(s.batch, s.radiance.data(), true, threads);
        later.add(s.batch, s.radiance.data(), true, threads);
        if (!later.parted()) {
            std::vector<float> pool(3 * first.tiling.pixels()), plain(pool);
            pmc::pool_mean(later, pool.data(), threads);
            pmc::plain_mean(later, plain.data(), threads);
            require(pool == plain, "the mean of the pool is that of all samples as long as all are the pool's");
        }
        for (std::size_t slot = 0; slot < first.tiling.slots(); ++slot) {
            require(!std::memcmp(&first.sums[slot], &later.sums[slot], sizeof(pmc::PixelSums)), "sums are the same");
            require(config.is_unbiased() || near(first.beta(slot), later.beta(slot)), "beta is the same");
            if (!later.parted()) continue;
            for (int c = 0; c < 3; ++c) require(near(first.pool_mean[slot].get(c), later.pool_mean[slot].get(c)), "the pool's means are the same");
            require(!config.is_unbiased() || near(first.pool_m2[slot], later.pool_m2[slot]), "the pool's variances are the same");
            require(first.strategy[slot] == later.strategy[slot], "kernels are counted alike");
        }
        pmc::SystematicDraw(first, 3.0f, threads), pmc::SystematicDraw(later, 3.0f, threads);
        for (std::size_t tile = 0; later.parted() && tile < first.tiling.tiles(); ++tile)
            require(near(first.tile_weight(tile), later.tile_weight(tile)), "tiles have the same weights");
    }
}

// A large film takes memory where samples fall, and so does what is made of it.
void part_sparsely() {
#if PMC_HUGE_PAGES
    at = "one sample in 1024x1024 pixels";
    pmc::ThreadPool threads(2);
    pmc::Film film(1024, 1024, {}, 0);
    pmc::Batch batch;
    batch.pixel.resize(1);
    batch.slot.resize(1);
    batch.tag.resize(1);
    batch.slot[0] = 5;
    batch.tag[0] = pmc::Tag::pool | pmc::Tag::no_kernel;
    const float radiance[3] = {1.0f, 2.0f, 3.0f};
    film.add(batch, radiance, true, threads);
    film.part(threads);
    require(film.pool_mean[5].get(2) == 3.0, "the pool's mean is that of its samples");
    const std::size_t page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE)), bytes = film.pool_mean.size() * sizeof(film.pool_mean[0]);
    std::vector<unsigned char> resident(bytes / page);
    require(mincore(film.pool_mean.data(), resident.size() * page, resident.data()) == 0, "the system tells");
    const auto pages = std::count_if(resident.begin(), resident.end(), [](unsigned char r) { return r & 1; });
    require(pages > 0 && static_cast<std::size_t>(pages) * page <= std::size_t(2) << 20, "memory comes into being where samples fall");
#endif
}

// All that a sampler gives, of radiance whose squares are denormal numbers.
std::vector<float> sampled(pmc::Sampler& sampler, bool unusual) {
    std::fenv_t before;
    std::fegetenv(&before);
    if (unusual) make_unusual();
    while (sampler.done() == pmc::Done::no) {
        const auto batch = sampler.ask();
        std::vector<float> radiance;
        {
            const pmc::UsualArithmetic usual;
            for (std::size_t i = 0; i < batch->size(); ++i)
                for (std::uint32_t c = 0; c < 3; ++c)
                    radiance.push_back(std::ldexp(pmc::unit_float(pmc::hash32(batch->scramble[i] + 7 * batch->index[i] + c)), -20 - int(batch->pixel[i] % 120)));
        }
        if (batch->number % 5 == 3)
            sampler.drop(*batch);
        else
            sampler.tell(*batch, radiance);
    }
    const pmc::Film& film = sampler.film();
    const std::size_t pixels = film.tiling.pixels();
    std::vector<float> all(11 * pixels);
    pmc::corrected_mean(film, sampler.config, all.data(), sampler.threads());
    pmc::pool_mean(film, all.data() + 3 * pixels, sampler.threads());
    pmc::standard_error(film, all.data() + 6 * pixels, sampler.threads());
    pmc::for_each_pixel(film, sampler.threads(), [&](std::size_t i, std::size_t slot) {
        all[9 * pixels + i] = film.beta(slot);
        all[10 * pixels + i] = static_cast<float>(film.sums[slot].n);
    });
    const bool kept = unusual ? is_unusual() : is_usual();
    std::fesetenv(&before);
    require(kept, "the caller's state of arithmetic is as it was");
    return all;
}

void in_unusual_arithmetic(bool unbiased) {
    pmc::Config config;
    if (unbiased) config.estimator = pmc::Estimator::unbiased;
    pmc::Budget budget;
    budget.spp = 12.0;
    std::vector<float> expected;
    for (const unsigned threads : {1u, 3u}) {
        for (const bool unusual : {false, true}) {
            at = std::to_string(threads) + " threads" + (unusual ? ", unusual arithmetic" : "") + (unbiased ? ", unbiased" : "");
            pmc::Sampler sampler(150, 130, budget, config, 5, 0, threads);
            const std::vector<float> all = sampled(sampler, unusual);
            if (expected.empty()) expected = all;
            require(!std::memcmp(all.data(), expected.data(), all.size() * sizeof(float)), "bits do not depend on the caller's arithmetic");
        }
    }
}

void test() {
    for (int k = 0; k < 40; ++k) {
        pmc::Config config;
        if (k % 2) config.estimator = pmc::Estimator::unbiased;
        part_later(config);
    }
    part_sparsely();
    in_unusual_arithmetic(false);
    in_unusual_arithmetic(true);
}

}  // namespace

int main() { return report(test); }

// Random samplers of either estimator driven at random, to be run under sanitizers: batches open, told out of order, dropped, put
// back and partly invalid, radiance of any size and sign; saved and restored on the way; every picture read.  stress SEED SAMPLERS THREADS
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <map>
#include <memory>
#include <new>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include <pmc.hpp>

namespace {

std::mt19937_64 generator;

std::uint32_t below(std::uint32_t n) { return static_cast<std::uint32_t>(generator() % n); }
double share() { return below(4) == 0 ? 0.0 : below(4) == 0 ? 1.0 : below(1001) / 1000.0; }

void require(bool holds, const char* what) {
    if (!holds) throw std::runtime_error(std::string("does not hold: ") + what);
}

pmc::Config random_config(std::uint32_t width, std::uint32_t height) {
    pmc::Config c;
    if (below(2)) c.initial_spp = below(3);
    c.pool_share = below(8) ? 0.3 * share() : 1.0;
    c.direct_share = share();
    c.lookahead = below(4);
    if (below(3) == 0) c.population = 1 + below(width * height);
    else if (below(2)) c.batch = 1 + below(20000);
    c.moves = 1 + below(5);
    c.radii.clear();
    for (std::uint32_t k = below(4); k > 0; --k) c.radii.push_back((0.01 + 0.99 * below(1001) / 1000.0) * std::max(width, height));
    c.eliminate = share();
    c.regenerate_pool = share();
    c.regenerate_jitter = 3.0 * share();
    c.evaluate_regenerated = below(2);
    c.adapt_alpha_every = 1 + below(3);
    c.adapt_beta_every = 1 + below(3);
    c.alpha_memory = share();
    c.beta = below(2) ? pmc::Beta::gain : pmc::Beta::variance;
    const double powers[] = {0.5, 1.0, 1.5, 2.0};
    c.beta_power = powers[below(4)];
    c.filter = static_cast<pmc::Filter>(below(4));
    c.filter_radius = below(2) ? 0.5 : 2.0;
    c.correction_sigma = 0.5 + 30.0 * share();
    if (below(4) == 0) {
        c.estimator = pmc::Estimator::unbiased;
        c.population = 0;
        c.initial_spp = pmc::Config::automatic;
    }
    return c;
}

struct Image {
    std::uint32_t aovs;
    float scale;  // powers of two
    bool is_signed, faults;
};

std::vector<float> radiance_of(const pmc::Batch& batch, const Image& image, bool faults) {
    const std::uint32_t aovs = image.aovs;
    const std::size_t channels = 3 + aovs;
    std::vector<float> values(batch.size() * channels);
    for (std::size_t i = 0; i < batch.size(); ++i) {
        const float u = pmc::sobol_pair(batch.scramble[i], batch.index[i], 1).x, lit = batch.pixel[i] % 3 ? 1.0f : 0.0f;
        const float value = lit * image.scale * (u < 0.02f ? 1e4f : 0.1f + u);
        for (std::size_t c = 0; c < channels; ++c) values[i * channels + c] = image.is_signed && u > 0.5f ? -value : value;
        if (faults && u > 0.9f) values[i * channels] = u > 0.95f ? std::numeric_limits<float>::quiet_NaN() : -std::numeric_limits<float>::infinity();
    }
    return values;
}

// Through memory and into another sampler, which goes on in its place.
std::unique_ptr<pmc::Sampler> restored(pmc::Sampler& sampler, const Image& like, unsigned threads) {
    std::map<std::string, std::vector<std::byte>> blocks;
    pmc::Writer writer([&](const std::string& name, std::span<const std::byte> bytes) { blocks[name].assign(bytes.begin(), bytes.end()); });
    sampler.archive(writer);
    const pmc::Tiling& t = sampler.film().tiling;
    auto again = std::make_unique<pmc::Sampler>(t.width, t.height, sampler.budget, sampler.config, sampler.seed, like.aovs, threads, like.is_signed);
    pmc::Reader reader([&](const std::string& name) -> std::span<const std::byte> { return blocks.at(name); });
    again->archive(reader);
    return again;
}

void read_pictures(pmc::Sampler& sampler) {
    const pmc::Film& film = sampler.film();
    std::vector<float> image(3 * film.tiling.pixels()), other(image.size());
    const auto finite = [&](const std::vector<float>& values) {
        const float highest = std::numeric_limits<float>::max(), lowest = film.is_signed ? -highest : 0.0f;
        for (float v : values) require(v >= lowest && v <= highest, "a picture is finite, and not negative where radiance is not");
    };
    pmc::plain_mean(film, image.data(), sampler.threads()), finite(image);
    pmc::corrected_mean(film, sampler.config, image.data(), sampler.threads()), finite(image);
    pmc::pool_mean(film, image.data(), sampler.threads()), finite(image);
    pmc::strategy(film, image.data(), sampler.threads()), finite(image);
    pmc::halves(film, image.data(), other.data(), sampler.threads()), finite(image), finite(other);
    pmc::standard_error(film, image.data(), sampler.threads());
    for (std::size_t slot = 0; slot < film.sums.size(); ++slot) require(film.beta(slot) >= 0.0f && std::isfinite(film.beta(slot)), "beta is finite");
    const double noise = pmc::visible_noise(film, sampler.threads());
    require(noise >= 0.0 && noise <= 1.0, "the visible noise is a share");
    std::uint64_t samples = 0;
    for (std::size_t slot = 0; slot < film.sums.size(); ++slot) samples += film.sums[slot].n;
    require(samples == sampler.samples(), "the samples of all pixels are those told");
}

// Tile by tile, each sample in its pixel or around it.
void check_layout(const pmc::Batch& batch, const pmc::Sampler& sampler) {
    const pmc::Tiling& tiling = sampler.film().tiling;
    const double reach = sampler.config.filter_radius + 1e-2;
    for (std::size_t i = 0; i < batch.size(); ++i) {
        const std::uint32_t slot = batch.slot[i], x = tiling.x(slot), y = tiling.y(slot);
        require(i == 0 || batch.slot[i - 1] / pmc::Tiling::area <= slot / pmc::Tiling::area, "a batch is sorted");
        require(x < tiling.width && y < tiling.height && batch.pixel[i] == y * tiling.width + x, "a slot is its pixel's");
        require(std::abs(batch.positions[i].x - (x + 0.5)) <= reach && std::abs(batch.positions[i].y - (y + 0.5)) <= reach, "a position is its pixel's");
    }
}

void drive(unsigned threads) {
    const std::uint32_t width = 1 + below(150), height = 1 + below(120);
    pmc::Budget budget;
    budget.spp = 0.5 + below(100) / 10.0;
    const float scales[] = {1.0f, 1.0f, 0x1p-149f, 0x1p-100f, 0x1p110f};
    const Image image{below(3), scales[below(5)], below(4) == 0, below(3) == 0};
    const bool faults = image.faults;
    const pmc::Config config = random_config(width, height);
    if (below(4) == 0 && !config.is_unbiased()) budget.visible_noise = 0.01 + 0.98 * share();
    auto sampler = std::make_unique<pmc::Sampler>(width, height, budget, config, generator(), image.aovs, threads, image.is_signed);
    std::vector<std::shared_ptr<const pmc::Batch>> open;
    while (sampler->done() == pmc::Done::no) {
        if (open.empty() || below(3)) {
            try {
                open.push_back(sampler->ask());
                check_layout(*open.back(), *sampler);
                continue;
            } catch (const std::logic_error&) {
                require(!open.empty(), "ask refuses only where something is open");
            }
        }
        const std::size_t which = below(static_cast<std::uint32_t>(open.size()));
        const auto batch = open[which];
        open.erase(open.begin() + static_cast<std::ptrdiff_t>(which));
        const std::uint32_t action = below(20);
        if (action == 0) {
            sampler->drop(*batch);
        } else if (action == 1) {
            sampler->put_back(*batch);
        } else {
            const auto valid = radiance_of(*batch, image, false);
            try {
                sampler->tell(*batch, faults ? radiance_of(*batch, image, true) : valid);
            } catch (const std::invalid_argument&) {  // of a tiny batch, more than half may be faulty
                require(faults, "what is valid is taken");
                sampler->tell(*batch, valid);
            }
            try {
                sampler->tell(*batch, valid);
                require(false, "a batch is told once");
            } catch (const std::invalid_argument&) {
            }
        }
        if (below(30) == 0) sampler = restored(*sampler, image, threads), open.clear();
        if (below(30) == 0) read_pictures(*sampler);
    }
    const double pixels = double(width) * height;
    const std::uint64_t used = sampler->samples() + sampler->rejected(), total = static_cast<std::uint64_t>(std::max(1.0, std::round(budget.spp * pixels)));
    require(sampler->done() == pmc::Done::spp ? used == total : used <= total && budget.visible_noise >= 0.0, "the budget is met");
    require(faults || sampler->rejected() == 0, "what is valid is taken");
    read_pictures(*sampler);
}

// More bytes than there can be are refused, whatever their number is in 64 bits.
template <class T>
void refuse(std::size_t size) {
    try {
        pmc::Buffer<T>().resize(size);
    } catch (const std::bad_alloc&) {
        return;
    }
    require(false, "a buffer is as large as was asked for");
}

void check_buffers() {
    refuse<std::uint8_t>(~std::size_t(0));
    refuse<std::uint32_t>(std::size_t(1) << 62);
    refuse<std::uint32_t>(~std::size_t(0));
    for (const std::size_t size : {std::size_t(3), std::size_t(3) << 20}) {  // on the heap, and in pages of its own
        pmc::Buffer<std::uint32_t> a;
        a.resize(size);
        a[size - 1] = 7;
        pmc::Buffer<std::uint32_t> b = std::move(a);
        a.resize(size);
        a[size - 1] = 8;
        require(b.size() == size && b[size - 1] == 7, "what is moved is another's no more");
        b = std::move(a);
        require(b[size - 1] == 8 && a.size() == 0, "what is moved is another's no more");
        b.renew(1);
        b[0] = 9;
    }
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 4) return 2;
    generator.seed(std::strtoull(argv[1], nullptr, 10));
    const int samplers = std::atoi(argv[2]);
    try {
        check_buffers();
        for (int i = 0; i < samplers; ++i) drive(static_cast<unsigned>(std::atoi(argv[3])));
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
    std::printf("%d samplers\n", samplers);
}

// Draws from films of random scores against their exact expectations.
#include <algorithm>
#include <cmath>
#include <memory>

#include <film.hpp>
#include <systematic.hpp>

#include "piece.hpp"

namespace {

enum class Noise { everywhere, sparse, some_tiles, one_pixel, nowhere, steep, faint };

bool noisy(Noise noise, const pmc::Tiling& tiling, std::uint32_t slot) {
    const std::uint32_t tile = slot / pmc::Tiling::area;
    switch (noise) {
    case Noise::everywhere: case Noise::faint: return true;
    case Noise::sparse: return pmc::hash32(slot) % 97 == 0;
    case Noise::some_tiles: return tile >= tiling.tiles() / 3 && tile < tiling.tiles() / 2 && tile % 3;
    case Noise::one_pixel: return slot == tiling.slot(tiling.width / 2, tiling.height / 3);
    case Noise::nowhere: return false;
    case Noise::steep: return tiling.x(slot) > 0;
    }
    return false;
}

// Over 24 powers of ten. Or faint: what beta comes to is next to nothing. Or dark, where variance alone counts, a tile's first row of about 2^24 times the variance of the others, which
// as floats add more than half a last place to it: one.
float brightness_of(Noise noise, const pmc::Tiling& tiling, std::uint32_t slot, std::uint32_t random) {
    if (noise == Noise::faint) return 1e-14f * static_cast<float>(1 + random % 9);
    if (noise != Noise::steep) return std::pow(10.0f, static_cast<float>(random % 24) - 12.0f);
    return 1e-8f * (1.0f + static_cast<float>(tiling.x(slot)) / 16.0f) * (tiling.y(slot) % pmc::Tiling::side ? 1.01f * 0x1p-12f : 1.0f);
}

constexpr std::uint32_t most_drawn = 0x7fffffffu;  // from a pixel

// A film with samples from a seed, and draws from it.
struct Steered {
    Steered(std::uint32_t width, std::uint32_t height, const pmc::Config& config, Noise noise, std::uint32_t seed, unsigned count)
        : threads(count), film(width, height, config, 0) {
        std::vector<std::uint32_t> slots;
        std::vector<float> radiance;
        for (std::uint32_t slot = 0; slot < film.sums.size(); ++slot) {
            if (!film.tiling.inside(slot)) continue;
            const pmc::Stream stream(seed, 0, slot);
            const float brightness = brightness_of(noise, film.tiling, slot, stream.word(0));
            const bool varies = noisy(noise, film.tiling, slot), steep = noise == Noise::steep;
            for (std::uint32_t k = steep ? 2 : stream.word(1) % 6; k > 0; --k) {
                slots.push_back(slot);
                for (std::uint32_t c = 0; c < 3; ++c) {
                    const float noise_here = steep ? static_cast<float>(k) : stream.uniform(k, c + 1);
                    radiance.push_back(varies ? brightness * noise_here : brightness);
                }
            }
            film.drawn[slot] = stream.word(2) % 50 ? stream.word(3) % 9 : most_drawn + 1;
        }
        pmc::Batch batch;
        batch.pixel.resize(slots.size());
        batch.slot.resize(slots.size());
        batch.tag.resize(slots.size());
        std::copy(slots.begin(), slots.end(), batch.slot.data());
        std::fill_n(batch.tag.data(), slots.size(), std::uint8_t(pmc::Tag::pool | pmc::Tag::no_kernel));
        film.add(batch, radiance.data(), false, threads);
        film.part(threads);
        if (config.is_unbiased()) {
            film.guide(threads);
            film.select(seed % 2);
        }
        draw = std::make_unique<pmc::SystematicDraw>(film, 2.5f, threads);
    }

    pmc::ThreadPool threads;
    pmc::Film film;
    std::unique_ptr<pmc::SystematicDraw> draw;
};

struct Drawn {
    std::vector<std::uint32_t> slots, starts;
    bool operator==(const Drawn&) const = default;
};

Drawn drawn(Steered& from, std::size_t count, float offset) {
    constexpr std::uint32_t nothing = ~0u;
    Drawn d{std::vector(count + 1, nothing), std::vector(from.film.tiling.tiles() + 1, nothing)};
    bool called = false;
    (*from.draw)(count, offset, d.slots.data(), d.starts.data(), from.threads, [&] { called = true; });
    require(called, "what is to be done beside it is done");
    require(std::find(d.slots.begin(), d.slots.end(), nothing) == d.slots.end() - 1, "there are as many draws as were asked for");
    d.slots.pop_back();
    std::vector<std::uint32_t> alone(count);
    (*from.draw)(count, offset, alone.data(), nullptr, from.threads, [] {});
    require(alone == d.slots, "the draws are the same where nobody asks for their starts");
    return d;
}

// What a film's pixels are drawn by, and exact sums of it.
struct Exact {
    explicit Exact(const pmc::Film& film) : weight(film.tiling.slots()), tile(film.tiling.tiles(), 0.0L), largest(film.tiling.tiles()) {
        for (std::uint32_t t = 0; t < tile.size(); ++t) {
            pmc::TileWeights w;
            film.weights(t, w);
            for (std::uint32_t i = 0; i < pmc::Tiling::area; ++i) {
                weight[t * pmc::Tiling::area + i] = w.pixel[i];
                tile[t] += w.pixel[i];
                largest[t] = std::max(largest[t], w.pixel[i]);
            }
            total += tile[t];
        }
    }

    std::vector<float> weight;
    std::vector<long double> tile;
    std::vector<float> largest;
    long double total = 0.0L;
};

// Columns of 16 weights are summed as floats, of which the total is the sum: what that may change, as a share.
constexpr long double rounding_of_sums = 2 * 15 * 0x1p-24L;

void check_pixels(const std::vector<std::size_t>& draws, long double count, const Exact& exact) {
    for (std::size_t slot = 0; slot < draws.size(); ++slot) {
        const std::size_t tile = slot / pmc::Tiling::area;
        const float weight = exact.weight[slot];
        require(weight > 0.0f || draws[slot] == 0, "a pixel without weight is never drawn");
        // The largest of a tile has what falls between rounded sums beside its own.
        const long double most = weight == exact.largest[tile] ? 2.0L : 1.0L, allowance = rounding_of_sums * count * exact.tile[tile] / exact.total + 1e-9L;
        const long double more = static_cast<long double>(draws[slot]) - count * weight / exact.total;
        require(more > -1.0L - allowance && more < most + allowance, "a pixel is drawn as often as its weight says, to less than one");
    }
}

std::vector<std::size_t> by_pixel(const std::vector<std::uint32_t>& all, const Exact& exact) {
    std::vector<std::size_t> draws(exact.weight.size(), 0);
    for (const std::uint32_t slot : all) ++draws.at(slot);
    return draws;
}

// Draws lie where the cumulative weight, in units of which there are as many as draws, and the offset come to a whole number.
void check_density(const std::vector<std::uint32_t>& all, const Exact& exact, float offset) {
    const std::vector<std::size_t> draws = by_pixel(all, exact);
    const auto count = static_cast<long double>(all.size());
    check_pixels(draws, count, exact);
    long double weight_until = 0.0L, draws_until = 0.0L;
    for (std::size_t t = 0; t < exact.tile.size(); ++t) {
        weight_until += exact.tile[t];
        for (std::size_t slot = t * pmc::Tiling::area; slot < (t + 1) * pmc::Tiling::area; ++slot) draws_until += static_cast<long double>(draws[slot]);
        const long double more = draws_until - count * weight_until / exact.total, allowance = rounding_of_sums * count + 1e-9L;
        require(more > offset - 1.0L - allowance && more < offset + allowance, "draws come in equal steps of the weight of tiles, from the offset on");
    }
}

// All draws from offsets in equal steps are those of one draw of smaller steps.
void check_offsets(Steered& from, std::size_t count, const Exact& exact) {
    constexpr std::uint32_t offsets = 16;
    const float first = pmc::unit_float(static_cast<std::uint32_t>(generator()) & ~0xfffu) / offsets;
    std::vector<std::uint32_t> all;
    for (std::uint32_t k = 0; k < offsets; ++k) {
        const std::vector<std::uint32_t> some = drawn(from, count, first + static_cast<float>(k) / offsets).slots;
        all.insert(all.end(), some.begin(), some.end());
    }
    check_pixels(by_pixel(all, exact), static_cast<long double>(all.size()), exact);
}

void check_starts(const Drawn& d) {
    for (std::size_t t = 0; t < d.starts.size(); ++t) {
        const auto before = std::count_if(d.slots.begin(), d.slots.end(), [&](std::uint32_t slot) { return slot / pmc::Tiling::area < t; });
        require(d.starts[t] == static_cast<std::uint32_t>(before), "starts count the draws before each tile");
    }
}

void draw_from(std::uint32_t width, std::uint32_t height, const pmc::Config& config, Noise noise) {
    const auto seed = static_cast<std::uint32_t>(generator());
    const std::string drawn_by = (config.is_unbiased() ? ", unbiased, power " : ", power ") + std::to_string(config.beta_power);
    const std::string image = size_of(width, height) + drawn_by + ", noise " + std::to_string(static_cast<int>(noise)) + ", seed " + std::to_string(seed);
    at = image;
    Steered one(width, height, config, noise, seed, 1), two(width, height, config, noise, seed, 2), five(width, height, config, noise, seed, 5);
    const Exact exact(one.film);
    require(std::abs(one.draw->total() - exact.total) <= rounding_of_sums * exact.total, "the total is the sum of weights");
    require(one.draw->total() == two.draw->total() && one.draw->total() == five.draw->total(), "sums do not depend on threads");
    for (std::size_t slot = 0; slot < exact.weight.size() && !config.is_unbiased(); ++slot)
        require(one.film.drawn[slot] <= most_drawn || exact.weight[slot] == 0.0f, "a pixel that has all that it may has no weight");
    require(noise != Noise::nowhere || config.is_unbiased() || exact.total == 0.0L, "where there is no noise nothing has weight");
    if (!(exact.total > 0.0L)) return;
    const std::uint32_t pixels = width * height, counts[] = {1, 2, 1 + below(20), 1 + below(pixels), 1 + below(4 * pixels)};
    for (const std::uint32_t count : counts) {
        const float offset = below(8) == 0 ? 0.0f : below(8) == 0 ? 1.0f - 0x1p-24f : pmc::unit_float(static_cast<std::uint32_t>(generator()));
        at = image + ", " + std::to_string(count) + " draws from " + std::to_string(offset);
        const Drawn d = drawn(one, count, offset);
        const auto by_tile = [](std::uint32_t a, std::uint32_t b) { return a / pmc::Tiling::area < b / pmc::Tiling::area; };
        require(std::is_sorted(d.slots.begin(), d.slots.end(), by_tile), "draws come out tile by tile");
        check_starts(d);
        check_density(d.slots, exact, offset);
        if (pixels < 4000) check_offsets(one, count, exact);
        require(d == drawn(two, count, offset) && d == drawn(five, count, offset), "draws do not depend on threads");
    }
}

// So many draws that some fall between the sums of columns and those of their pixels, which are rounded each in its own way.
void draw_between() {
    pmc::Config config;
    config.beta = pmc::Beta::variance;
    config.beta_power = 1.0;
    Steered steep(16, 16, config, Noise::steep, 1, 2);
    const Exact exact(steep.film);
    for (const float offset : {0.0f, 0.25f, 0.5f, 0.75f}) {
        at = "16x16, steep, from " + std::to_string(offset);
        check_density(drawn(steep, 1 << 22, offset).slots, exact, offset);
    }
}

void test() {
    draw_between();
    const Size sizes[] = {{1, 1}, {13, 20}, {48, 48}, {100, 37}, {16 * 9, 16 * 15}, {333, 130}};
    for (const auto& [width, height] : sizes) {
        for (const Noise noise : {Noise::everywhere, Noise::sparse, Noise::some_tiles, Noise::one_pixel, Noise::nowhere, Noise::faint}) {
            pmc::Config config;
            const double powers[] = {0.5, 1.0, 1.5, 2.0};
            config.beta_power = powers[below(4)];
            config.beta = below(2) ? pmc::Beta::gain : pmc::Beta::variance;
            draw_from(width, height, config, noise);
            config.beta_power = 2.0;
            draw_from(width, height, config, noise);
            config.estimator = pmc::Estimator::unbiased;
            draw_from(width, height, config, noise);
        }
    }
}

}  // namespace

int main() { return report(test); }

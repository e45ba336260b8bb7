// Parts of the core one by one, each held to its definition; says what does not hold.
//   pieces pool          a stretch of the pool, read tile by tile, against the pool one by one
//   pieces systematic    draws from films of random scores against their exact expectations
//   pieces parallel      the thread pool, on its own threads and on others'
//   pieces rounding      numbers in 40 bits and in a float against their neighbours
//   pieces perception    the table of 1 / tvi^2 against tvi
#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cfenv>
#include <cfloat>
#include <chrono>
#include <cmath>
#include <compare>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <limits>
#include <memory>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include <film.hpp>
#include <pool.hpp>
#include <systematic.hpp>

namespace {

std::mt19937_64 generator(1);
std::string at;  // what is tested now

std::uint32_t below(std::uint32_t n) { return static_cast<std::uint32_t>(generator() % n); }

void require(bool holds, const char* what) {
    if (!holds) throw std::runtime_error(at + ": does not hold: " + what);
}

using Size = std::pair<std::uint32_t, std::uint32_t>;
std::string size_of(std::uint32_t width, std::uint32_t height) { return std::to_string(width) + "x" + std::to_string(height); }

// --- Pool ------------------------------------------------------------------------------------------------------------
struct Visit {
    std::uint32_t slot, pass;
    auto operator<=>(const Visit&) const = default;
};

// By slot; the passes of a pixel as they came.
std::vector<Visit> by_tile(const pmc::Pool::Stretch& stretch, const pmc::Tiling& tiling) {
    std::vector<Visit> visits;
    for (std::uint32_t tile = 0; tile < tiling.tiles(); ++tile) {
        const std::size_t first = visits.size();
        stretch.in_tile(tile, [&](std::uint32_t local, std::uint32_t pass) {
            require(local < pmc::Tiling::area, "a pixel lies in its tile");
            visits.push_back({tile * pmc::Tiling::area + local, pass});
        });
        require(stretch.count(tile) == visits.size() - first, "a stretch counts what it has in a tile");
        const auto by_slot = [](const Visit& a, const Visit& b) { return a.slot < b.slot; };
        std::stable_sort(visits.begin() + static_cast<std::ptrdiff_t>(first), visits.end(), by_slot);
    }
    return visits;
}

std::vector<Visit> one_by_one(pmc::Pool& pool, std::size_t count) {
    std::vector<Visit> visits;
    pool.take(count, [&](std::uint32_t slot, std::uint32_t pass) {
        require(visits.empty() || visits.back().pass <= pass, "the pool goes from pass to pass");
        visits.push_back({slot, pass});
    });
    std::sort(visits.begin(), visits.end());
    return visits;
}

// How many to take next, of `left` until the end of a pass.
std::size_t some(std::size_t pixels, std::size_t left) {
    const auto n = static_cast<std::uint32_t>(pixels);
    switch (below(8)) {
    case 0: return 0;
    case 1: return 1;
    case 2: return 2 + below(20);
    case 3: return left;
    case 4: return left + pixels * below(4);
    case 5: return pixels * (1 + below(3));
    case 6: return 1 + below(n);
    default: return 1 + below(4 * n);
    }
}

void follow_pool(std::uint32_t width, std::uint32_t height, int takes) {
    const pmc::Tiling tiling(width, height);
    const auto seed = static_cast<std::uint32_t>(generator());
    pmc::Pool a(tiling, seed), b(tiling, seed);
    std::vector<std::uint32_t> passes(tiling.slots(), 0);  // that each pixel had
    std::size_t taken = 0;
    for (int k = 0; k < takes; ++k) {
        const std::size_t pixels = tiling.pixels(), count = some(pixels, pixels - taken % pixels);
        at = size_of(width, height) + ", seed " + std::to_string(seed) + ", " + std::to_string(count) + " after " + std::to_string(taken);
        if (below(2)) std::swap(a, b);
        const pmc::Pool::Stretch& stretch = a.take(count);
        const std::vector<Visit> visits = by_tile(stretch, tiling);
        require(stretch.size() == count && visits.size() == count, "a stretch is as long as was asked for");
        require(std::is_sorted(visits.begin(), visits.end()), "the passes of a pixel follow in turn");
        require(visits == one_by_one(b, count), "a stretch has the pixels that come one by one");
        // Padding that follows the last pixel may be left behind or not: what comes next is the same.
        require(a.cursor() == b.cursor() || tiling.pixels() < tiling.slots(), "both ways end at the same place");
        taken += count;
        for (const Visit& v : visits) {
            require(tiling.inside(v.slot), "a pixel lies in the image");
            require(v.pass == passes[v.slot]++, "a pixel comes once in each pass");
        }
        for (std::uint32_t slot = 0; slot < passes.size(); ++slot)
            require(!tiling.inside(slot) || passes[slot] - taken / pixels <= (taken % pixels ? 1 : 0), "a pass ends before the next begins");
        if (below(4) == 0) {
            pmc::Pool again(tiling, seed);
            again.set_cursor(a.cursor());
            std::swap(a, again);
        }
    }
}

void pool() {
    const Size sizes[] = {{1, 1}, {1, 9}, {13, 1}, {15, 16}, {16, 16}, {17, 16}, {32, 16}, {33, 21}, {48, 48}, {64, 48}, {100, 37}};
    for (const auto& [width, height] : sizes)
        for (int k = 0; k < 3; ++k) follow_pool(width, height, 30);
    for (int k = 0; k < 60; ++k) {
        const bool whole = below(3) == 0;
        follow_pool(whole ? 16 * (1 + below(5)) : 1 + below(80), whole ? 16 * (1 + below(5)) : 1 + below(60), 20);
    }
}

// --- Systematic draws ------------------------------------------------------------------------------------------------
enum class Noise { everywhere, sparse, some_tiles, one_pixel, nowhere, steep };

bool noisy(Noise noise, const pmc::Tiling& tiling, std::uint32_t slot) {
    const std::uint32_t tile = slot / pmc::Tiling::area;
    switch (noise) {
    case Noise::everywhere: return true;
    case Noise::sparse: return pmc::hash32(slot) % 97 == 0;
    case Noise::some_tiles: return tile >= tiling.tiles() / 3 && tile < tiling.tiles() / 2 && tile % 3;
    case Noise::one_pixel: return slot == tiling.slot(tiling.width / 2, tiling.height / 3);
    case Noise::nowhere: return false;
    case Noise::steep: return tiling.x(slot) > 0;
    }
    return false;
}

// Over 24 powers of ten. Or dark, where variance alone counts, a tile's first row of about 2^24 times the variance of the others, which
// as floats add more than half a last place to it: one.
float brightness_of(Noise noise, const pmc::Tiling& tiling, std::uint32_t slot, std::uint32_t random) {
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
    std::vector<std::uint32_t> direct, member, starts;
    bool operator==(const Drawn&) const = default;
};

Drawn drawn(Steered& from, std::size_t count, std::size_t members, float offset) {
    constexpr std::uint32_t nothing = ~0u;
    Drawn d{std::vector(count + 1, nothing), std::vector(count + 1, nothing), std::vector(from.film.tiling.tiles() + 1, nothing)};
    (*from.draw)(count, offset, pmc::Shares(count, members, d.direct.data(), d.member.data(), d.starts.data()), from.threads);
    const auto filled = [&](const std::vector<std::uint32_t>& slots, std::size_t n) {
        return std::count(slots.begin(), slots.begin() + static_cast<std::ptrdiff_t>(n), nothing) == 0 && slots[n] == nothing;
    };
    require(filled(d.direct, count - members) && filled(d.member, members), "there are as many draws of each kind as were asked for");
    d.direct.resize(count - members);
    d.member.resize(members);
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

// Draws lie where the cumulative weight, in units of which there are as many as draws, passes a whole number + offset.
void check_density(const std::vector<std::uint32_t>& all, const Exact& exact, float offset) {
    const std::vector<std::size_t> draws = by_pixel(all, exact);
    const auto count = static_cast<long double>(all.size());
    check_pixels(draws, count, exact);
    long double weight_until = 0.0L, draws_until = 0.0L;
    for (std::size_t t = 0; t < exact.tile.size(); ++t) {
        weight_until += exact.tile[t];
        for (std::size_t slot = t * pmc::Tiling::area; slot < (t + 1) * pmc::Tiling::area; ++slot) draws_until += static_cast<long double>(draws[slot]);
        const long double more = draws_until - count * weight_until / exact.total, allowance = rounding_of_sums * count + 1e-9L;
        require(more > -offset - allowance && more < 1.0L - offset + allowance, "draws come in equal steps of the weight of tiles, from the offset on");
    }
}

// All draws from offsets in equal steps are those of one draw of smaller steps.
void check_offsets(Steered& from, std::size_t count, const Exact& exact) {
    constexpr std::uint32_t offsets = 16;
    const float first = pmc::unit_float(static_cast<std::uint32_t>(generator()) & ~0xfffu) / offsets;
    std::vector<std::uint32_t> all;
    for (std::uint32_t k = 0; k < offsets; ++k) {
        const std::vector<std::uint32_t> some = drawn(from, count, 0, first + static_cast<float>(k) / offsets).direct;
        all.insert(all.end(), some.begin(), some.end());
    }
    check_pixels(by_pixel(all, exact), static_cast<long double>(all.size()), exact);
}

void check_shares(const Drawn& d, const std::vector<std::uint32_t>& all, std::size_t members) {
    // By definition: of n draws, m of them members, the i-th is one where m i / n passes a whole number.
    std::vector<std::uint32_t> direct, member;
    for (std::size_t i = 0; i < all.size(); ++i) ((i + 1) * members / all.size() > i * members / all.size() ? member : direct).push_back(all[i]);
    require(d.member == member, "members are evenly spaced among the draws");
    require(d.direct == direct, "direct draws are the others");
    for (std::size_t t = 0; t < d.starts.size(); ++t) {
        const auto before = std::count_if(direct.begin(), direct.end(), [&](std::uint32_t slot) { return slot / pmc::Tiling::area < t; });
        require(d.starts[t] == static_cast<std::uint32_t>(before), "starts count the direct draws before each tile");
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
        const std::vector<std::uint32_t> all = drawn(one, count, 0, offset).direct;
        const auto by_tile = [](std::uint32_t a, std::uint32_t b) { return a / pmc::Tiling::area < b / pmc::Tiling::area; };
        require(std::is_sorted(all.begin(), all.end(), by_tile), "draws come out tile by tile");
        check_density(all, exact, offset);
        if (pixels < 4000) check_offsets(one, count, exact);
        for (const std::uint32_t members : {0u, 1u, count / 3, below(count + 1), count}) {
            const Drawn d = drawn(one, count, members, offset);
            check_shares(d, all, members);
            require(d == drawn(two, count, members, offset) && d == drawn(five, count, members, offset), "draws do not depend on threads");
        }
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
        check_density(drawn(steep, 1 << 22, 0, offset).direct, exact, offset);
    }
}

void systematic() {
    draw_between();
    const Size sizes[] = {{1, 1}, {13, 20}, {48, 48}, {100, 37}, {16 * 9, 16 * 15}, {333, 130}};
    for (const auto& [width, height] : sizes) {
        for (const Noise noise : {Noise::everywhere, Noise::sparse, Noise::some_tiles, Noise::one_pixel, Noise::nowhere}) {
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

// --- Threads ---------------------------------------------------------------------------------------------------------
// Arithmetic as others' threads may have it: rounding up and, where the processor can, denormal numbers as zeros.
void make_unusual() {
    std::fesetround(FE_UPWARD);
#if defined(__x86_64__)
    _mm_setcsr(_mm_getcsr() | 0x8040u);
#endif
}
bool is_unusual() {
#if defined(__x86_64__)
    if ((_mm_getcsr() & 0x8040u) != 0x8040u) return false;
#endif
    return std::fegetround() == FE_UPWARD;
}
bool is_usual() {
    volatile float least = FLT_MIN, smallest = std::numeric_limits<float>::denorm_min(), one = 1.0f;
    volatile double least_double = DBL_MIN, smallest_double = std::numeric_limits<double>::denorm_min();
    const volatile float half = 0.5f * least, sum = smallest + smallest, next = one + 0x1p-30f;
    const volatile double half_double = 0.5 * least_double, sum_double = smallest_double + smallest_double;
    return std::bit_cast<std::uint32_t>(float(half)) == 0x00400000u && std::bit_cast<std::uint32_t>(float(sum)) == 2u && next == one &&
           std::bit_cast<std::uint64_t>(double(half_double)) == 0x0008000000000000u && std::bit_cast<std::uint64_t>(double(sum_double)) == 2u;
}

class InCaller : public pmc::Executor {
public:
    unsigned size() const override { return 4; }
    void run(unsigned calls, void (*task)(unsigned thread, void* data), void* data) override {
        const bool was = is_unusual();
        for (unsigned t = calls; t-- > 0;) {
            task(0, data);
            kept &= is_unusual() == was;
        }
    }

    bool kept = true;  // the state of arithmetic
};

class OnUnusualThreads : public pmc::Executor {
public:
    unsigned size() const override { return 3; }
    void run(unsigned calls, void (*task)(unsigned thread, void* data), void* data) override {
        std::vector<std::thread> threads;
        for (unsigned t = 0; t < calls; ++t) {
            threads.emplace_back([=, this] {
                make_unusual();
                task(5 * t + 2, data);
                if (!is_unusual()) kept = false;
            });
        }
        for (std::thread& thread : threads) thread.join();
    }

    std::atomic<bool> kept{true};
};

using Calls = std::vector<std::atomic<unsigned>>;

bool all_once(const Calls& calls) {
    return std::all_of(calls.begin(), calls.end(), [](const auto& n) { return n == 1; });
}

// Some tasks take longer than others.
void call(Calls& calls, std::size_t i) {
    if (i % 13 == 5) std::this_thread::yield();
    ++calls.at(i);
}

void each_once(pmc::ThreadPool& pool, std::size_t count) {
    Calls calls(count), in_ranges(count);
    pool.run(count, [&](std::size_t i) { call(calls, i); });
    require(all_once(calls), "each index is called once");
    const std::size_t grain = below(2) ? 1 : below(300);
    std::atomic<std::size_t> pieces{0};
    pool.ranges(count, grain, [&](std::size_t first, std::size_t last) {
        ++pieces;
        require(last - first >= std::min(grain, count), "no range is smaller than it is to be");
        for (std::size_t i = first; i < last; ++i) call(in_ranges, i);
    });
    require(all_once(in_ranges), "each index is in one range");
    require(pieces <= std::max<std::size_t>(1, 8 * pool.size()), "there are several ranges for each thread, not many");
}

struct Thrown : std::runtime_error {
    explicit Thrown(std::size_t i) : std::runtime_error(at + ": thrown by task " + std::to_string(i)), i(i) {}
    std::size_t i;
};

// Every `step`-th task from `first` on throws.
void throwing(pmc::ThreadPool& pool, std::size_t count, std::size_t first, std::size_t step) {
    Calls calls(count);
    const auto throws = [&](std::size_t i) { return i >= first && (i - first) % step == 0; };
    try {
        pool.run(count, [&](std::size_t i) {
            call(calls, i);
            if (throws(i)) throw Thrown{i};
        });
        require(false, "an exception reaches the caller");
    } catch (const Thrown& thrown) {
        require(throws(thrown.i), "an exception is a task's own");
    }
    if (pool.size() > 1)
        require(all_once(calls), "all tasks are called though some throw");
    else  // nobody else goes on
        for (std::size_t i = 0; i < count; ++i) require(calls[i] == (i <= first), "a single thread stops where it throws");
}

// Each of two tasks waits for the other: no thread does both. The caller then waits for the other's, for so long that it may sleep.
void at_once(pmc::ThreadPool& pool) {
    const std::thread::id caller = std::this_thread::get_id();
    std::atomic<int> here{0}, done{0};
    pool.run(2, [&](std::size_t) {
        ++here;
        while (here < 2) std::this_thread::yield();
        if (std::this_thread::get_id() != caller) std::this_thread::sleep_for(std::chrono::milliseconds(5));
        ++done;
    });
    require(done == 2, "a run ends after its tasks");
}

void drive(pmc::ThreadPool& pool, const std::string& name, int rounds) {
    for (int k = 0; k < rounds; ++k) {
        for (const bool awake : {false, true}) {
            std::unique_ptr<pmc::ThreadPool::Awake> lives;
            if (awake) lives = std::make_unique<pmc::ThreadPool::Awake>(pool);
            for (const std::size_t count : {0, 1, 2, 1000}) {
                at = name + (awake ? ", awake, " : ", ") + std::to_string(count) + " tasks, round " + std::to_string(k);
                each_once(pool, count);
                if (count == 0) continue;
                throwing(pool, count, below(static_cast<std::uint32_t>(count)), 1 + below(static_cast<std::uint32_t>(count)));
                each_once(pool, count);
            }
        }
    }
}

void parallel() {
    for (const unsigned threads : {1u, 2u, 16u}) {
        pmc::ThreadPool pool(threads);
        require(pool.size() == threads, "a pool has the threads that were asked for");
        drive(pool, std::to_string(threads) + " threads", 15);
        for (const bool awake : {false, true}) {
            if (threads == 1) continue;
            at = std::to_string(threads) + " threads that slept" + (awake ? ", awake" : "");
            std::this_thread::sleep_for(std::chrono::milliseconds(5));
            std::unique_ptr<pmc::ThreadPool::Awake> lives;
            if (awake) lives = std::make_unique<pmc::ThreadPool::Awake>(pool);
            at_once(pool);
        }
    }
    for (int k = 0; k < 100; ++k) {
        pmc::ThreadPool pool(1 + below(4));
        at = "pool " + std::to_string(k) + " of " + std::to_string(pool.size());
        if (below(2)) each_once(pool, below(100));
    }
    const auto others = std::make_shared<OnUnusualThreads>();
    pmc::ThreadPool on_threads((pmc::Threads(others)));
    require(on_threads.size() == others->size(), "a pool is as large as its executor");
    drive(on_threads, "others' threads", 5);
    at_once(on_threads);
    const auto caller = std::make_shared<InCaller>();
    pmc::ThreadPool in_caller((pmc::Threads(caller)));
    drive(in_caller, "an executor in the caller", 15);

    std::fenv_t before;
    std::fegetenv(&before);
    for (const bool unusual : {false, true}) {
        for (pmc::ThreadPool* pool : {&on_threads, &in_caller}) {
            at = std::string(pool == &in_caller ? "in the caller" : "on others' threads") + (unusual ? ", whose arithmetic is unusual" : "");
            if (unusual) make_unusual();
            std::atomic<int> right{0};
            pool->run(100, [&](std::size_t) { right += is_usual(); });
            const bool kept = unusual ? is_unusual() : is_usual();
            std::fesetenv(&before);
            require(right == 100, "a task computes with denormal numbers and rounds to the nearest");
            require(kept && others->kept && caller->kept, "the state of arithmetic is the thread's own again");
        }
    }
}

// --- Rounding --------------------------------------------------------------------------------------------------------
bool same(double a, double b) { return std::bit_cast<std::uint64_t>(a) == std::bit_cast<std::uint64_t>(b); }

double any_double() {
    for (;;) {
        const double value = std::bit_cast<double>(generator());
        if (std::isfinite(value)) return value;
    }
}
float any_float() {
    const float extremes[] = {0.0f, -0.0f, FLT_MAX, -FLT_MAX, FLT_MIN, std::numeric_limits<float>::denorm_min(), std::numeric_limits<float>::infinity()};
    if (below(8) == 0) return extremes[below(7)];
    for (;;) {
        const float value = std::bit_cast<float>(static_cast<std::uint32_t>(generator()));
        if (value == value) return value;
    }
}
// Of the size that sums have.
double usual_double() {
    const double mantissa = 1.0 + static_cast<double>(generator() >> 12) * 0x1p-52;
    return std::ldexp(below(2) ? mantissa : -mantissa, static_cast<int>(below(60)) - 30);
}

// The largest number with a mantissa of `bits` that is not above |value|, with its sign; and its last place.
std::pair<double, double> towards_zero(double value, int bits) {
    const int exponent = std::max(value == 0.0 ? DBL_MIN_EXP : std::ilogb(value), DBL_MIN_EXP - 1) - bits;
    return {std::ldexp(std::trunc(std::ldexp(value, -exponent)), exponent), std::copysign(std::ldexp(1.0, exponent), value)};
}
bool is_neighbour(double rounded, double value, int bits) {
    const auto [lower, place] = towards_zero(value, bits);
    return same(rounded, lower) || (lower != value && same(rounded, lower + place));
}

template <int N>
std::array<double, 4> through(const std::array<double, 4>& values, std::uint32_t dither) {
    pmc::Reals40<N> kept;
    kept.set(pmc::Quad{values[0], values[1], values[2], values[3]}, dither);
    if (N < 4) {
        pmc::Reals40<N> again;
        again.set(pmc::Quad{values[0], values[1], values[2], 1e-3 - values[3]}, dither);
        require(!std::memcmp(&kept, &again, sizeof(kept)), "nothing is taken of what is beyond the last");
    }
    pmc::Quad all;
    kept.get(all);
    for (int i = 0; i < N; ++i) require(same(kept.get(i), all[i]), "a number is the same alone and with the others");
    for (int i = N; i < 4; ++i) require(same(all[i], 0.0), "beyond the last there is 0");
    return {all[0], all[1], all[2], all[3]};
}

template <int N>
void reals() {
    at = "Reals40<" + std::to_string(N) + ">";
    static_assert(sizeof(pmc::Reals40<N>) == 4 * (N + 1));
    std::array<double, 4> values;
    for (int k = 0; k < 100'000; ++k) {
        const auto dither = below(16) ? static_cast<std::uint32_t>(generator()) : ~0u;
        for (double& v : values) v = any_float();
        if (k % 4 == 0) values[3] = N > 3 ? values[3] : std::numeric_limits<double>::quiet_NaN();
        auto kept = through<N>(values, dither);
        for (int i = 0; i < N; ++i) require(same(kept[i], values[i]), "what a float can hold is held exactly");
        for (double& v : values) v = below(2) ? any_double() : usual_double();
        kept = through<N>(values, dither);
        for (int i = 0; i < N; ++i) require(is_neighbour(kept[i], values[i], 28), "a number becomes one of its neighbours");
    }
    for (int k = 0; k < 200; ++k) {
        for (double& v : values) v = usual_double();
        // In last places: how often each number was rounded away from 0, and how often it should.
        const auto even = [&](std::uint32_t dithers, auto&& dither, double most) {
            double up[N] = {};
            for (std::uint32_t n = 0; n < dithers; ++n) {
                const auto kept = through<N>(values, dither(n));
                for (int i = 0; i < N; ++i) up[i] += (kept[i] - towards_zero(values[i], 28).first) / towards_zero(values[i], 28).second;
            }
            for (int i = 0; i < N; ++i) {
                const auto [lower, place] = towards_zero(values[i], 28);
                require(std::abs(up[i] - dithers * ((values[i] - lower) / place)) < most, "rounding has no bias");
            }
        };
        const auto start = static_cast<std::uint32_t>(generator());
        even(1024, [&](std::uint32_t n) { return start + (n << 22); }, 1.0 + 1e-3);
        // A golden-ratio sequence of n numbers is out of step with its expectation by less than log n, or so.
        even(1000, [&](std::uint32_t n) { return pmc::dither(start + n); }, 1.0 + std::log(1000.0));
    }
}

void floats() {
    at = "rounded";
    for (int k = 0; k < 100'000; ++k) {
        const auto dither = static_cast<std::uint32_t>(generator());
        const float exact = any_float();
        if (std::isfinite(exact)) require(same(pmc::rounded(exact, dither), exact), "a float stays as it is");
        const double value = usual_double();
        require(is_neighbour(pmc::rounded(value, dither), value, 23), "a number becomes one of its neighbours");
    }
    for (const double value : {1e39, DBL_MAX, std::numeric_limits<double>::infinity()})
        require(pmc::rounded(value, ~0u) == FLT_MAX && pmc::rounded(-value, ~0u) == -FLT_MAX, "a float has an end");
    for (int k = 0; k < 200; ++k) {
        const double value = usual_double();
        const auto [lower, place] = towards_zero(value, 23);
        const auto start = static_cast<std::uint32_t>(generator());
        double up = 0.0;
        for (std::uint32_t n = 0; n < 1024; ++n) up += (pmc::rounded(value, start + (n << 22)) - lower) / place;
        require(std::abs(up - 1024 * ((value - lower) / place)) < 1.0 + 1e-3, "rounding has no bias");
    }
}

void rounding() {
    reals<4>();
    reals<3>();
    floats();
}

// --- Perception ------------------------------------------------------------------------------------------------------
void perception() {
    const pmc::InverseSquareTvi table;
    const auto exact = [](float L) { return 1.0 / (pmc::tvi(L) * pmc::tvi(L)); };
    const auto close = [&](float L, double most) {
        at = "at " + std::to_string(L) + " cd/m2";
        require(std::abs(table(L) / exact(L) - 1.0) < most, "the table is close to tvi");
    };
    // Within a step of the table, a 32nd of an octave.
    const auto near = [](double L, double exponent) { return std::abs(L / std::pow(10.0, exponent) - 1.0) < 1.0 / 32; };
    for (int k = 0; k <= 200'000; ++k) {
        const auto L = static_cast<float>(std::pow(10.0, -6.0 + 12.0 * k / 200'000));
        // Where two pieces of tvi do not meet, the table goes from one to the other in its own step; where they meet at an angle, it
        // cuts the corner.
        close(L, near(L, -1.44) || near(L, 1.9) ? 0.06 : near(L, -0.0184) ? 0.006 : 0.003);
    }
    for (const float L : {1e9f, 1e15f, 1e19f}) close(L, 0.003);
    const float darkness = static_cast<float>(exact(0.0f)), smallest = std::numeric_limits<float>::denorm_min();
    for (const float L : {0.0f, -0.0f, smallest, 1e-40f, FLT_MIN, 1e-20f, -smallest, -1.0f, -FLT_MAX, -std::numeric_limits<float>::infinity()}) {
        at = "at " + std::to_string(L) + " cd/m2";
        require(table(L) == darkness, "darkness has one threshold");
    }
    at = "tvi";
    for (const double L : {0.0, -1.0, 1e-310, 1e-4})
        require(std::abs(pmc::tvi(L) / std::pow(10.0, -2.86) - 1.0) < 1e-12, "darkness has the threshold 10^-2.86");
    require(pmc::tvi(std::numeric_limits<double>::infinity()) == std::numeric_limits<double>::infinity(), "infinity has an infinite threshold");
    require(std::isnan(pmc::tvi(std::numeric_limits<double>::quiet_NaN())), "NaN stays NaN");
    at = "at the end of floats";
    require(table(FLT_MAX) == 0.0f && table(std::numeric_limits<float>::infinity()) == 0.0f, "nothing is seen where the threshold is beyond floats");
}

}  // namespace

int main(int argc, char** argv) {
    const std::pair<std::string, void (*)()> parts[] = {
        {"pool", pool}, {"systematic", systematic}, {"parallel", parallel}, {"rounding", rounding}, {"perception", perception}};
    try {
        for (const auto& [name, part] : parts) {
            if (argc != 2 || name != argv[1]) continue;
            part();
            return 0;
        }
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
    return 2;
}

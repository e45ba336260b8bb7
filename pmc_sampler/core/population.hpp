// The population (paper, sections 4.1 and 4.3): members that move by a mixture of disk kernels, are culled where little is
// left to learn, and are regenerated elsewhere.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>
#include <numeric>
#include <vector>

#include "batch.hpp"
#include "config.hpp"
#include "memory.hpp"
#include "multiversion.hpp"
#include "parallel.hpp"
#include "random.hpp"
#include "tiling.hpp"

namespace pmc {

// Mean and squared deviations of a stream of luminances (Welford 1962, doi:10.1080/00401706.1962.10490022).
struct Running {
    float n, mean, m2;

    void add(float x) {
        n += 1.0f;
        const float d = x - mean;
        mean += d / n;
        m2 += d * (x - mean);
    }
    float variance() const { return n > 1.0f ? m2 / (n - 1.0f) : 0.0f; }
};

using Alpha = std::array<float, Config::max_kernels>;

struct Member {
    float x, y;
    Alpha alpha;
    std::uint32_t rounds;  // N_used: resampling rounds since it was regenerated
    Running all;
    Running kernel[Config::max_kernels];

    bool has_seen_enough() const {  // to tell kernels apart
        return std::any_of(std::begin(kernel), std::end(kernel), [](const Running& k) { return k.n >= 2.0f; });
    }
};

// Equation of section 4.3.3, normalised: alpha_k = floor / K + (1 - floor) (1/var_k) / sum(1/var), a kernel with no variance
// having no share. A kernel with fewer than two samples keeps what it had; with no variance anywhere all are alike.
inline Alpha adapted_alpha(const Member& member, std::uint32_t kernels, float floor) {
    Alpha alpha{};
    float known_before = 0.0f, total = 0.0f;
    for (std::uint32_t k = 0; k < kernels; ++k) {
        if (member.kernel[k].n < 2.0f) continue;
        known_before += member.alpha[k];
        const float variance = member.kernel[k].variance();
        if (variance > 0.0f) total += 1.0f / variance;
    }
    if (!(total > 0.0f) || !std::isfinite(total)) {
        std::fill_n(alpha.begin(), kernels, 1.0f / kernels);
        return alpha;
    }
    for (std::uint32_t k = 0; k < kernels; ++k) {
        if (member.kernel[k].n < 2.0f) {
            alpha[k] = member.alpha[k];
        } else {
            const float variance = member.kernel[k].variance();
            const float share = variance > 0.0f ? 1.0f / variance / total : 0.0f;
            alpha[k] = share * known_before;
        }
    }
    for (std::uint32_t k = 0; k < kernels; ++k) alpha[k] = floor / kernels + (1.0f - floor) * alpha[k];
    return alpha;
}

// Alpha as an image, one entry for 8x8 pixels: what the members that were there had learned (paper, section 7).
class AlphaMemory {
public:
    static constexpr std::uint32_t cell = 8;

    // rate: how far an entry moves to a member's. Where it is 0 members start from equal shares, and the image only shows what they learn.
    AlphaMemory(const Tiling& tiling, std::uint32_t kernels, double rate)
        : columns_((tiling.width + cell - 1) / cell), kernels_(kernels), rate_(rate > 0.0 ? static_cast<float>(rate) : 0.25f), starts_(rate > 0.0),
          cells_(std::size_t(columns_) * ((tiling.height + cell - 1) / cell)) {}

    Alpha at(std::uint32_t x, std::uint32_t y) const {
        const Alpha alpha = cells_[index(x, y)];
        return alpha[0] + alpha[1] + alpha[2] > 0.0f ? alpha : equal();
    }
    // What a member there starts from.
    Alpha start(std::uint32_t x, std::uint32_t y) const { return starts_ ? at(x, y) : equal(); }
    void fetch(const Member& member) const { __builtin_prefetch(&cells_[index(static_cast<std::uint32_t>(member.x), static_cast<std::uint32_t>(member.y))], 1); }
    void learn(const Member& member) {
        const auto x = static_cast<std::uint32_t>(member.x), y = static_cast<std::uint32_t>(member.y);
        Alpha alpha = at(x, y);
        for (std::uint32_t k = 0; k < kernels_; ++k) alpha[k] += rate_ * (member.alpha[k] - alpha[k]);
        cells_[index(x, y)] = alpha;
    }
    template <class Archive>
    void archive(Archive& a) {
        a.array("alpha.memory", cells_);
    }

private:
    std::size_t index(std::uint32_t x, std::uint32_t y) const { return std::size_t(y / cell) * columns_ + x / cell; }
    Alpha equal() const {
        Alpha alpha{};
        std::fill_n(alpha.begin(), kernels_, 1.0f / static_cast<float>(kernels_));
        return alpha;
    }
    std::uint32_t columns_, kernels_;
    float rate_;
    bool starts_;
    Zeroed<Alpha> cells_;
};

// A uniform point of the disk of radius r, by rejection from its square: cheaper than a sine and a cosine. Half a word makes
// each coordinate: steps of r / 32768.
inline Point2 in_disk(const Stream& stream, std::uint32_t counter, std::uint32_t slot, float r) {
    const auto attempt = [&](std::uint32_t number) {
        const std::uint32_t word = stream.word(counter, slot + number);
        return Point2{(static_cast<float>(word >> 16) + 0.5f) * 0x1p-15f - 1.0f, (static_cast<float>(word & 0xffffu) + 0.5f) * 0x1p-15f - 1.0f};
    };
    const auto inside = [](Point2 p) { return p.x * p.x + p.y * p.y <= 1.0f; };
    // A second attempt that is made in vain costs less than a branch that nobody can predict.
    const Point2 first = attempt(0), second = attempt(1);
    Point2 p = {inside(first) ? first.x : second.x, inside(first) ? first.y : second.y};
    for (std::uint32_t number = 2; !inside(p) && number < 32; ++number) p = attempt(number);
    if (!inside(p)) return {0.0f, 0.0f};  // once in 10^21
    return {p.x * r, p.y * r};
}

// The natural logarithm of a number above 0 that is not denormal, to 3e-7 of itself, for vectors: log m = 2 artanh((m - 1) / (m + 1)).
[[gnu::always_inline]] inline float logarithm(float x) {
    const auto bits = std::bit_cast<std::uint32_t>(x), root = std::bit_cast<std::uint32_t>(0.70710678f);
    const std::int32_t exponent = static_cast<std::int32_t>(bits - root) >> 23;
    const float m = std::bit_cast<float>(bits - (static_cast<std::uint32_t>(exponent) << 23));  // between the roots of 1/2 and of 2
    const float s = (m - 1.0f) / (m + 1.0f), z = s * s;
    return 2.0f * s * (1.0f + z * (1.0f / 3 + z * (1.0f / 5 + z * (1.0f / 7 + z / 9)))) + static_cast<float>(exponent) * 0.69314718f;
}

// -log(u) / w of each weight w, in its place; less is better. Without weight, after all others and at random.
PMC_MULTIVERSION inline void weights_to_keys(const Stream& stream, float* weights, std::size_t n) {
    constexpr float largest = std::numeric_limits<float>::max();
    for (std::size_t i = 0; i < n; ++i) {
        const auto word = static_cast<std::int32_t>(stream.word(static_cast<std::uint32_t>(i)) >> 9);
        const float u = (static_cast<float>(word) + 0.5f) * 0x1p-23f;  // below 1, so that log(u) is below 0
        const bool has_weight = weights[i] > 0.0f;
        const float key = -logarithm(u) / (has_weight ? weights[i] : 1.0f);
        weights[i] = has_weight && key < largest ? key : largest * (1.0f - 0.5f * u);
    }
}

// The value in place `rank`, from 0, of positive numbers in rising order. As integers they are in the same one: a histogram of their
// first bits leaves few of them, where a partition of all has a branch for each that nobody can predict.
inline float of_rank(const std::vector<float>& values, std::size_t rank, std::vector<float>& scratch) {
    constexpr int rest = 19;
    const auto bin_of = [](float value) { return std::bit_cast<std::uint32_t>(value) >> rest; };
    std::array<std::uint32_t, (0x7f800000u >> rest) + 1> bins{};
    for (const float value : values) ++bins[bin_of(value)];
    std::uint32_t bin = 0;
    for (; rank >= bins[bin]; ++bin) rank -= bins[bin];
    scratch.clear();
    std::copy_if(values.begin(), values.end(), std::back_inserter(scratch), [&](float value) { return bin_of(value) == bin; });
    const auto place = scratch.begin() + static_cast<std::ptrdiff_t>(rank);
    std::nth_element(scratch.begin(), place, scratch.end());
    return *place;
}

struct Population {
    std::vector<Member> members;
    std::uint64_t iteration = 0;

    // The members to replace, to `gone`: all but round((1 - eliminate) n) survivors, which are drawn without replacement in proportion to
    // w = var / N_used (section 4.3.1) by the keys of Efraimidis and Spirakis 2006 (doi:10.1016/j.ipl.2005.11.003); members
    // of weight 0 survive only where too few others are left.
    void eliminated(double share, const Stream& stream, std::vector<std::uint32_t>& gone) {
        const std::size_t n = members.size();
        const auto survivors = static_cast<std::size_t>(std::llround((1.0 - share) * static_cast<double>(n)));
        if (survivors == 0) {
            gone.resize(n);
            std::iota(gone.begin(), gone.end(), 0u);
            return;
        }
        gone.clear();
        if (survivors >= n) return;
        key_.resize(n);
        for (std::size_t i = 0; i < n; ++i) key_[i] = members[i].all.variance() / static_cast<float>(std::max(1u, members[i].rounds));
        weights_to_keys(stream, key_.data(), n);
        const float threshold = of_rank(key_, survivors - 1, scratch_);
        // Among equal keys the first members stay.
        auto ties = survivors - static_cast<std::size_t>(std::count_if(key_.begin(), key_.end(), [&](float k) { return k < threshold; }));
        gone.resize(n + 1);
        std::size_t count = 0;
        for (std::uint32_t i = 0; i < n; ++i) {
            gone[count] = i;  // overwritten by the next where this one stays: no branch that nobody can predict
            count += key_[i] > threshold;
            if (key_[i] == threshold) ties > 0 ? --ties : ++count;
        }
        gone.resize(count);
    }

    // Section 4.3.3 for n members, the i-th at which(i), of which no two are the same: for those that have seen enough.
    template <class Which>
    void adapt(std::size_t n, Which&& which, const Config& config, ThreadPool& threads) {
        const std::uint32_t kernels = config.kernels();
        threads.ranges(n, 256, [&](std::size_t first, std::size_t last) {
            for (std::size_t i = first; i < last; ++i) {
                Member& member = members[which(i)];
                if (member.has_seen_enough()) member.alpha = adapted_alpha(member, kernels, static_cast<float>(config.alpha_floor));
            }
        });
    }
    // The image remembers what they have; in their order, on which it depends.
    template <class Which>
    void remember(std::size_t n, Which&& which, AlphaMemory& memory) const {
        constexpr std::size_t ahead = 8;
        for (std::size_t i = 0; i < n; ++i) {
            memory.fetch(members[which(std::min(i + ahead, n - 1))]);
            const Member& member = members[which(i)];
            if (member.has_seen_enough()) memory.learn(member);
        }
    }

    void place(std::uint32_t i, float x, float y, const AlphaMemory& memory) {
        members[i] = Member{};
        members[i].x = x;
        members[i].y = y;
        members[i].alpha = memory.start(static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y));
    }

    // Section 4.1, Equation 4: T_R moves of each member, each from where the last one ended; slots[m * moves + t], tags alike.
    void move(const Config& config, const Tiling& tiling, const Stream& stream, std::uint32_t* slots, std::uint8_t* tags, ThreadPool& threads) {
        const std::uint32_t kernels = config.kernels(), moves = config.moves;
        float radius[Config::max_kernels] = {};
        for (std::uint32_t k = 0; k < kernels; ++k) radius[k] = static_cast<float>(config.radii[k]);
        threads.ranges(members.size(), 256, [&](std::size_t first, std::size_t last) {
            for (std::size_t m = first; m < last; ++m) {
                Member& member = members[m];
                for (std::uint32_t t = 0; t < moves; ++t) {
                    const auto counter = static_cast<std::uint32_t>(m);
                    const std::uint32_t draw = t * 64;  // words a move may use
                    const float u = stream.uniform(counter, draw);
                    std::uint32_t k = 0;
                    float below = 0.0f;
                    for (std::uint32_t next = 1; next < kernels; ++next) {
                        below += member.alpha[next - 1];
                        k += u >= below;
                    }
                    const Point2 step = in_disk(stream, counter, draw + 1, radius[k]);
                    member.x = reflect(member.x + step.x, static_cast<float>(tiling.width));
                    member.y = reflect(member.y + step.y, static_cast<float>(tiling.height));
                    slots[m * moves + t] = tiling.slot(static_cast<std::uint32_t>(member.x), static_cast<std::uint32_t>(member.y));
                    tags[m * moves + t] = static_cast<std::uint8_t>(k);
                }
            }
        });
    }

    // What a batch's samples say of the members that proposed it. luminance(i): that of the i-th, NaN where it is left out.
    template <class Luminance>
    void tell(const Batch& batch, Luminance&& luminance, std::uint32_t moves, ThreadPool& threads) {
        const std::size_t moved = members.size() * moves, proposals = batch.place.size();
        // Proposals lie all over the batch: what is needed `ahead` proposals on is fetched now.
        constexpr std::size_t ahead = 64;
        const auto fetch = [&](std::size_t proposal) {
            const std::uint32_t i = batch.place[std::min(proposal + ahead, proposals - 1)];
            luminance.fetch(i);
            __builtin_prefetch(&batch.tag[i]);
        };
        threads.ranges(batch.evaluated.size(), 512, [&](std::size_t first, std::size_t last) {
            for (std::size_t i = first; i < last; ++i) {
                fetch(moved + i);
                const float y = luminance(batch.place[moved + i]);
                if (y == y) members[batch.evaluated[i]].all.add(y);
            }
        });
        threads.ranges(members.size(), 256, [&](std::size_t first, std::size_t last) {
            for (std::size_t m = first; m < last; ++m) {
                Member& member = members[m];
                for (std::size_t proposal = m * moves; proposal < (m + 1) * moves; ++proposal) {
                    fetch(proposal);
                    const std::uint32_t i = batch.place[proposal];
                    const float y = luminance(i);
                    if (y != y) continue;
                    member.all.add(y);
                    member.kernel[batch.tag[i] & Tag::kernel_mask].add(y);
                }
                ++member.rounds;
            }
        });
    }

    template <class Archive>
    void archive(Archive& a, const std::string& name) {
        a.vector(name + ".members", members);
        a.value(name + ".iteration", iteration);
    }

private:
    std::vector<float> key_, scratch_;  // memory that is taken anew costs more than what is done with it
};

}  // namespace pmc

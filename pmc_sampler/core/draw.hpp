// How a batch is drawn; the second half of Sampler.
#pragma once

#include "sampler.hpp"

namespace pmc {

// The random streams of a batch.
namespace stream {
enum : std::uint32_t { eliminate = 16, place, move, offset };
}

inline std::uint64_t Sampler::batch_size() const {
    if (config.batch) return config.batch;
    // Batches of an eighth of a sample a pixel steer sooner than those of one; where nothing steers, larger ones cost less.
    // A small image takes several samples a pixel at once: below a few thousand the cost of a batch is its overhead.
    const bool steers = !config.is_uniform() && issued_ >= initial_;
    return std::max<std::uint64_t>(film_.tiling.pixels() / (steers ? 8 : 1), 4096);
}

// As many, or up to a sample a pixel where that tells no less: where the draws are spread so thinly that the pixels which they go to
// would on average have no tenth more samples than they have.
inline std::uint64_t Sampler::batch_size(const SystematicDraw& beta) const {
    constexpr double growth = 0.1;
    const std::uint64_t least = batch_size(), pixels = film_.tiling.pixels();
    if (config.batch || pixels <= least) return least;
    const double most = static_cast<double>(pixels) * beta.growth();
    return most <= growth ? pixels : std::max(least, static_cast<std::uint64_t>(growth / beta.growth()));
}

// Draws the next batch and queues it; false where the budget is spent.
inline bool Sampler::prepare() {
    const std::uint64_t left = total_ - issued_;
    if (left == 0) return false;
    const UsualArithmetic usual;
    auto batch = batches_.take();
    batch->number = drawn_batches_;
    batch->owner = id_;
    pool_slots_.clear();
    pool_passes_.clear();
    proposals_.direct.resize(0);
    if (issued_ < initial_ || config.is_uniform()) {
        const std::uint64_t room = config.is_uniform() ? left : initial_ - issued_;
        fill(*batch, std::min({left, room, batch_size()}));
    } else {
        film_.part(threads_);
        if (reserved() == ~0u) reserve(pool_passes(affordable_spp()));
        const auto passes = static_cast<float>(static_cast<double>(pool_.cursor()) / static_cast<double>(film_.tiling.slots()));
        if (config.is_unbiased())
            draw_unbiased(*batch, std::min(left, batch_size()), passes);
        else
            draw_adaptive(*batch, left, passes);
    }
    arranger_(proposals_, film_, *batch, threads_);
    issued_ += batch->size();
    ++drawn_batches_;
    prepared_.push_back(std::move(batch));
    return true;
}

// Of the samples that are not the pool's each colour gets its share, whatever was seen; see Film::guide().
inline void Sampler::draw_unbiased(Batch& batch, std::uint64_t size, float passes) {
    const std::uint64_t pixels = film_.tiling.pixels();
    const std::uint64_t direct = size - pool_share_of(size);
    const std::uint64_t counts[2] = {direct - direct * (pixels / 2) / pixels, direct * (pixels / 2) / pixels};
    film_.guide(threads_);
    drawn_slots_.resize(direct);
    for (std::uint32_t colour = 0; colour < 2; ++colour) {
        if (!counts[colour]) continue;
        film_.select(colour);
        const float offset = Stream(seed, stream::offset, batch.number).uniform(colour);
        SystematicDraw(film_, passes, threads_)(counts[colour], offset, drawn_slots_.data() + colour * counts[0], nullptr, threads_, [] {});
    }
    fill(batch, size, drawn_slots_.span());
}

inline void Sampler::draw_adaptive(Batch& batch, std::uint64_t left, float passes) {
    const double own_share = (1.0 - config.pool_share) * (1.0 - config.direct_share);
    const auto share_of = [](double share, std::uint64_t n) { return static_cast<std::uint64_t>(std::llround(share * static_cast<double>(n))); };
    replaced_.clear();
    const SystematicDraw beta(film_, passes, threads_, [&] {
        if (own_share > 0.0) resample(batch, share_of(own_share, batch_size()));
    });
    std::uint64_t size = std::min(left, batch_size(beta));
    if (own_share > 0.0) {
        adapt(batch);
        const std::uint64_t own = population_of(batch.number).members.size() * config.moves + batch.evaluated.size();
        // A population whose members neither move nor are replaced this time leaves the batch to beta and the pool.
        if (config.population && own) size = std::min(left, static_cast<std::uint64_t>(std::llround(static_cast<double>(own) / own_share)));
        // The end of the budget may cut an iteration short: then every so many of its proposals are left out.
        batch.iteration_samples = config.population && size < left ? own : std::min(own, share_of(own_share, size));
    }
    const bool known = beta.total() > 0.0;
    const std::uint64_t pool = std::min(pool_share_of(size), size - batch.iteration_samples);
    const std::uint64_t direct = known ? size - batch.iteration_samples - pool : 0;
    const std::uint64_t members = known ? replaced_.size() - share_of(config.regenerate_pool, replaced_.size()) : 0;
    const auto remember = [&] { population_of(batch.number).remember(replaced_.size(), [&](std::size_t i) { return replaced_[i]; }, memory_); };
    const Stream offset(seed, stream::offset, batch.number);
    proposals_.direct.resize(direct);
    if (direct) {
        proposals_.direct_starts.resize(film_.tiling.tiles() + 1);
        beta(direct, offset.uniform(0), proposals_.direct.data(), proposals_.direct_starts.data(), threads_, remember);
    } else {
        remember();
    }
    // Members are put where samples go, evenly spaced among these from anywhere on; a draw of their own is worth it where they are more.
    member_slots_.resize(members);
    if (members > direct)
        beta(members, offset.uniform(1), member_slots_.data(), nullptr, threads_, [] {});
    else
        for (std::size_t i = 0, first = direct * std::uint64_t(offset.word(1)) >> 32; i < members; ++i) member_slots_[i] = proposals_.direct[(i * direct + first) / members];
    regenerate(batch);
    fill(batch, size - direct);
}

// Resampling of the population whose turn it is (paper, Figure 2): the members to replace, and in batch.evaluated those of them that
// are evaluated where they are put.
inline void Sampler::resample(Batch& batch, std::uint64_t room) {
    Population& population = population_of(batch.number);
    double evaluated_share = config.evaluate_regenerated ? 1.0 : 0.0;
    if (population.members.empty()) {
        const double per_member = config.moves + (config.evaluate_regenerated ? config.eliminate : 0.0);
        const std::uint64_t n = config.population ? config.population : static_cast<std::uint64_t>(static_cast<double>(room) / std::max(per_member, 1e-9));
        population.members.resize(std::min<std::uint64_t>(n, film_.tiling.pixels()));
        replaced_.resize(population.members.size());
        std::iota(replaced_.begin(), replaced_.end(), 0u);
        // A first iteration regenerates all; where the population was sized to fill the batch, no more are evaluated than later.
        if (!config.population) evaluated_share *= config.eliminate;
    } else {
        population.eliminated(config.eliminate, Stream(seed, stream::eliminate, batch.number), replaced_);
    }
    if (evaluated_share >= 1.0) {
        batch.evaluated = replaced_;
    } else if (evaluated_share > 0.0) {
        for (std::size_t i = 0; i < replaced_.size(); ++i)
            if (std::floor(static_cast<double>(i + 1) * evaluated_share) > std::floor(static_cast<double>(i) * evaluated_share))
                batch.evaluated.push_back(replaced_[i]);
    }
}

// What the members have learned of the kernels: of all now and then, and of those that are replaced, which is yet to be remembered.
inline void Sampler::adapt(const Batch& batch) {
    Population& population = population_of(batch.number);
    if (population.iteration++ % config.adapt_alpha_every == 0) {
        const auto each = [](std::size_t i) { return i; };
        population.adapt(population.members.size(), each, config, threads_);
        population.remember(population.members.size(), each, memory_);
    }
    population.adapt(replaced_.size(), [&](std::size_t i) { return replaced_[i]; }, config, threads_);
}

// Puts the replaced members at the pixels that beta gave (member_slots_), the rest of them where the pool says.
inline void Sampler::regenerate(const Batch& batch) {
    Population& population = population_of(batch.number);
    const std::size_t n = replaced_.size(), by_beta = member_slots_.size();
    if (batch.evaluated.size() == n) {  // where all are evaluated, those that the pool places are samples of its stream
        pool_.take(n - by_beta, [&](std::uint32_t slot, std::uint32_t pass) {
            pool_slots_.push_back(slot);
            pool_passes_.push_back(pass);
        });
        member_slots_.insert(member_slots_.end(), pool_slots_.begin(), pool_slots_.end());
    } else {
        placement_.take(n - by_beta, [&](std::uint32_t slot, std::uint32_t) { member_slots_.push_back(slot); });
    }
    const Stream place(seed, stream::place, batch.number);
    const auto jitter = static_cast<float>(config.regenerate_jitter);
    const float width = static_cast<float>(film_.tiling.width), height = static_cast<float>(film_.tiling.height);
    threads_.ranges(n, 256, [&](std::size_t first, std::size_t last) {
        for (std::size_t i = first; i < last; ++i) {
            const auto counter = static_cast<std::uint32_t>(i);
            float x = in_pixel(static_cast<float>(film_.tiling.x(member_slots_[i])), place.uniform(counter, 0));
            float y = in_pixel(static_cast<float>(film_.tiling.y(member_slots_[i])), place.uniform(counter, 1));
            if (jitter > 0.0f && i < by_beta) {
                x += jitter * (2.0f * place.uniform(counter, 2) - 1.0f);
                y += jitter * (2.0f * place.uniform(counter, 3) - 1.0f);
            }
            population.place(replaced_[i], reflect(x, width), reflect(y, height), memory_);
        }
    });
}

// Lays out `size` proposals of a batch: those that are given or the population's (batch.iteration_samples of them: moves, then
// regenerated members, those of the pool last), and the pool's for the rest. Where some are given there is no population.
inline void Sampler::fill(Batch& batch, std::uint64_t size, std::span<const std::uint32_t> given) {
    Population& population = population_of(batch.number);
    const std::size_t own = batch.iteration_samples;
    const std::size_t moved = own ? population.members.size() * config.moves : 0;
    const std::size_t placed = own ? batch.evaluated.size() : 0, in_pool = own ? pool_slots_.size() : 0;
    const std::size_t most = given.size() + moved + placed - in_pool + pool_slots_.size();
    proposals_.slot.resize(most);
    proposals_.tag.resize(most);
    std::uint32_t* slot = proposals_.slot.data();
    std::uint8_t* tag = proposals_.tag.data();
    std::copy(given.begin(), given.end(), slot);
    std::fill_n(tag, given.size(), Tag::no_kernel);
    // Regenerated members are evaluated where they are now, before they move.
    std::size_t next = given.size() + moved;
    threads_.ranges(placed - in_pool, 256, [&](std::size_t first, std::size_t last) {
        for (std::size_t i = first; i < last; ++i) {
            const Member& member = population.members[batch.evaluated[i]];
            slot[next + i] = film_.tiling.slot(static_cast<std::uint32_t>(member.x), static_cast<std::uint32_t>(member.y));
            tag[next + i] = Tag::no_kernel;
        }
    });
    next += placed - in_pool;
    if (moved) population.move(config, film_.tiling, Stream(seed, stream::move, batch.number), slot, tag, threads_);
    if (own < moved + placed) {
        // Cut short by the end of the budget: keep evenly spaced proposals; the members learn nothing from this one.
        const std::size_t keep = own - std::min(own, in_pool), from = next;
        for (std::size_t i = 0; i < keep; ++i) {
            const std::size_t source = i * from / std::max<std::size_t>(keep, 1);
            slot[i] = slot[source];
            tag[i] = tag[source];
        }
        next = keep;
        batch.iteration_samples = 0;
        batch.evaluated.clear();
    }
    const std::size_t taken = std::min<std::size_t>(size - next, pool_slots_.size());
    proposals_.slot.resize(next + taken);
    proposals_.tag.resize(next + taken);
    proposals_.pass.resize(taken);
    std::copy_n(pool_slots_.begin(), taken, slot + next);
    std::copy_n(pool_passes_.begin(), taken, proposals_.pass.data());
    std::fill_n(tag + next, taken, static_cast<std::uint8_t>(Tag::pool | Tag::no_kernel));
    proposals_.pool = &pool_.take(size - next - taken);
}

}  // namespace pmc

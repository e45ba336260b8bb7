// The sampler: ask for positions, tell their radiance, read the film. State changes here and nowhere else.
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "archive.hpp"
#include "arrange.hpp"
#include "batch.hpp"
#include "config.hpp"
#include "film.hpp"
#include "parallel.hpp"
#include "pool.hpp"
#include "population.hpp"
#include "systematic.hpp"
#include "visible_noise.hpp"

namespace pmc {

enum class Done : std::uint8_t { no, spp, seconds, visible_noise };

class Sampler {
public:
    // aovs: channels after RGB that are averaged along. threads: how many, or whose; the image does not depend on it.
    // is_signed: radiance may be negative.
    Sampler(std::uint32_t width, std::uint32_t height, const Budget& budget, const Config& settings = {}, std::uint64_t seed = 0,
            std::uint32_t aovs = 0, Threads threads = {}, bool is_signed = false)
        : config(settings.resolved(width, height)), budget(checked(budget)), seed(seed), threads_(std::move(threads)),
          film_(width, height, config, aovs, is_signed), pool_(film_.tiling, key(seed)), placement_(film_.tiling, hash32(key(seed))),
          memory_(film_.tiling, config.kernels(), config.alpha_memory), arranger_(film_.tiling, Sequences(key(seed)), config.filter, config.filter_radius),
          populations_(std::size_t(config.lookahead) + 1), id_(next_id().fetch_add(1)) {
        if (config.is_unbiased() && budget.visible_noise >= 0.0)
            throw std::invalid_argument("a budget of visible noise ends by what was seen, so that the image could not be unbiased: "
                                        "give the unbiased estimator spp or seconds");
        const double pixels = static_cast<double>(film_.tiling.pixels());
        total_ = budget.spp == Budget::none ? unlimited : static_cast<std::uint64_t>(std::max(1.0, std::round(budget.spp * pixels)));
        initial_ = static_cast<std::uint64_t>(std::min(std::round(initial_spp() * pixels), static_cast<double>(total_)));
        if (budget.spp != Budget::none && !config.is_uniform()) {
            const double initial = initial_spp(), whole = std::round(pool_passes(budget.spp));
            // Members that the pool places would come on top of its share.
            if (config.regenerate_pool == 0.0 && whole > initial) pool_share_ = (whole - initial) / (budget.spp - initial);
            reserve(whole);
        }
    }
    Sampler(const Sampler&) = delete;
    Sampler& operator=(const Sampler&) = delete;

    const Config config;
    const Budget budget;
    const std::uint64_t seed;

    // The next batch. Up to config.lookahead others, from the first that is not told on, may be drawn; asking beyond that, or for
    // more than the budget, throws.
    std::shared_ptr<const Batch> ask() {
        start_clock();
        if (done_ == Done::visible_noise) throw std::logic_error("ask: the visible noise is within its budget; read the film");
        // Batches told out of turn wait for the one that is due, and so must this one, which may not be drawn without it.
        if (prepared_.empty() && drawn_batches_ > told_ + config.lookahead)
            throw std::logic_error("ask: " + counted(open_.size()) + " open" +
                                   (waiting_.empty() ? "" : ", " + std::to_string(waiting_.size()) + " told out of turn wait for the first of them,") +
                                   " and lookahead is " + std::to_string(config.lookahead) + ": tell or drop batch " + std::to_string(told_) + " first");
        if (prepared_.empty()) {
            const ThreadPool::Awake awake(threads_);
            prepare();
        }
        if (prepared_.empty())
            throw std::logic_error(open_.empty() && waiting_.empty() ? "ask: the budget is spent; read the film, or make a sampler with a larger budget"
                                                 : "ask: all samples of the budget are drawn and " + counted(open_.size()) + " open: tell or drop what is open");
        auto batch = prepared_.front();
        prepared_.pop_front();
        open_[batch->number] = batch;
        return batch;
    }

    // Radiance of a batch, 3 + aovs floats a sample in the batch's order. Throws, leaving everything as it was, where the batch is
    // not open here, the size is wrong, or more than half of the samples are not finite or negative. Of a batch of a few samples,
    // such as the rest of a budget, that may be chance: it is refused where so are more than half of all samples until then.
    void tell(const Batch& batch, std::span<const float> radiance) {
        const auto open = find_open(batch);
        const std::size_t channels = 3 + film_.aovs, expected = batch.size() * channels;
        if (radiance.size() != expected)
            throw std::invalid_argument("tell: got " + std::to_string(radiance.size()) + " values for batch " + std::to_string(batch.number) + ", expected " +
                                        std::to_string(batch.size()) + " samples of " + std::to_string(channels) + " channels");
        const ThreadPool::Awake awake(threads_);
        const bool clean = check_mostly_valid(batch, radiance);
        const auto kept = open->second;
        open_.erase(open);
        if (done_ == Done::visible_noise) return;  // what comes after must not depend on how many were open
        if (kept->number == told_)
            incorporate(*kept, radiance.data(), clean);
        else
            waiting_[kept->number] = {kept, std::vector<float>(radiance.begin(), radiance.end()), clean};
        catch_up();
    }

    // Gives a batch up: its samples are drawn again later, at other positions.
    void drop(const Batch& batch) {
        const auto open = find_open(batch);
        const auto kept = open->second;
        open_.erase(open);
        if (done_ == Done::visible_noise) return;
        const ThreadPool::Awake awake(threads_);
        if (kept->number == told_)
            incorporate(*kept, nullptr, false);
        else
            waiting_[kept->number] = {kept, std::nullopt, false};
        catch_up();
    }

    bool is_open(const Batch& batch) const {
        const auto open = open_.find(batch.number);
        return batch.owner == id_ && open != open_.end() && open->second.get() == &batch;
    }

    // Closes a batch without an answer, to be asked again next: the same samples, as if it had not been asked.
    void put_back(const Batch& batch) {
        const auto open = find_open(batch);
        const auto after = std::find_if(prepared_.begin(), prepared_.end(), [&](const auto& b) { return b->number > batch.number; });
        prepared_.insert(after, open->second);
        open_.erase(open);
    }

    // Why sampling is over, once it is.
    Done done() {
        if (done_ == Done::no && film_.samples + rejected_ >= total_) done_ = Done::spp;
        if (done_ == Done::no && told_ > 0 && elapsed() >= budget.seconds) done_ = Done::seconds;  // one batch at least
        return done_;
    }

    // Seconds that count as elapsed though nothing was asked in them, such as the renderer's set-up.
    void add_elapsed(double seconds) { elapsed_before_ += seconds; }

    const Film& film() const { return film_; }
    const AlphaMemory& alpha() const { return memory_; }
    ThreadPool& threads() { return threads_; }
    std::uint64_t samples() const { return film_.samples; }
    std::uint64_t rejected() const { return rejected_; }
    std::uint64_t total() const { return total_; }
    static constexpr std::uint64_t unlimited = ~0ull;
    // Seconds since the first ask, those before a restored checkpoint and those of add_elapsed included.
    double elapsed() const {
        return elapsed_before_ + (started_ ? std::chrono::duration<double>(Clock::now() - *started_).count() : 0.0);
    }

    // Passes of the pool that are reserved in the pixels' sequences: all that it makes in a budget of samples. Without one that
    // is decided when steering begins, by how far the time will go at the pace until then; until it is, all are.
    std::uint32_t reserved() const { return arranger_.reserved(); }

    template <class Archive>
    void archive(Archive& a);

private:
    using Clock = std::chrono::steady_clock;
    struct Waiting {
        std::shared_ptr<const Batch> batch;
        std::optional<std::vector<float>> radiance;  // none: dropped
        bool clean = false;                          // all of it is known to be valid
    };

    static const Budget& checked(const Budget& budget) {
        budget.check();
        return budget;
    }
    static std::uint32_t key(std::uint64_t seed) { return mix(static_cast<std::uint32_t>(seed), static_cast<std::uint32_t>(seed >> 32)); }
    static std::atomic<std::uint64_t>& next_id() {
        static std::atomic<std::uint64_t> counter{1};
        return counter;
    }
    static std::string counted(std::size_t batches) { return batches == 1 ? "1 batch is" : std::to_string(batches) + " batches are"; }
    void start_clock() {
        if (!started_) started_ = Clock::now();
    }

    std::map<std::uint64_t, std::shared_ptr<const Batch>>::iterator find_open(const Batch& batch) {
        if (batch.owner != id_) throw std::invalid_argument("batch " + std::to_string(batch.number) + " was drawn by another sampler");
        const auto open = open_.find(batch.number);
        if (open == open_.end() || open->second.get() != &batch)
            throw std::invalid_argument("batch " + std::to_string(batch.number) + " is not open: it was told or dropped already");
        return open;
    }

    // Whether all samples are valid; throws where most are not.
    bool check_mostly_valid(const Batch& batch, std::span<const float> radiance) {
        const std::size_t invalid = film_.invalid(radiance.data(), batch.size(), threads_);
        constexpr std::size_t few = 64;
        const std::uint64_t told = film_.samples + rejected_;
        if (2 * invalid > batch.size() && (batch.size() >= few || 2 * (rejected_ + invalid) > told + batch.size()))
            throw std::invalid_argument("tell: " + std::to_string(invalid) + " of " + std::to_string(batch.size()) + " samples of batch " +
                                        std::to_string(batch.number) +
                                        (film_.is_signed ? " are NaN or infinite" : " are NaN, infinite or negative") + "; expected linear radiance: mend the renderer, or drop the batch");
        return invalid == 0;
    }

    // Everything that is in turn. Batch k is drawn from what batches up to k - 1 - lookahead told: before the next is taken in,
    // the batches that must not know of it are drawn.
    void incorporate(const Batch& batch, const float* radiance, bool clean) {
        while (drawn_batches_ < told_ + config.lookahead + 1 && prepare()) {
        }
        ++told_;
        if (radiance) {
            rejected_ += film_.add(batch, radiance, clean, threads_);
            if (batch.iteration_samples > 0) population_of(batch.number).tell(batch, film_.luminance_of(radiance), config.moves, threads_);
        } else {
            issued_ -= batch.size();
        }
        if (!first_told_) first_told_ = {film_.samples, elapsed()};
        if (!config.is_uniform() && config.adapt_beta_every > 1 && told_ % config.adapt_beta_every == 0) film_.adapt_beta(threads_);
        if (done_ == Done::no && budget.visible_noise >= 0.0 && film_.samples + rejected_ >= initial_ && pmc::visible_noise(film_, threads_) <= budget.visible_noise)
            done_ = Done::visible_noise;
        if (done() != Done::no) batches_.end();
    }

    void catch_up() {
        for (auto next = waiting_.find(told_); next != waiting_.end() && done_ != Done::visible_noise; next = waiting_.find(told_)) {
            const Waiting ready = std::move(next->second);
            waiting_.erase(next);
            incorporate(*ready.batch, ready.radiance ? ready.radiance->data() : nullptr, ready.clean);
        }
    }

    // Passes that the pool makes in so many samples a pixel, by the settings.
    double pool_passes(double spp) const {
        const double initial = initial_spp(), placed = config.evaluate_regenerated ? config.eliminate : 0.0;
        const double own = (1.0 - config.pool_share) * (1.0 - config.direct_share) * placed / std::max(config.moves + placed, 1e-9);
        return spp <= initial ? spp : initial + (config.pool_share + own * config.regenerate_pool) * (spp - initial);
    }
    void reserve(double passes) { arranger_.reserve(static_cast<std::uint32_t>(std::clamp(std::round(passes), 1.0, 1e9))); }
    // Of the next `size` samples of a batch that adapts, how many are the pool's: in all, its share of what came after the first.
    std::uint64_t pool_share_of(std::uint64_t size) const {
        const auto until = [&](std::uint64_t samples) { return std::llround(pool_share_ * static_cast<double>(samples - std::min(samples, initial_))); };
        return static_cast<std::uint64_t>(until(issued_ + size) - until(issued_));
    }
    // Samples a pixel that the budget's seconds suffice for, by the samples after the first batch: to that a renderer may add
    // what it does once, such as compiling.
    double affordable_spp() const {
        constexpr double without_limit = 256.0;  // a guess
        if (!std::isfinite(budget.seconds) || !first_told_) return without_limit;
        const bool later = film_.samples > first_told_->samples;
        const double samples = static_cast<double>(film_.samples - (later ? first_told_->samples : 0)), seconds = elapsed() - (later ? first_told_->elapsed : 0.0);
        const double to_come = std::max(budget.seconds - elapsed(), 0.0) * samples / std::max(seconds, 1e-9);
        return (static_cast<double>(film_.samples) + to_come) / static_cast<double>(film_.tiling.pixels());
    }
    double initial_spp() const {
        if (config.initial_spp != Config::automatic) return config.initial_spp;
        return budget.spp == Budget::none ? 4.0 : std::clamp(std::round(budget.spp / 16.0), 4.0, 16.0);
    }
    Population& population_of(std::uint64_t batch) { return populations_[batch % populations_.size()]; }

    bool prepare();
    std::uint64_t batch_size() const;
    std::uint64_t batch_size(const SystematicDraw& beta) const;
    void draw_unbiased(Batch& batch, std::uint64_t size, float passes);
    void draw_adaptive(Batch& batch, std::uint64_t left, float passes);
    void resample(Batch& batch, std::uint64_t room);
    void adapt(const Batch& batch);
    void regenerate(const Batch& batch);
    void fill(Batch& batch, std::uint64_t size, std::span<const std::uint32_t> given = {});

    ThreadPool threads_;
    Film film_;
    Pool pool_, placement_;  // placement_ gives places alone: a pass of pool_ that is not evaluated would leave gaps in its sequence
    AlphaMemory memory_;
    Arranger arranger_;
    std::vector<Population> populations_;  // batch k moves the (k mod (lookahead + 1))-th: the last batch of that one is told

    Batches batches_;

    std::uint64_t id_, total_ = 0, initial_ = 0;
    // config.pool_share, or what is near it and lets the pool end with a whole pass: a pixel that lacks the last one, or has one
    // beyond the reserve, has a gap in its sequence (Sequences).
    double pool_share_ = config.pool_share;
    std::uint64_t issued_ = 0;  // samples drawn, less those of dropped batches
    std::uint64_t drawn_batches_ = 0, told_ = 0, rejected_ = 0;
    std::deque<std::shared_ptr<const Batch>> prepared_;
    std::map<std::uint64_t, std::shared_ptr<const Batch>> open_;
    std::map<std::uint64_t, Waiting> waiting_;  // told out of order
    Done done_ = Done::no;
    std::optional<Clock::time_point> started_;
    double elapsed_before_ = 0.0;
    struct Progress {
        std::uint64_t samples;
        double elapsed;
    };
    std::optional<Progress> first_told_;  // what there was after the first batch that was told here

    // Scratch of one draw and one tell.
    Proposals proposals_;
    std::vector<std::uint32_t> pool_slots_, pool_passes_, member_slots_, replaced_;
    Buffer<std::uint32_t> drawn_slots_;
};

}  // namespace pmc

#include "draw.hpp"
#include "checkpoint.hpp"

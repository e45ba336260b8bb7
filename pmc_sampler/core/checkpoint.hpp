// What a sampler saves and restores: everything that the batches to come depend on, open batches included.
#pragma once

#include "sampler.hpp"

namespace pmc {

template <class Archive>
void archive_batch(Archive& a, Batch& batch, const std::string& name) {
    a.value(name + ".number", batch.number);
    a.buffer(name + ".positions", batch.positions);
    a.buffer(name + ".pixel", batch.pixel);
    a.buffer(name + ".index", batch.index);
    a.buffer(name + ".scramble", batch.scramble);
    a.buffer(name + ".slot", batch.slot);
    a.buffer(name + ".tag", batch.tag);
    a.buffer(name + ".place", batch.place);
    a.vector(name + ".evaluated", batch.evaluated);
    a.value(name + ".iteration_samples", batch.iteration_samples);
}

// A block that is whole but not ours must not make the sampler write outside its arrays.
inline void check_batch(const Batch& b, const Film& film, const Population& population, std::uint32_t moves) {
    const std::size_t n = b.pixel.size();
    bool ok = b.positions.size() == n && b.index.size() == n && b.scramble.size() == n && b.slot.size() == n && b.tag.size() == n &&
              b.place.size() == b.iteration_samples &&
              (b.iteration_samples == 0 || b.iteration_samples == population.members.size() * moves + b.evaluated.size());
    for (std::size_t i = 0; ok && i < n; ++i)
        ok = b.slot[i] < film.sums.size() && b.tag[i] < 8 && (i == 0 || b.slot[i] / Tiling::area >= b.slot[i - 1] / Tiling::area);
    for (std::size_t i = 0; ok && i < b.place.size(); ++i) ok = b.place[i] < n && (i >= population.members.size() * moves || (b.tag[b.place[i]] & 3) < 3);
    for (std::size_t i = 0; ok && i < b.evaluated.size(); ++i) ok = b.evaluated[i] < population.members.size();
    if (!ok) throw std::runtime_error("the checkpoint's batch " + std::to_string(b.number) + " is damaged");
}

template <class Archive>
void Sampler::archive(Archive& a) {
    film_.archive(a);
    memory_.archive(a);
    for (std::size_t i = 0; i < populations_.size(); ++i) populations_[i].archive(a, "population" + std::to_string(i));
    std::uint64_t cursor = pool_.cursor(), placement = placement_.cursor();
    a.value("pool.cursor", cursor);
    a.value("placement.cursor", placement);
    std::uint32_t reserve = reserved();
    a.value("sampler.reserved", reserve);
    a.value("sampler.issued", issued_);
    a.value("sampler.drawn_batches", drawn_batches_);
    a.value("sampler.told", told_);
    a.value("sampler.rejected", rejected_);
    a.value("sampler.done", done_);
    double seconds = elapsed();
    a.value("sampler.seconds", seconds);

    // Batches that are drawn and not told come back to be asked again, in order; those told out of turn keep their radiance.
    std::map<std::uint64_t, std::shared_ptr<const Batch>> untold = open_;
    for (const auto& batch : prepared_) untold[batch->number] = batch;
    std::uint64_t n_untold = untold.size(), n_waiting = waiting_.size();
    a.value("batches.untold", n_untold);
    a.value("batches.waiting", n_waiting);
    if constexpr (Archive::reading) {
        if (n_untold + n_waiting > 2 * (std::uint64_t(config.lookahead) + 1)) throw std::runtime_error("the checkpoint's number of open batches is damaged");
        if (issued_ > total_ || told_ > drawn_batches_ || drawn_batches_ - told_ > 2 * (std::uint64_t(config.lookahead) + 1) ||
            n_untold + n_waiting != drawn_batches_ - told_ || done_ > Done::visible_noise)
            throw std::runtime_error("the checkpoint's counts of batches and samples, and what ended it, contradict each other: it is damaged");
        pool_.set_cursor(cursor);
        placement_.set_cursor(placement);
        arranger_.reserve(reserve);
        elapsed_before_ = seconds;
        started_.reset();
        open_.clear();
        prepared_.clear();
        waiting_.clear();
        for (Population& population : populations_)
            for (const Member& m : population.members)
                if (!(m.x >= 0.0f && m.x < static_cast<float>(film_.tiling.width) && m.y >= 0.0f && m.y < static_cast<float>(film_.tiling.height)))
                    throw std::runtime_error("the checkpoint's population is damaged: a member lies outside the image");
        const auto read = [&](const std::string& name) {
            auto batch = std::make_shared<Batch>();
            archive_batch(a, *batch, name);
            batch->owner = id_;
            if (batch->number < told_ || batch->number >= drawn_batches_) throw std::runtime_error("the checkpoint's batch numbers are damaged");
            check_batch(*batch, film_, population_of(batch->number), config.moves);
            return batch;
        };
        for (std::uint64_t i = 0; i < n_untold; ++i) prepared_.push_back(read("untold" + std::to_string(i)));
        for (std::uint64_t i = 0; i < n_waiting; ++i) {
            const std::string name = "waiting" + std::to_string(i);
            auto batch = read(name);
            std::vector<float> radiance;
            a.vector(name + ".radiance", radiance);
            if (!radiance.empty() && radiance.size() != batch->size() * (3 + film_.aovs))
                throw std::runtime_error("the checkpoint's radiance of batch " + std::to_string(batch->number) + " is damaged");
            waiting_[batch->number] = {batch, radiance.empty() ? std::nullopt : std::optional(std::move(radiance))};
        }
    } else {
        std::uint64_t i = 0;
        for (auto& [number, batch] : untold) archive_batch(a, const_cast<Batch&>(*batch), "untold" + std::to_string(i++));
        i = 0;
        for (auto& [number, waiting] : waiting_) {
            const std::string name = "waiting" + std::to_string(i++);
            archive_batch(a, const_cast<Batch&>(*waiting.batch), name);
            a.vector(name + ".radiance", waiting.radiance ? *waiting.radiance : std::vector<float>());
        }
    }
}

}  // namespace pmc

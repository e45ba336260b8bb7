// The one file that knows Python. Arrays cross without a copy: a batch's are views that keep it alive.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/variant.h>
#include <nanobind/stl/vector.h>

#include <mutex>
#include <type_traits>
#include <variant>

#include "nanothread.hpp"
#include "pmc.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Image = nb::ndarray<nb::numpy, float>;

// The sampler with a lock: Python threads may ask, tell and look at the film at once.
class Sampler : public pmc::Sampler {
public:
    using pmc::Sampler::Sampler;

    // work() alone, without the interpreter's lock.
    template <class Work>
    auto alone(Work&& work) {
        nb::gil_scoped_release release;
        const std::lock_guard lock(mutex_);
        return work();
    }

private:
    std::mutex mutex_;
};

template <class T>
auto view(const std::shared_ptr<const pmc::Batch>& batch, const T* data, std::size_t columns = 1) {
    auto* owner = new std::shared_ptr<const pmc::Batch>(batch);
    nb::capsule capsule(owner, [](void* p) noexcept { delete static_cast<std::shared_ptr<const pmc::Batch>*>(p); });
    const std::size_t shape[2] = {batch->size(), columns};
    return nb::ndarray<nb::numpy, const T>(data, columns == 1 ? 1 : 2, shape, capsule);
}

template <class T = float, class Fill>
nb::ndarray<nb::numpy, T> image(Sampler& sampler, std::size_t channels, Fill&& fill, bool flat = true) {
    const pmc::Film& film = sampler.film();
    const std::size_t shape[3] = {film.tiling.height, film.tiling.width, channels};
    auto* data = new T[film.tiling.pixels() * channels + 1];
    nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<T*>(p); });
    sampler.alone([&] { fill(film, data); });
    return {data, channels == 1 && flat ? std::size_t(2) : std::size_t(3), shape, owner};
}

nb::dict save(Sampler& sampler) {
    nb::dict blocks;
    std::vector<std::tuple<std::string, std::uint8_t*, std::size_t>> copies;
    pmc::Writer writer([&](const std::string& name, std::span<const std::byte> bytes) {
        auto* data = new std::uint8_t[bytes.size() + 1];
        if (!bytes.empty()) std::memcpy(data, bytes.data(), bytes.size());
        copies.emplace_back(name, data, bytes.size());
    });
    sampler.alone([&] { sampler.archive(writer); });
    for (auto& [name, data, size] : copies) {
        nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<std::uint8_t*>(p); });
        blocks[name.c_str()] = nb::ndarray<nb::numpy, std::uint8_t, nb::ndim<1>>(data, {size}, owner);
    }
    return blocks;
}

void restore(Sampler& sampler, const nb::dict& blocks) {
    std::vector<nb::ndarray<const std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>> kept;
    pmc::Reader reader([&](const std::string& name) -> std::span<const std::byte> {
        if (!blocks.contains(name.c_str())) throw std::runtime_error("the checkpoint has no block '" + name + "': it is damaged or of another version");
        kept.push_back(nb::cast<nb::ndarray<const std::uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>>(blocks[name.c_str()]));
        return {reinterpret_cast<const std::byte*>(kept.back().data()), kept.back().size()};
    });
    sampler.archive(reader);
}

using Words = nb::ndarray<const std::uint32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void check_pairs(const Words& a, const Words& b) {
    if (a.size() != b.size()) throw std::invalid_argument("got arrays of different lengths, expected one scramble for each index");
}

// f of each pair of words.
template <class F>
auto words(const Words& a, const Words& b, F&& f) {
    check_pairs(a, b);
    auto* data = new std::uint32_t[a.size() + 1];
    nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<std::uint32_t*>(p); });
    for (std::size_t i = 0; i < a.size(); ++i) data[i] = f(a.data()[i], b.data()[i]);
    return nb::ndarray<nb::numpy, std::uint32_t, nb::ndim<1>>(data, {a.size()}, owner);
}

}  // namespace

NB_MODULE(_core, m) {
    // Renderers in other threads may hold batches while the interpreter ends; that is no leak of ours to report.
    nb::set_leak_warnings(false);

    nb::enum_<pmc::Beta>(m, "Beta").value("gain", pmc::Beta::gain).value("variance", pmc::Beta::variance);
    nb::enum_<pmc::Estimator>(m, "Estimator").value("consistent", pmc::Estimator::consistent).value("unbiased", pmc::Estimator::unbiased);
    nb::enum_<pmc::Filter>(m, "Filter")
        .value("box", pmc::Filter::box)
        .value("tent", pmc::Filter::tent)
        .value("gaussian", pmc::Filter::gaussian)
        .value("blackman_harris", pmc::Filter::blackman_harris);

    nb::class_<pmc::Config>(m, "Config")
        .def(nb::init<>())
#define FIELD(name) .def_rw(#name, &pmc::Config::name)
        FIELD(batch) FIELD(initial_spp) FIELD(pool_share) FIELD(direct_share) FIELD(lookahead)
        FIELD(population) FIELD(moves) FIELD(radii) FIELD(eliminate) FIELD(regenerate_pool) FIELD(regenerate_jitter)
        FIELD(evaluate_regenerated) FIELD(adapt_alpha_every) FIELD(adapt_beta_every) FIELD(alpha_floor)
        FIELD(alpha_memory) FIELD(beta) FIELD(beta_power) FIELD(white_luminance) FIELD(filter) FIELD(filter_radius)
        FIELD(estimator) FIELD(correction) FIELD(correction_sigma) FIELD(correction_knee)
#undef FIELD
        .def("check", nb::overload_cast<>(&pmc::Config::check, nb::const_))
        .def("resolved", &pmc::Config::resolved);

    nb::class_<pmc::Budget>(m, "Budget")
        .def(nb::init<>())
        .def_rw("spp", &pmc::Budget::spp)
        .def_rw("seconds", &pmc::Budget::seconds)
        .def_rw("visible_noise", &pmc::Budget::visible_noise)
        .def("check", &pmc::Budget::check);

    using BatchPtr = std::shared_ptr<const pmc::Batch>;
    nb::class_<pmc::Batch>(m, "Batch")
        .def("__len__", &pmc::Batch::size)
        .def_ro("number", &pmc::Batch::number);
    m.def("batch_arrays", [](BatchPtr b) {
        return nb::make_tuple(view(b, reinterpret_cast<const float*>(b->positions.data()), 2), view(b, b->pixel.data()),
                              view(b, b->index.data()), view(b, b->scramble.data()));
    });

    nb::class_<pmc::Executor>(m, "Executor").def_prop_ro("size", &pmc::Executor::size);
    nb::class_<pmc::Nanothread, pmc::Executor>(m, "Nanothread")
        .def("__init__",
             [](pmc::Nanothread* self, std::uintptr_t pool_size, std::uintptr_t pool_thread_id, std::uintptr_t task_submit_dep, std::uintptr_t task_release) {
                 pmc::Nanothread::Functions functions;
                 const auto set = [](auto& function, std::uintptr_t address) { function = reinterpret_cast<std::decay_t<decltype(function)>>(address); };
                 set(functions.pool_size, pool_size);
                 set(functions.pool_thread_id, pool_thread_id);
                 set(functions.task_submit_dep, task_submit_dep);
                 set(functions.task_release, task_release);
                 new (self) pmc::Nanothread(functions);
             },
             "pool_size"_a, "pool_thread_id"_a, "task_submit_dep"_a, "task_release"_a);

    nb::class_<Sampler>(m, "Sampler")
        .def("__init__",
             [](Sampler* self, std::uint32_t width, std::uint32_t height, const pmc::Budget& budget, const pmc::Config& config, std::uint64_t seed, std::uint32_t aovs,
                std::variant<unsigned, std::shared_ptr<pmc::Executor>> threads, bool is_signed) {
                 new (self) Sampler(width, height, budget, config, seed, aovs, std::visit([](auto& t) { return pmc::Threads(t); }, threads), is_signed);
             },
             "width"_a, "height"_a, "budget"_a, "config"_a, "seed"_a, "aovs"_a, "threads"_a, "signed"_a)
        .def("ask", [](Sampler& s) { return s.alone([&] { return std::const_pointer_cast<pmc::Batch>(s.ask()); }); })
        .def("tell",
             [](Sampler& s, const pmc::Batch& batch, nb::ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu> radiance) {
                 const std::span<const float> values(radiance.data(), radiance.size());
                 s.alone([&] { s.tell(batch, values); });
             })
        .def("drop", [](Sampler& s, const pmc::Batch& batch) { s.alone([&] { s.drop(batch); }); })
        .def("put_back", [](Sampler& s, const pmc::Batch& batch) { s.alone([&] { s.put_back(batch); }); })
        .def("is_open", [](Sampler& s, const pmc::Batch& batch) { return s.alone([&] { return s.is_open(batch); }); })
        .def("done", [](Sampler& s) { return s.alone([&] { return static_cast<int>(s.done()); }); })
        .def_prop_ro("samples", [](Sampler& s) { return s.alone([&] { return s.samples(); }); })
        .def_prop_ro("rejected", [](Sampler& s) { return s.alone([&] { return s.rejected(); }); })
        .def_prop_ro("reserved", &Sampler::reserved)
        .def_prop_ro("total", [](const Sampler& s) -> nb::object {
            return s.total() == pmc::Sampler::unlimited ? nb::none() : nb::object(nb::int_(s.total()));
        })
        .def_prop_ro("elapsed", [](Sampler& s) { return s.alone([&] { return s.elapsed(); }); })
        .def("add_elapsed", [](Sampler& s, double seconds) { s.alone([&] { s.add_elapsed(seconds); }); })
        .def("visible_noise", [](Sampler& s) { return s.alone([&] { return pmc::visible_noise(s.film(), s.threads()); }); })
        .def("mean", [](Sampler& s) { return image(s, 3, [&](const pmc::Film& f, float* o) { pmc::corrected_mean(f, s.config, o, s.threads()); }); })
        .def("plain_mean", [](Sampler& s) { return image(s, 3, [&](const pmc::Film& f, float* o) { pmc::plain_mean(f, o, s.threads()); }); })
        .def("pool_mean", [](Sampler& s) { return image(s, 3, [&](const pmc::Film& f, float* o) { pmc::pool_mean(f, o, s.threads()); }); })
        .def("standard_error", [](Sampler& s) { return image(s, 3, [&](const pmc::Film& f, float* o) { pmc::standard_error(f, o, s.threads()); }); })
        .def("strategy", [](Sampler& s) { return image(s, 3, [&](const pmc::Film& f, float* o) { pmc::strategy(f, o, s.threads()); }); })
        .def("halves", [](Sampler& s) {
            std::vector<float> second(s.film().tiling.pixels() * 3);
            auto a = image(s, 3, [&](const pmc::Film& f, float* o) { pmc::halves(f, o, second.data(), s.threads()); });
            auto b = image(s, 3, [&](const pmc::Film&, float* o) { std::copy(second.begin(), second.end(), o); });
            return nb::make_tuple(a, b);
        })
        .def("counts", [](Sampler& s) {
            return image<std::uint32_t>(s, 1, [&](const pmc::Film& f, std::uint32_t* o) {
                pmc::for_each_pixel(f, s.threads(), [&](std::size_t i, std::size_t slot) { o[i] = f.sums[slot].n; });
            });
        })
        .def("beta", [](Sampler& s) {
            return image(s, 1, [&](const pmc::Film& f, float* o) {
                pmc::for_each_pixel(f, s.threads(), [&](std::size_t i, std::size_t slot) { o[i] = f.beta(slot); });
            });
        })
        .def("alpha", [](Sampler& s) {
            const std::size_t kernels = s.config.kernels(), width = s.film().tiling.width;
            return image(s, kernels, [&](const pmc::Film& f, float* o) {
                for (std::size_t i = 0; i < f.tiling.pixels(); ++i)
                    std::copy_n(s.alpha().at(static_cast<std::uint32_t>(i % width), static_cast<std::uint32_t>(i / width)).data(), kernels, o + kernels * i);
            }, false);
        })
        .def("aovs", [](Sampler& s) {
            const std::size_t c = s.film().aovs;
            return image(s, c, [&](const pmc::Film& f, float* o) {
                pmc::for_each_pixel(f, s.threads(), [&](std::size_t i, std::size_t slot) {
                    for (std::size_t k = 0; k < c; ++k) o[i * c + k] = f.sums[slot].n ? static_cast<float>(f.aov_sums[slot * c + k] / f.sums[slot].n) : 0.0f;
                });
            }, false);
        })
        .def("save", &save)
        .def("restore", &restore);

    m.def("tvi", [](nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu> luminance) {
        auto* data = new double[luminance.size() + 1];
        nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<double*>(p); });
        for (std::size_t i = 0; i < luminance.size(); ++i) data[i] = pmc::tvi(luminance.data()[i]);
        return nb::ndarray<nb::numpy, double, nb::ndim<1>>(data, {luminance.size()}, owner);
    });

    // Random numbers of many samples at once, for samplers and renderers that are written in NumPy.
    m.def("sobol_points", [](Words scramble, Words index, std::uint32_t pair) {
        check_pairs(scramble, index);
        auto* data = new float[2 * index.size() + 1];
        nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<float*>(p); });
        for (std::size_t i = 0; i < index.size(); ++i) {
            const auto p = pmc::sobol_pair(scramble.data()[i], index.data()[i], pair);
            data[2 * i] = p.x;
            data[2 * i + 1] = p.y;
        }
        return nb::ndarray<nb::numpy, float, nb::ndim<2>>(data, {index.size(), 2}, owner);
    });
    m.def("shuffled_index", [](Words scramble, Words index) {
        return words(scramble, index, [](std::uint32_t s, std::uint32_t i) {
            return pmc::reverse_bits(pmc::owen_reversed(pmc::reverse_bits(i), pmc::hash32(s ^ 0x4f1bbcdcu)));
        });
    });
    m.def("mix", [](Words scramble, Words index) { return words(scramble, index, pmc::mix); });

    // Pieces that tests hold against their definitions.
    m.def("reflect", &pmc::reflect);
    m.def("filter_offset", [](pmc::Filter filter, double radius, std::vector<float> u) {
        const pmc::FilterSampler sample(filter, radius);
        for (float& x : u) x = sample(x);
        return u;
    });
    m.def("inverse_square_tvi", [](float luminance) {
        static const pmc::InverseSquareTvi table;
        return table(luminance);
    });
    m.attr("film_bytes_per_pixel") = std::size_t(pmc::Film::bytes_per_pixel);
}

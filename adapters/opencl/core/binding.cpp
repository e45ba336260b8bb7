// The one file of the OpenCL adapter's compiled module that knows Python.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "bvh.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using Input = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;

std::string shape(const Input& a) {
    std::string s = "(";
    for (std::size_t i = 0; i < a.ndim(); ++i) s += (i ? ", " : "") + std::to_string(a.shape(i));
    return s + (a.ndim() == 1 ? ",)" : ")");
}

// The vector as an array, without a copy.
template <class T, std::size_t N>
nb::ndarray<nb::numpy, T> array(std::vector<T>&& values, const std::size_t (&shape)[N]) {
    auto owned = std::make_unique<std::vector<T>>(std::move(values));
    T* data = owned->data();
    nb::capsule owner(owned.release(), [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
    return {data, N, shape, owner};
}

nb::tuple build(const Input& lower, const Input& upper, std::int64_t packet, std::int64_t threads) {
    if (lower.ndim() != 2 || lower.shape(1) != 3 || upper.ndim() != 2 || upper.shape(1) != 3 || lower.shape(0) != upper.shape(0))
        throw nb::value_error(("lower and upper must both have shape (n, 3), not " + shape(lower) + " and " + shape(upper)).c_str());
    const std::size_t count = lower.shape(0);
    if (count == 0) throw nb::value_error("a hierarchy needs at least one box, and lower has none");
    if (count > bvh::max_primitives)
        throw nb::value_error(("a hierarchy holds at most " + std::to_string(bvh::max_primitives) + " boxes, not " + std::to_string(count)).c_str());
    if (packet < 1 || packet > 64) throw nb::value_error(("packet must be from 1 to 64, not " + std::to_string(packet)).c_str());
    if (threads < 0 || threads > 1024) throw nb::value_error(("threads must be from 0 to 1024, not " + std::to_string(threads)).c_str());
    bvh::Tree tree;
    {
        nb::gil_scoped_release release;
        tree = bvh::build(count, lower.data(), upper.data(), static_cast<std::size_t>(packet), static_cast<unsigned>(threads));
    }
    const std::size_t nodes = tree.children.size() / bvh::width, size = tree.order.size();
    const std::size_t bounds_shape[3] = {nodes, 6, bvh::width}, children_shape[2] = {nodes, bvh::width}, order_shape[1] = {size};
    return nb::make_tuple(array(std::move(tree.bounds), bounds_shape), array(std::move(tree.children), children_shape),
                          array(std::move(tree.order), order_shape), tree.depth);
}

}  // namespace

NB_MODULE(_bvh, m) {
    m.doc() = "A bounding volume hierarchy over boxes; the stub says what build takes and gives.";
    m.def("build", &build, "lower"_a, "upper"_a, "packet"_a = 8, "threads"_a = 0);
}

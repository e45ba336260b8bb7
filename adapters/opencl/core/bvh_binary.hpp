// The binary tree: splits by the surface area heuristic down to what one packet holds. Large ranges are split one after the
// other, each by all threads; small ones become whole subtrees, each by one thread. Which are large depends on the number of
// primitives alone.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "../../../pmc_sampler/core/parallel.hpp"
#include "bvh_bins.hpp"
#include "bvh_box.hpp"

namespace bvh {

// Below this level splits halve the number of primitives: no input makes a tree deeper than these levels and 29 more.
inline constexpr int sah_levels = 48;
inline constexpr std::size_t piece = 1 << 14;  // primitives of one step of parallel work

// No children (left == 0) makes it a leaf, of one packet at most.
struct Node {
    Box box;
    std::uint32_t begin, count, left, right;
};

struct BinaryTree {
    std::vector<Primitive> primitives;  // in the order of the leaves
    Measure measure;
    std::vector<Node> nodes;  // children after their parents
    // Where in nodes each subtree begins that was built by itself, and the end; what comes before the first lies above them.
    std::vector<std::uint32_t> subtrees;
};

class BinaryBuilder {
public:
    BinaryBuilder(std::vector<Primitive> primitives, std::size_t packet, pmc::ThreadPool& pool) : pool_(pool) {
        tree_.primitives = std::move(primitives);
        const Range all{0, static_cast<std::uint32_t>(tree_.primitives.size()), 0};
        tree_.measure = Measure(packet, extent(all).box);
    }

    BinaryTree build() {
        const std::vector<Range> tasks = build_large();
        const std::size_t top = tree_.nodes.size();
        std::vector<std::vector<Node>> parts(tasks.size());
        pool_.run(tasks.size(), [&](std::size_t i) { parts[i] = build_small(tasks[i]); });
        std::vector<std::uint32_t>& first = tree_.subtrees;
        first.assign(tasks.size() + 1, static_cast<std::uint32_t>(top));
        for (std::size_t i = 0; i < tasks.size(); ++i) first[i + 1] = first[i] + static_cast<std::uint32_t>(parts[i].size());
        tree_.nodes.resize(first.back());
        pool_.run(tasks.size(), [&](std::size_t i) {
            for (Node& n : parts[i])
                if (n.left) n.left += first[i], n.right += first[i];
            std::copy(parts[i].begin(), parts[i].end(), tree_.nodes.begin() + first[i]);
            parts[i] = {};
        });
        for (std::size_t k = 0; k < top; ++k)
            for (std::uint32_t* child : {&tree_.nodes[k].left, &tree_.nodes[k].right})
                if (*child >= task) *child = first[*child - task];
        return std::move(tree_);
    }

private:
    struct Range {
        std::uint32_t begin, end;
        int level;

        std::uint32_t count() const { return end - begin; }
    };

    // A child that is a task of its own is numbered from here on until its place is known.
    static constexpr std::uint32_t task = 1u << 31;

    // work(begin, end, partial) over pieces of the range, then join(partial) in order.
    template <class Partial, class Work, class Join>
    void in_pieces(const Range& r, Work&& work, Join&& join) {
        const std::size_t pieces = (r.count() + piece - 1) / piece;
        std::vector<Partial> partial(pieces);
        pool_.run(pieces, [&](std::size_t i) {
            const std::size_t begin = r.begin + i * piece;
            work(begin, std::min<std::size_t>(r.end, begin + piece), partial[i]);
        });
        for (auto& p : partial) join(p);
    }
    Extent extent(const Range& r) {
        Extent all;
        in_pieces<Extent>(r, [&](std::size_t b, std::size_t end, Extent& part) {
            for (; b < end; ++b) part.add(tree_.primitives[b]);
        }, [&](const Extent& part) { all.add(part); });
        return all;
    }
    Bins fill(const Range& r, const Grid& grid) {
        Bins all;
        in_pieces<Bins>(r, [&](std::size_t b, std::size_t end, Bins& part) {
            for (; b < end; ++b) part.add(tree_.primitives[b], grid);
        }, [&](const Bins& part) { all.add(part); });
        return all;
    }

    // Halves by the centres along their longest side, at a whole packet where there is more than one; equal centres stay in
    // the order of their numbers. Neither half is empty, whatever the centres, for two primitives or more.
    std::uint32_t halve(const Range& r, const Box& centres) {
        int a = 0;
        for (int k = 1; k < 3; ++k)
            if (centres.upper[k] - centres.lower[k] > centres.upper[a] - centres.lower[a]) a = k;
        const std::size_t count = r.count(), half = count / 2, packet = tree_.measure.packet;
        const auto middle = static_cast<std::uint32_t>(r.begin + (count > packet ? tree_.measure.packets(half) * packet : half));
        const auto first = tree_.primitives.begin();
        std::nth_element(first + r.begin, first + middle, first + r.end, [a](const Primitive& p, const Primitive& q) {
            const float x = p.centre(a), y = q.centre(a);
            return x != y ? x < y : p.index() < q.index();
        });
        return middle;
    }

    // Splits the large ranges, breadth first, and returns the small ones.
    std::vector<Range> build_large() {
        const auto count = static_cast<std::uint32_t>(tree_.primitives.size());
        const std::size_t small = std::max<std::size_t>(2 * piece, count / 128);
        std::vector<Range> large{{0, count, 0}}, tasks;
        if (count <= small) return large;
        scratch_.resize(count);
        std::vector<Node>& nodes = tree_.nodes;
        nodes.push_back({});
        for (std::size_t i = 0; i < large.size(); ++i) {
            const Range r = large[i];
            const Extent e = extent(r);
            const std::uint32_t middle = split_large(r, e.centres);
            const auto child = [&](const Range& c) {
                if (c.count() <= small) {
                    tasks.push_back(c);
                    return task + static_cast<std::uint32_t>(tasks.size() - 1);
                }
                large.push_back(c);
                nodes.push_back({});
                return static_cast<std::uint32_t>(large.size() - 1);
            };
            const std::uint32_t left = child({r.begin, middle, r.level + 1}), right = child({middle, r.end, r.level + 1});
            nodes[i] = {e.box, r.begin, r.count(), left, right};
        }
        scratch_ = {};
        return tasks;
    }

    // Returns where the right child begins.
    std::uint32_t split_large(const Range& r, const Box& centres) {
        const Grid grid(centres);
        if (grid.flat() || r.level >= sah_levels) return halve(r, centres);
        const Split split = best_split(fill(r, grid), grid, tree_.measure);
        // A stable partition by way of a copy: where each piece's primitives go follows from the counts before it.
        std::vector<Primitive>& primitives = tree_.primitives;
        struct Part {
            std::uint32_t left = 0, right = 0;
        };
        std::vector<Part> before(1);
        in_pieces<Part>(r, [&](std::size_t b, std::size_t end, Part& part) {
            for (; b < end; ++b) ++(split.left(primitives[b], grid) ? part.left : part.right);
        }, [&](const Part& part) { before.push_back({before.back().left + part.left, before.back().right + part.right}); });
        const std::size_t pieces = before.size() - 1;
        const std::uint32_t middle = r.begin + before.back().left;
        if (middle == r.begin || middle == r.end) return halve(r, centres);
        const auto range = [&](std::size_t k) {
            const std::size_t begin = r.begin + k * piece;
            return std::pair(begin, std::min<std::size_t>(r.end, begin + piece));
        };
        pool_.run(pieces, [&](std::size_t k) {
            std::uint32_t to[2] = {middle + before[k].right, r.begin + before[k].left};
            const auto [begin, end] = range(k);
            for (std::size_t i = begin; i < end; ++i) scratch_[to[split.left(primitives[i], grid)]++] = primitives[i];
        });
        pool_.run(pieces, [&](std::size_t k) {
            const auto [begin, end] = range(k);
            std::copy(scratch_.begin() + begin, scratch_.begin() + end, primitives.begin() + begin);
        });
        return middle;
    }

    // A whole subtree, its root first. What is left to split waits in a list, not on the thread's stack, which is small on
    // some systems.
    std::vector<Node> build_small(const Range& whole) {
        std::vector<Node> nodes;
        std::vector<std::pair<Range, std::uint32_t>> open{{whole, 0}};  // with the parent
        while (!open.empty()) {
            const auto [r, parent] = open.back();
            open.pop_back();
            const auto node = static_cast<std::uint32_t>(nodes.size());
            // Left children follow their parents at once, right ones after all that is left.
            if (node) (node == parent + 1 ? nodes[parent].left : nodes[parent].right) = node;
            Extent e;
            for (auto i = r.begin; i < r.end; ++i) e.add(tree_.primitives[i]);
            nodes.push_back({e.box, r.begin, r.count(), 0, 0});
            const std::uint32_t middle = split_small(r, e);
            if (middle == r.begin) continue;
            open.push_back({{middle, r.end, r.level + 1}, node});
            open.push_back({{r.begin, middle, r.level + 1}, node});
        }
        return nodes;
    }

    // Returns where the right child begins, or the range's begin for a leaf.
    std::uint32_t split_small(const Range& r, const Extent& e) {
        if (r.count() == 1) return r.begin;
        const bool fits = r.count() <= tree_.measure.packet;
        const Grid grid(e.centres);
        if (grid.flat() || r.level >= sah_levels) return fits ? r.begin : halve(r, e.centres);
        const auto first = tree_.primitives.begin();
        Bins bins;
        for (auto i = r.begin; i < r.end; ++i) bins.add(first[i], grid);
        const Split split = best_split(bins, grid, tree_.measure);
        // What one packet holds is split only where two packets cost less.
        if (fits && split.cost >= tree_.measure.area(e.box)) return r.begin;
        const auto middle = static_cast<std::uint32_t>(std::partition(first + r.begin, first + r.end, [&](const Primitive& p) {
            return split.left(p, grid);
        }) - first);
        return middle == r.begin || middle == r.end ? halve(r, e.centres) : middle;
    }

    pmc::ThreadPool& pool_;
    BinaryTree tree_;
    std::vector<Primitive> scratch_;
};

}  // namespace bvh

// A bounding volume hierarchy, eight children wide, over boxes. Binary splits by the surface area heuristic (SAH) over bins
// (Wald 2007, doi:10.1109/RT.2007.4342588), then the cheapest cut of the binary tree into nodes of eight children and leaves of
// whole packets, by dynamic programming (Ylitie et al. 2017, doi:10.1145/3105762.3105773, section 3.1). The result depends on
// the boxes and the packet size alone: how work is cut into pieces never depends on the number of threads.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "../../../pmc_sampler/core/parallel.hpp"

namespace bvh {

inline constexpr int width = 8;
inline constexpr int max_packets = 8;  // of one leaf
inline constexpr std::int32_t empty = std::numeric_limits<std::int32_t>::min();

// What a ray pays to test the boxes of one node, and the primitives of one packet.
inline constexpr double node_cost = 1;
inline constexpr double packet_cost = 1;

inline constexpr int bin_count = 16;
// Below this level of the binary tree splits halve the number of primitives, which bounds the depth for any input.
inline constexpr int sah_levels = 48;
inline constexpr std::size_t max_primitives = (std::size_t(1) << 28) - 1;  // so that every packet has a code

struct Tree {
    std::vector<float> bounds;           // nodes * 6 * 8
    std::vector<std::int32_t> children;  // nodes * 8
    std::vector<std::int32_t> order;
    int depth = 0;  // the most nodes on a path from the root
};

// Four lanes, the last one unused, so that the compiler takes one vector instruction for a minimum.
struct alignas(16) Box {
    float lower[4], upper[4];

    static Box nothing() {
        constexpr float inf = std::numeric_limits<float>::infinity();
        return {{inf, inf, inf, 0}, {-inf, -inf, -inf, 0}};
    }
    void add(const Box& b) {
        for (int i = 0; i < 4; ++i) lower[i] = b.lower[i] < lower[i] ? b.lower[i] : lower[i];
        for (int i = 0; i < 4; ++i) upper[i] = b.upper[i] > upper[i] ? b.upper[i] : upper[i];
    }
    void add_point(const float (&p)[4]) {
        for (int i = 0; i < 4; ++i) lower[i] = p[i] < lower[i] ? p[i] : lower[i];
        for (int i = 0; i < 4; ++i) upper[i] = p[i] > upper[i] ? p[i] : upper[i];
    }
};

// A primitive's box; its number travels as bits in the unused lane, so that a primitive is half a cache line.
struct Primitive {
    Box box;

    std::uint32_t index() const { return std::bit_cast<std::uint32_t>(box.upper[3]); }
    // Half the centre: differences of these never overflow.
    void centre(float (&c)[4]) const {
        for (int i = 0; i < 4; ++i) c[i] = 0.25f * box.lower[i] + 0.25f * box.upper[i];
    }
};

class Builder {
public:
    Builder(std::size_t count, const float* lower, const float* upper, std::size_t packet, unsigned threads)
        : packet_(packet), pool_(threads), primitives_(count) {
        pool_.ranges(count, piece, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                Box& box = primitives_[i].box;
                for (int k = 0; k < 3; ++k) {
                    box.lower[k] = lower[3 * i + k], box.upper[k] = upper[3 * i + k];
                    if (!(std::isfinite(box.lower[k]) && std::isfinite(box.upper[k])))
                        throw std::invalid_argument("box " + std::to_string(i) + " has a corner that is not finite");
                    if (box.lower[k] > box.upper[k])
                        throw std::invalid_argument("box " + std::to_string(i) + " has lower > upper");
                }
                box.lower[3] = 0;
                box.upper[3] = std::bit_cast<float>(std::uint32_t(i));
            }
        });
    }

    Tree build() {
        build_binary();
        return emit();
    }

private:
    // A binary node; no children (left == 0) makes it a leaf. choice[j], 2 <= j <= 8: of j slots the left child gets that
    // many, or 0 where fewer slots serve as well. choice[1]: whether the best single slot is a leaf.
    struct Node {
        Box box;
        std::uint32_t begin, count, left, right;
        float cost[width];  // cost[j], 1 <= j < 8: the least for at most j slots
        std::uint8_t choice[width + 1];
    };
    struct Range {
        std::uint32_t begin, end;
        int level;
    };
    struct Extent {
        Box box = Box::nothing(), centres = Box::nothing();

        void add(const Primitive& p) {
            float c[4];
            p.centre(c);
            box.add(p.box);
            centres.add_point(c);
        }
        void add(const Extent& e) {
            box.add(e.box);
            centres.add(e.centres);
        }
    };
    struct Bins {
        Box box[3][bin_count];
        std::uint32_t count[3][bin_count] = {};

        Bins() {
            for (auto& axis : box) std::fill(std::begin(axis), std::end(axis), Box::nothing());
        }
        void add(const Bins& b) {
            for (int a = 0; a < 3; ++a)
                for (int k = 0; k < bin_count; ++k) {
                    box[a][k].add(b.box[a][k]);
                    count[a][k] += b.count[a][k];
                }
        }
    };
    // From a centre to its bin on each axis; an axis without extent has but one bin.
    struct Grid {
        float origin[4], scale[4];

        explicit Grid(const Box& centres) {
            for (int a = 0; a < 4; ++a) {
                origin[a] = centres.lower[a];
                scale[a] = bin_count / (centres.upper[a] - centres.lower[a]);
                if (a == 3 || !std::isfinite(scale[a])) scale[a] = 0;
            }
        }
        bool flat() const { return scale[0] == 0 && scale[1] == 0 && scale[2] == 0; }
        void bins(const Primitive& p, int (&k)[4]) const {
            float c[4];
            p.centre(c);
            for (int a = 0; a < 3; ++a) k[a] = std::min(bin_count - 1, static_cast<int>((c[a] - origin[a]) * scale[a]));
        }
        int bin(const Primitive& p, int a) const {
            return std::min(bin_count - 1, static_cast<int>((0.25f * p.box.lower[a] + 0.25f * p.box.upper[a] - origin[a]) * scale[a]));
        }
    };
    struct Split {
        double cost = std::numeric_limits<double>::infinity();
        int axis = 0, bin = 0;  // bins up to this one go left
    };

    static constexpr std::size_t piece = 1 << 14;  // primitives of one step of parallel work

    // Half the surface. The margin keeps lines and points apart, whose surface is 0: for them the extent counts.
    double area(const Box& b) const {
        const double x = double(b.upper[0]) - b.lower[0] + margin_, y = double(b.upper[1]) - b.lower[1] + margin_,
                     z = double(b.upper[2]) - b.lower[2] + margin_;
        return x * y + y * z + z * x;
    }
    std::size_t packets(std::size_t count) const { return (count + packet_ - 1) / packet_; }

    // f(begin, end, partial) over pieces of the range, then join(partial) in order.
    template <class Partial, class Work, class Join>
    void in_pieces(const Range& r, Work&& work, Join&& join) {
        const std::size_t pieces = (r.end - r.begin + piece - 1) / piece;
        std::vector<Partial> partial(pieces);
        pool_.run(pieces, [&](std::size_t i) {
            const auto begin = static_cast<std::uint32_t>(r.begin + i * piece);
            work(begin, static_cast<std::uint32_t>(std::min<std::size_t>(r.end, begin + piece)), partial[i]);
        });
        for (auto& p : partial) join(p);
    }
    void extent(std::uint32_t begin, std::uint32_t end, Extent& e) const {
        for (auto i = begin; i < end; ++i) e.add(primitives_[i]);
    }
    void fill(std::uint32_t begin, std::uint32_t end, const Grid& grid, Bins& bins) const {
        for (auto i = begin; i < end; ++i) {
            int k[4];
            grid.bins(primitives_[i], k);
            for (int a = 0; a < 3; ++a) {
                bins.box[a][k[a]].add(primitives_[i].box);
                ++bins.count[a][k[a]];
            }
        }
    }
    Split best(const Bins& bins, const Grid& grid) const {
        Split best;
        for (int a = 0; a < 3; ++a) {
            if (grid.scale[a] == 0) continue;
            double right_cost[bin_count];
            Box box = Box::nothing();
            std::size_t count = 0;
            for (int k = bin_count - 1; k > 0; --k) {
                if (bins.count[a][k]) box.add(bins.box[a][k]);
                count += bins.count[a][k];
                right_cost[k] = count ? area(box) * packets(count) : 0;
            }
            box = Box::nothing();
            count = 0;
            for (int k = 0; k < bin_count - 1; ++k) {
                if (!bins.count[a][k]) continue;
                box.add(bins.box[a][k]);
                count += bins.count[a][k];
                const double cost = area(box) * packets(count) + right_cost[k + 1];
                if (cost < best.cost) best = {cost, a, k};
            }
        }
        return best;
    }
    // Halves by the centres along their longest side, at a whole packet; equal centres stay in the order of their numbers.
    std::uint32_t halve(const Range& r, const Box& centres) {
        int a = 0;
        for (int k = 1; k < 3; ++k)
            if (centres.upper[k] - centres.lower[k] > centres.upper[a] - centres.lower[a]) a = k;
        const std::size_t count = r.end - r.begin;
        const auto middle = static_cast<std::uint32_t>(r.begin + packets(count / 2) * packet_);
        const auto first = primitives_.begin();
        std::nth_element(first + r.begin, first + middle, first + r.end, [a](const Primitive& p, const Primitive& q) {
            const float x = 0.25f * p.box.lower[a] + 0.25f * p.box.upper[a], y = 0.25f * q.box.lower[a] + 0.25f * q.box.upper[a];
            return x != y ? x < y : p.index() < q.index();
        });
        return middle;
    }

    // Large ranges: one after the other, each by all threads. Returns where the right child begins.
    std::uint32_t split_large(const Range& r, const Extent& e) {
        const Grid grid(e.centres);
        if (grid.flat() || r.level >= sah_levels) return halve(r, e.centres);
        Bins bins;
        in_pieces<Bins>(r, [&](auto b, auto end, Bins& part) { fill(b, end, grid, part); }, [&](const Bins& part) { bins.add(part); });
        const Split split = best(bins, grid);
        // A stable partition by way of a copy: where each piece's primitives go follows from the counts before it.
        struct Part {
            std::uint32_t left = 0, size = 0;
        };
        const std::size_t pieces = (r.end - r.begin + piece - 1) / piece;
        std::vector<std::uint32_t> left(pieces + 1, r.begin), right(pieces + 1);
        std::size_t next = 0;
        in_pieces<Part>(r, [&](auto b, auto end, Part& part) {
            part.size = end - b;
            for (auto i = b; i < end; ++i) part.left += grid.bin(primitives_[i], split.axis) <= split.bin;
        }, [&](const Part& part) {
            left[next + 1] = left[next] + part.left;
            right[next + 1] = right[next] + part.size - part.left;
            ++next;
        });
        const std::uint32_t middle = left[pieces];
        pool_.run(pieces, [&](std::size_t k) {
            std::uint32_t to[2] = {middle + right[k], left[k]};
            const std::size_t b = r.begin + k * piece, end = std::min<std::size_t>(r.end, b + piece);
            for (std::size_t i = b; i < end; ++i) scratch_[to[grid.bin(primitives_[i], split.axis) <= split.bin]++] = primitives_[i];
        });
        pool_.run(pieces, [&](std::size_t k) {
            const std::size_t b = r.begin + k * piece, end = std::min<std::size_t>(r.end, b + piece);
            std::copy(scratch_.begin() + b, scratch_.begin() + end, primitives_.begin() + b);
        });
        return middle;
    }

    // Small ranges: whole subtrees by one thread. Children come after their parents.
    std::uint32_t build_small(const Range& r, std::vector<Node>& nodes) {
        Extent e;
        extent(r.begin, r.end, e);
        const auto node = static_cast<std::uint32_t>(nodes.size());
        const std::uint32_t count = r.end - r.begin;
        nodes.push_back({e.box, r.begin, count, 0, 0, {}, {}});
        if (count == 1) return node;
        const Grid grid(e.centres);
        std::uint32_t middle;
        if (grid.flat() || r.level >= sah_levels) {
            if (count <= packet_) return node;
            middle = halve(r, e.centres);
        } else {
            Bins bins;
            fill(r.begin, r.end, grid, bins);
            const Split split = best(bins, grid);
            // What one packet holds is split only where two packets cost less.
            if (count <= packet_ && split.cost >= area(e.box)) return node;
            const auto first = primitives_.begin();
            middle = static_cast<std::uint32_t>(std::partition(first + r.begin, first + r.end, [&](const Primitive& p) {
                return grid.bin(p, split.axis) <= split.bin;
            }) - first);
        }
        const std::uint32_t left = build_small({r.begin, middle, r.level + 1}, nodes);
        const std::uint32_t right = build_small({middle, r.end, r.level + 1}, nodes);
        nodes[node].left = left;
        nodes[node].right = right;
        return node;
    }

    void build_binary() {
        const auto count = static_cast<std::uint32_t>(primitives_.size());
        const std::size_t small = std::max<std::size_t>(2 * piece, count / 128);
        Extent all;
        in_pieces<Extent>({0, count, 0}, [&](auto b, auto end, Extent& part) { extent(b, end, part); }, [&](const Extent& part) { all.add(part); });
        double side = 0;
        for (int a = 0; a < 3; ++a) side = std::max(side, double(all.box.upper[a]) - all.box.lower[a]);
        margin_ = side > 0 ? 1e-7 * side : 1;
        scale_ = 1 / area(all.box);

        if (count > small) scratch_.resize(count);
        std::vector<Range> tasks;
        std::vector<std::pair<Range, std::uint32_t*>> open;
        // Breadth first; a child that is a task of its own is numbered from `task` on until its place is known.
        constexpr std::uint32_t task = 1u << 31;
        std::vector<Range> ranges{{0, count, 0}};
        if (count <= small) {
            tasks = ranges;
        } else {
            nodes_.push_back({});
            for (std::size_t i = 0; i < ranges.size(); ++i) {
                const Range r = ranges[i];
                Extent e;
                in_pieces<Extent>(r, [&](auto b, auto end, Extent& part) { extent(b, end, part); }, [&](const Extent& part) { e.add(part); });
                const std::uint32_t middle = split_large(r, e);
                const auto child = [&](const Range& c) {
                    if (c.end - c.begin <= small) {
                        tasks.push_back(c);
                        return task + static_cast<std::uint32_t>(tasks.size() - 1);
                    }
                    ranges.push_back(c);
                    nodes_.push_back({});
                    return static_cast<std::uint32_t>(ranges.size() - 1);
                };
                const std::uint32_t left = child({r.begin, middle, r.level + 1}), right = child({middle, r.end, r.level + 1});
                nodes_[i] = {e.box, r.begin, r.end - r.begin, left, right, {}, {}};
            }
            scratch_ = {};
        }
        const std::size_t top = nodes_.size();
        std::vector<std::vector<Node>> parts(tasks.size());
        pool_.run(tasks.size(), [&](std::size_t i) {
            build_small(tasks[i], parts[i]);
            for (std::size_t k = parts[i].size(); k-- > 0;) price(parts[i][k], parts[i].data());
        });
        std::vector<std::uint32_t> first(tasks.size() + 1, static_cast<std::uint32_t>(top));
        for (std::size_t i = 0; i < tasks.size(); ++i) first[i + 1] = first[i] + static_cast<std::uint32_t>(parts[i].size());
        nodes_.resize(first.back());
        pool_.run(tasks.size(), [&](std::size_t i) {
            for (Node& n : parts[i])
                if (n.left) n.left += first[i], n.right += first[i];
            std::copy(parts[i].begin(), parts[i].end(), nodes_.begin() + first[i]);
            parts[i] = {};
        });
        for (std::size_t k = top; k-- > 0;) {
            for (std::uint32_t* c : {&nodes_[k].left, &nodes_[k].right})
                if (*c >= task) *c = first[*c - task];
            price(nodes_[k], nodes_.data());
        }
    }

    // The least cost of a node in 1 to 7 slots, once its children's are known (Ylitie et al. 2017, equations 2 to 6).
    void price(Node& n, const Node* nodes) const {
        constexpr float inf = std::numeric_limits<float>::infinity();
        const double share = area(n.box) * scale_;
        const std::size_t size = packets(n.count);
        const float leaf = size <= max_packets ? static_cast<float>(share * packet_cost * size) : inf;
        if (!n.left) {
            std::fill(std::begin(n.cost), std::end(n.cost), leaf);
            n.choice[1] = 1;
            return;
        }
        const Node &l = nodes[n.left], &r = nodes[n.right];
        float spread[width + 1];
        for (int j = 2; j <= width; ++j) {
            spread[j] = inf;
            n.choice[j] = 1;
            for (int k = 1; k < j; ++k) {
                const float cost = l.cost[k] + r.cost[j - k];
                if (cost < spread[j]) spread[j] = cost, n.choice[j] = static_cast<std::uint8_t>(k);
            }
        }
        const float inner = static_cast<float>(share * node_cost) + spread[width];
        n.choice[1] = leaf <= inner;
        n.cost[1] = std::min(leaf, inner);
        for (int j = 2; j < width; ++j) {
            n.cost[j] = std::min(spread[j], n.cost[j - 1]);
            if (spread[j] >= n.cost[j - 1]) n.choice[j] = 0;
        }
    }

    // The binary nodes that stand in j slots.
    void slots(std::uint32_t node, int j, std::uint32_t (&out)[width], int& count) const {
        const Node& n = nodes_[node];
        while (j > 1 && (!n.left || !n.choice[j])) --j;
        if (j == 1) {
            out[count++] = node;
            return;
        }
        slots(n.left, n.choice[j], out, count);
        slots(n.right, j - n.choice[j], out, count);
    }

    std::int32_t emit_leaf(const Node& n, Tree& tree) const {
        const std::size_t first = tree.order.size() / packet_, size = packets(n.count);
        for (std::size_t i = 0; i < n.count; ++i) tree.order.push_back(static_cast<std::int32_t>(primitives_[n.begin + i].index()));
        tree.order.resize((first + size) * packet_, -1);
        return static_cast<std::int32_t>(-1 - static_cast<std::int64_t>(first * max_packets + size - 1));
    }

    std::int32_t emit_node(std::uint32_t node, Tree& tree, int depth) const {
        constexpr float inf = std::numeric_limits<float>::infinity();
        tree.depth = std::max(tree.depth, depth);
        const std::size_t at = tree.children.size() / width;
        tree.children.resize((at + 1) * width, empty);
        tree.bounds.resize((at + 1) * 6 * width);
        std::uint32_t slot[width];
        int count = 0;
        if (nodes_[node].choice[1]) {  // the root alone: a scene of one leaf
            slot[count++] = node;
        } else {
            slots(nodes_[node].left, nodes_[node].choice[width], slot, count);
            slots(nodes_[node].right, width - nodes_[node].choice[width], slot, count);
        }
        for (int k = 0; k < width; ++k)
            for (int a = 0; a < 3; ++a) {
                float* bounds = tree.bounds.data() + at * 6 * width + k;
                bounds[a * width] = k < count ? nodes_[slot[k]].box.lower[a] : inf;
                bounds[(3 + a) * width] = k < count ? nodes_[slot[k]].box.upper[a] : -inf;
            }
        // Leaves first, so that the packets of a node lie side by side.
        for (int k = 0; k < count; ++k)
            if (nodes_[slot[k]].choice[1]) tree.children[at * width + k] = emit_leaf(nodes_[slot[k]], tree);
        for (int k = 0; k < count; ++k)
            if (!nodes_[slot[k]].choice[1]) {
                const std::int32_t child = emit_node(slot[k], tree, depth + 1);
                tree.children[at * width + k] = child;
            }
        return static_cast<std::int32_t>(at);
    }

    Tree emit() const {
        Tree tree;
        tree.order.reserve(primitives_.size() + primitives_.size() / 2);
        emit_node(0, tree, 1);
        return tree;
    }

    std::size_t packet_;
    pmc::ThreadPool pool_;
    std::vector<Primitive> primitives_, scratch_;
    std::vector<Node> nodes_;
    double margin_ = 0, scale_ = 0;
};

}  // namespace bvh

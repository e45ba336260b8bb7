// The cheapest cut of a binary tree into nodes of eight children and leaves of whole packets, by dynamic programming (Ylitie et
// al. 2017, doi:10.1145/3105762.3105773, section 3.1).
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <limits>
#include <utility>
#include <vector>

#include "../../../pmc_sampler/core/parallel.hpp"
#include "bvh_binary.hpp"

namespace bvh {

inline constexpr int width = 8;
inline constexpr int max_packets = 8;  // of one leaf
inline constexpr std::int32_t empty = std::numeric_limits<std::int32_t>::min();
inline constexpr std::size_t max_primitives = (std::size_t(1) << 28) - 1;  // so that every packet has a code

// What a ray pays to test the boxes of one node, and the primitives of one packet.
inline constexpr double node_cost = 1;
inline constexpr double packet_cost = 1;

struct Tree {
    std::vector<float> bounds;           // nodes * 6 * 8
    std::vector<std::int32_t> children;  // nodes * 8
    std::vector<std::int32_t> order;
    int depth = 0;  // the most nodes on a path from the root
};

class WideBuilder {
public:
    WideBuilder(BinaryTree binary, pmc::ThreadPool& pool) : binary_(std::move(binary)), cuts_(binary_.nodes.size()) {
        const std::vector<std::uint32_t>& first = binary_.subtrees;
        pool.run(first.size() - 1, [&](std::size_t i) {
            for (std::size_t k = first[i + 1]; k-- > first[i];) price(k);
        });
        for (std::size_t k = first[0]; k-- > 0;) price(k);
    }

    Tree build() const {
        Tree tree;
        tree.order.reserve(binary_.primitives.size() + binary_.primitives.size() / 2);
        emit_node(0, tree, 1);
        return tree;
    }

private:
    // Of one binary node. choice[j], 2 <= j <= 8: of j slots the left child gets that many, or 0 where fewer slots serve as
    // well. choice[1]: whether the best single slot is a leaf.
    struct Cut {
        float cost[width];  // cost[j], 1 <= j < 8: the least for at most j slots
        std::uint8_t choice[width + 1];
    };

    // The least cost of a node in 1 to 7 slots, once its children's are known (Ylitie et al. 2017, equations 2 to 6).
    void price(std::size_t node) {
        constexpr float inf = std::numeric_limits<float>::infinity();
        const Node& n = binary_.nodes[node];
        Cut& cut = cuts_[node];
        const double share = binary_.measure.area(n.box) * scale_;
        const std::size_t size = binary_.measure.packets(n.count);
        const float leaf = size <= max_packets ? static_cast<float>(share * packet_cost * size) : inf;
        if (!n.left) {
            std::fill(std::begin(cut.cost), std::end(cut.cost), leaf);
            cut.choice[1] = 1;
            return;
        }
        const Cut &l = cuts_[n.left], &r = cuts_[n.right];
        float spread[width + 1];
        for (int j = 2; j <= width; ++j) {
            spread[j] = inf;
            cut.choice[j] = 1;
            for (int k = 1; k < j; ++k) {
                const float cost = l.cost[k] + r.cost[j - k];
                if (cost < spread[j]) spread[j] = cost, cut.choice[j] = static_cast<std::uint8_t>(k);
            }
        }
        const float inner = static_cast<float>(share * node_cost) + spread[width];
        cut.choice[1] = leaf <= inner;
        cut.cost[1] = std::min(leaf, inner);
        for (int j = 2; j < width; ++j) {
            cut.cost[j] = std::min(spread[j], cut.cost[j - 1]);
            if (spread[j] >= cut.cost[j - 1]) cut.choice[j] = 0;
        }
    }

    // The binary nodes that stand in j slots.
    void slots(std::uint32_t node, int j, std::uint32_t (&out)[width], int& count) const {
        const Node& n = binary_.nodes[node];
        const Cut& cut = cuts_[node];
        while (j > 1 && (!n.left || !cut.choice[j])) --j;
        if (j == 1) {
            out[count++] = node;
            return;
        }
        slots(n.left, cut.choice[j], out, count);
        slots(n.right, j - cut.choice[j], out, count);
    }

    std::int32_t emit_leaf(const Node& n, Tree& tree) const {
        const std::size_t packet = binary_.measure.packet, first = tree.order.size() / packet;
        const std::size_t size = binary_.measure.packets(n.count);
        for (auto i = n.begin; i < n.begin + n.count; ++i)
            tree.order.push_back(static_cast<std::int32_t>(binary_.primitives[i].index()));
        tree.order.resize((first + size) * packet, -1);
        return static_cast<std::int32_t>(-1 - static_cast<std::int64_t>(first * max_packets + size - 1));
    }

    // Calls itself no deeper than the binary tree is, which sah_levels bounds.
    std::int32_t emit_node(std::uint32_t node, Tree& tree, int depth) const {
        constexpr float inf = std::numeric_limits<float>::infinity();
        tree.depth = std::max(tree.depth, depth);
        const std::size_t at = tree.children.size() / width;
        tree.children.resize((at + 1) * width, empty);
        tree.bounds.resize((at + 1) * 6 * width);
        std::uint32_t slot[width];
        int count = 0;
        if (leaf(node)) {  // the root alone: a scene of one leaf
            slot[count++] = node;
        } else {
            const Node& n = binary_.nodes[node];
            const int left = cuts_[node].choice[width];
            slots(n.left, left, slot, count);
            slots(n.right, width - left, slot, count);
        }
        for (int k = 0; k < width; ++k)
            for (int a = 0; a < 3; ++a) {
                float* bounds = tree.bounds.data() + at * 6 * width + k;
                bounds[a * width] = k < count ? binary_.nodes[slot[k]].box.lower[a] : inf;
                bounds[(3 + a) * width] = k < count ? binary_.nodes[slot[k]].box.upper[a] : -inf;
            }
        // Leaves first, so that the packets of a node lie side by side.
        for (int k = 0; k < count; ++k)
            if (leaf(slot[k])) tree.children[at * width + k] = emit_leaf(binary_.nodes[slot[k]], tree);
        for (int k = 0; k < count; ++k)
            if (!leaf(slot[k])) {
                const std::int32_t child = emit_node(slot[k], tree, depth + 1);
                tree.children[at * width + k] = child;
            }
        return static_cast<std::int32_t>(at);
    }
    bool leaf(std::uint32_t node) const { return cuts_[node].choice[1]; }

    BinaryTree binary_;
    double scale_ = 1 / binary_.measure.area(binary_.nodes[0].box);  // makes an area the share of the root's
    std::vector<Cut> cuts_;
};

}  // namespace bvh

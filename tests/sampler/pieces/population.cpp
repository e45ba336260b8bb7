// Who is eliminated, against its definition.
#include <algorithm>
#include <cmath>
#include <limits>

#include <population.hpp>

#include "piece.hpp"

namespace {

void check_logarithm() {
    at = "logarithm";
    const auto check = [](float x) {
        const double expected = std::log(static_cast<double>(x));
        require(std::abs(pmc::logarithm(x) - expected) <= 3e-7 * std::abs(expected), "it is one, to 3e-7");
    };
    for (std::uint32_t word = 0; word < 1u << 23; word += 1 + word / 4096) check((static_cast<float>(word) + 0.5f) * 0x1p-23f);
    for (std::uint32_t below_one = 0; below_one < 4096; ++below_one) check(1.0f - static_cast<float>(below_one + 1) * 0x1p-24f);
    for (float x = std::numeric_limits<float>::min(); x < 1e38f; x *= 1.37f) check(x);
    require(pmc::logarithm(1.0f) == 0.0f, "that of 1 is 0");
}

float weight_of(std::uint32_t kind) {
    switch (kind) {
    case 0: return 0.0f;
    case 1: return std::numeric_limits<float>::denorm_min();
    case 2: return std::numeric_limits<float>::infinity();
    case 3: return std::numeric_limits<float>::quiet_NaN();
    default: return std::pow(10.0f, static_cast<float>(kind % 40) - 20.0f);
    }
}

void check_keys(std::size_t n) {
    std::vector<float> weights(n);
    for (float& weight : weights) weight = weight_of(below(2) ? below(4) : 4 + below(40));
    const pmc::Stream stream(generator(), 16, generator());
    std::vector<float> keys = weights;
    pmc::weights_to_keys(stream, keys.data(), n);
    constexpr float largest = std::numeric_limits<float>::max();
    for (std::size_t i = 0; i < n; ++i) {
        at = "key " + std::to_string(i) + " of " + std::to_string(n) + ", of weight " + std::to_string(weights[i]);
        const double u = (static_cast<double>(stream.word(static_cast<std::uint32_t>(i)) >> 9) + 0.5) * 0x1p-23, expected = -std::log(u) / static_cast<double>(weights[i]);
        if (weights[i] > 0.0f && expected < 0.99 * static_cast<double>(largest))
            require(std::abs(static_cast<double>(keys[i]) - expected) <= 1e-6 * expected + 1e-44, "it is -log(u) / w");
        else
            require(keys[i] >= 0.499f * largest && keys[i] <= largest, "without weight it comes after all others");
    }
}

void check_rank(std::size_t n) {
    at = "ranks of " + std::to_string(n);
    std::vector<float> values(n), scratch;
    const bool alike = below(3) == 0;
    for (float& value : values) value = alike ? static_cast<float>(1 + below(3)) : std::pow(10.0f, static_cast<float>(below(72)) - 38.0f) * static_cast<float>(below(1000));
    std::vector<float> sorted = values;
    std::sort(sorted.begin(), sorted.end());
    for (const std::size_t rank : {std::size_t(0), n / 3, n - 1, std::size_t(below(static_cast<std::uint32_t>(n)))})
        require(pmc::of_rank(values, rank, scratch) == sorted[rank], "it is the value in that place");
    values[below(static_cast<std::uint32_t>(n))] = std::numeric_limits<float>::max();
    require(pmc::of_rank(values, n - 1, scratch) == std::numeric_limits<float>::max(), "the largest float comes last");
}

// All but the members with the least keys, in their order; of equal keys the first stay.
void check_eliminated(std::size_t n, double share) {
    at = std::to_string(share) + " of " + std::to_string(n) + " members";
    pmc::Population population;
    population.members.resize(n);
    const std::uint32_t some = below(3);
    for (pmc::Member& member : population.members) {
        member.rounds = below(5);
        for (std::uint32_t k = some ? below(4) : 0; k > 0; --k) member.all.add(pmc::unit_float(static_cast<std::uint32_t>(generator())));
        if (some == 1 && below(2)) member.all = {2.0f, 0.0f, std::numeric_limits<float>::infinity()};  // all such have the same key
    }
    const pmc::Stream stream(generator(), 16, generator());
    std::vector<float> keys(n);
    for (std::size_t i = 0; i < n; ++i) keys[i] = population.members[i].all.variance() / static_cast<float>(std::max(1u, population.members[i].rounds));
    pmc::weights_to_keys(stream, keys.data(), n);
    std::vector<std::uint32_t> order(n), gone;
    for (std::uint32_t i = 0; i < n; ++i) order[i] = i;
    std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return keys[a] < keys[b]; });
    order.erase(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(std::llround((1.0 - share) * static_cast<double>(n))));
    std::sort(order.begin(), order.end());
    population.eliminated(share, stream, gone);
    require(gone == order, "those go that have the largest keys");
}

void test() {
    check_logarithm();
    for (std::uint32_t round = 0; round < 300; ++round) {
        const std::size_t n = 1 + below(round % 3 ? 40 : 4000);
        check_keys(n);
        check_rank(n);
        const double shares[] = {0.0, 0.4, 0.6, 1.0};
        check_eliminated(n, shares[below(4)]);
    }
}

}  // namespace

int main() { return report(test); }

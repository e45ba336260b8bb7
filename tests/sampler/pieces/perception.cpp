// The table of 1 / tvi^2 against tvi.
#include <cfloat>
#include <cmath>
#include <limits>

#include <perception.hpp>

#include "piece.hpp"

namespace {

void test() {
    const pmc::InverseSquareTvi table;
    const auto exact = [](float L) { return 1.0 / (pmc::tvi(L) * pmc::tvi(L)); };
    const auto close = [&](float L, double most) {
        at = "at " + std::to_string(L) + " cd/m2";
        require(std::abs(table(L) / exact(L) - 1.0) < most, "the table is close to tvi");
    };
    // Within a step of the table, a 32nd of an octave.
    const auto near = [](double L, double exponent) { return std::abs(L / std::pow(10.0, exponent) - 1.0) < 1.0 / 32; };
    for (int k = 0; k <= 200'000; ++k) {
        const auto L = static_cast<float>(std::pow(10.0, -6.0 + 12.0 * k / 200'000));
        // Where two pieces of tvi do not meet, the table goes from one to the other in its own step; where they meet at an angle, it
        // cuts the corner.
        close(L, near(L, -1.44) || near(L, 1.9) ? 0.06 : near(L, -0.0184) ? 0.006 : 0.003);
    }
    for (const float L : {1e9f, 1e15f, 1e19f}) close(L, 0.003);
    const float darkness = static_cast<float>(exact(0.0f)), smallest = std::numeric_limits<float>::denorm_min();
    for (const float L : {0.0f, -0.0f, smallest, 1e-40f, FLT_MIN, 1e-20f, -smallest, -1.0f, -FLT_MAX, -std::numeric_limits<float>::infinity()}) {
        at = "at " + std::to_string(L) + " cd/m2";
        require(table(L) == darkness, "darkness has one threshold");
    }
    at = "tvi";
    for (const double L : {0.0, -1.0, 1e-310, 1e-4})
        require(std::abs(pmc::tvi(L) / std::pow(10.0, -2.86) - 1.0) < 1e-12, "darkness has the threshold 10^-2.86");
    require(pmc::tvi(std::numeric_limits<double>::infinity()) == std::numeric_limits<double>::infinity(), "infinity has an infinite threshold");
    require(std::isnan(pmc::tvi(std::numeric_limits<double>::quiet_NaN())), "NaN stays NaN");
    at = "at the end of floats";
    require(table(FLT_MAX) == 0.0f && table(std::numeric_limits<float>::infinity()) == 0.0f, "nothing is seen where the threshold is beyond floats");
}

}  // namespace

int main() { return report(test); }

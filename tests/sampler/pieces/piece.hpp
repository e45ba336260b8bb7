// What the tests of single parts of the core share: each is a program that is silent where its part keeps what its header says.
#pragma once

#include <cstdint>
#include <cstdio>
#include <random>
#include <stdexcept>
#include <string>
#include <utility>

inline std::mt19937_64 generator(1);
inline std::string at;  // what is tested now

inline std::uint32_t below(std::uint32_t n) { return static_cast<std::uint32_t>(generator() % n); }

inline void require(bool holds, const char* what) {
    if (!holds) throw std::runtime_error(at + ": does not hold: " + what);
}

using Size = std::pair<std::uint32_t, std::uint32_t>;
inline std::string size_of(std::uint32_t width, std::uint32_t height) { return std::to_string(width) + "x" + std::to_string(height); }

// The exit status; what does not hold is said on the standard error.
template <class Test>
int report(Test&& test) {
    try {
        test();
        return 0;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}

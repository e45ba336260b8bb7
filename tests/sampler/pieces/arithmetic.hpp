// The state of floating-point arithmetic, as others may leave it.
#pragma once

#include <bit>
#include <cfenv>
#include <cfloat>
#include <cstdint>
#include <limits>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

// Arithmetic as others' threads may have it: rounding up and, where the processor can, denormal numbers as zeros.
inline void make_unusual() {
    std::fesetround(FE_UPWARD);
#if defined(__x86_64__)
    _mm_setcsr(_mm_getcsr() | 0x8040u);
#endif
}
inline bool is_unusual() {
#if defined(__x86_64__)
    if ((_mm_getcsr() & 0x8040u) != 0x8040u) return false;
#endif
    return std::fegetround() == FE_UPWARD;
}
inline bool is_usual() {
    volatile float least = FLT_MIN, smallest = std::numeric_limits<float>::denorm_min(), one = 1.0f;
    volatile double least_double = DBL_MIN, smallest_double = std::numeric_limits<double>::denorm_min();
    const volatile float half = 0.5f * least, sum = smallest + smallest, next = one + 0x1p-30f;
    const volatile double half_double = 0.5 * least_double, sum_double = smallest_double + smallest_double;
    return std::bit_cast<std::uint32_t>(float(half)) == 0x00400000u && std::bit_cast<std::uint32_t>(float(sum)) == 2u && next == one &&
           std::bit_cast<std::uint64_t>(double(half_double)) == 0x0008000000000000u && std::bit_cast<std::uint64_t>(double(sum_double)) == 2u;
}

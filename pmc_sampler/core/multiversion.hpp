// Loops that are compiled for several instruction sets, one of which is chosen at run time. Their bits are the same on all as long
// as the compiler contracts nothing into fused multiply-adds (-ffp-contract=off): integers, and single operations on floats in
// an order that the text gives. Sanitizers do not bear such functions.
#pragma once

#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__linux__) && !defined(__SANITIZE_THREAD__) && \
    !defined(__SANITIZE_ADDRESS__)
#if __GNUC__ >= 12
#define PMC_MULTIVERSION __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define PMC_MULTIVERSION __attribute__((target_clones("avx512f", "avx2", "default")))
#endif
#else
#define PMC_MULTIVERSION
#endif

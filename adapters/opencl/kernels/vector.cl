// Small functions that everything else uses. Most are OpenCL's own under other names: PoCL compiles its library for another
// processor than the kernel and calls instead of inlining it, for which all vector registers are saved to memory.

// Floating-point products are fused into sums nowhere that it is not asked for: images must not depend on how a compiler feels
// about a loop, and watertight intersection rests on it.
#pragma OPENCL FP_CONTRACT OFF

#define INLINE static inline __attribute__((always_inline))
#define OVERLOADED INLINE __attribute__((overloadable))

#define PI 3.14159265358979f
#define INV_PI 0.31830988618379f

// The first argument where either is not a number.
OVERLOADED float smaller(float a, float b) { return b < a ? b : a; }
OVERLOADED float larger(float a, float b) { return b > a ? b : a; }
OVERLOADED int smaller(int a, int b) { return b < a ? b : a; }
OVERLOADED int larger(int a, int b) { return b > a ? b : a; }
OVERLOADED float3 larger(float3 a, float3 b) { return b > a ? b : a; }
OVERLOADED float8 smaller(float8 a, float8 b) { return b < a ? b : a; }
OVERLOADED float8 larger(float8 a, float8 b) { return b > a ? b : a; }
OVERLOADED float limited(float x, float low, float high) { return smaller(larger(x, low), high); }

OVERLOADED float magnitude(float x) { return as_float(as_int(x) & 0x7fffffff); }
OVERLOADED float3 magnitude(float3 x) { return as_float3(as_int3(x) & 0x7fffffff); }

#if defined(__clang__) && defined(__x86_64__) && !defined(PORTABLE)
OVERLOADED float root(float x) { return __builtin_sqrtf(x); }
INLINE int lowest(uint bits) { return __builtin_ctz(bits); }
#else
OVERLOADED float root(float x) { return sqrt(x); }
INLINE int lowest(uint bits) { return (int)popcount((bits & -bits) - 1u); }
#endif

OVERLOADED float3 root(float3 v) { return (float3)(root(v.x), root(v.y), root(v.z)); }

// A bit for each lane that is true; that of lane 0 is the lowest.
INLINE uint lanes(int8 mask) {
#if defined(__clang__) && defined(__AVX__) && !defined(PORTABLE)
    return (uint)__builtin_ia32_movmskps256(as_float8(mask));
#else
    const int8 bits = mask & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
    const int4 a = bits.lo | bits.hi;
    const int2 b = a.lo | a.hi;
    return (uint)(b.x | b.y);
#endif
}

INLINE float square(float x) { return x * x; }
INLINE float largest(float3 v) { return larger(larger(v.x, v.y), v.z); }
INLINE float inner(float3 a, float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE float3 outer(float3 a, float3 b) { return a.yzx * b.zxy - a.zxy * b.yzx; }
INLINE float norm(float3 v) { return root(inner(v, v)); }
INLINE float3 unit(float3 v) { return v * (1.0f / norm(v)); }
INLINE float component(float3 v, int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }
INLINE float3 load3(global const float* from, int i) { return (float3)(from[3 * i], from[3 * i + 1], from[3 * i + 2]); }

// Cosine and sine of an angle within an eighth of a turn, and of any number of turns from 0 to 1 (Taylor series, 1e-7).
INLINE float2 eighth(float phi) {
    const float p = phi * phi;
    return (float2)(1.0f - p * (0.5f - p * (4.16666667e-2f - p * (1.38888889e-3f - p * 2.48015873e-5f))),
                    phi * (1.0f - p * (1.66666667e-1f - p * (8.33333333e-3f - p * (1.98412698e-4f - p * 2.75573192e-6f)))));
}
INLINE float2 circle(float turns) {
    const int quarter = (int)(4.0f * turns + 0.5f);
    const float2 c = eighth((turns - 0.25f * quarter) * (2.0f * PI));
    const float2 turned = quarter & 1 ? (float2)(-c.y, c.x) : c;
    return quarter & 2 ? -turned : turned;
}

// Tangents of a unit normal (Duff et al. 2017, JCGT 6(1)).
INLINE void tangents(float3 n, float3* s, float3* t) {
    const float sign = n.z >= 0.0f ? 1.0f : -1.0f;
    const float a = -1.0f / (sign + n.z), b = n.x * n.y * a;
    *s = (float3)(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
    *t = (float3)(b, sign + n.y * n.y * a, -n.y);
}

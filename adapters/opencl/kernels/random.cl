// Random numbers of a path, each a function of (scramble, index, dimension) alone. Owen-scrambled Sobol points by hash are those
// of the sampler's core (random.hpp there has the sources), four pairs of dimensions at once: the eight of one path vertex.

INLINE uint4 hash32(uint4 x) {
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

INLINE uint hash32_1(uint x) {
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

INLINE uint8 hash32_8(uint8 x) {
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

#define REVERSE_BITS(x)                                       \
    x = ((x >> 1) & 0x55555555u) | ((x & 0x55555555u) << 1);  \
    x = ((x >> 2) & 0x33333333u) | ((x & 0x33333333u) << 2);  \
    x = ((x >> 4) & 0x0f0f0f0fu) | ((x & 0x0f0f0f0fu) << 4);  \
    x = ((x >> 8) & 0x00ff00ffu) | ((x & 0x00ff00ffu) << 8);  \
    x = (x >> 16) | (x << 16)

#define OWEN_REVERSED(x, key)   \
    x ^= x * 0x3d20adeau;       \
    x += key;                   \
    x *= (key >> 16) | 1u;      \
    x ^= x * 0x05526c56u;       \
    x ^= x * 0x53a22864u

typedef struct {
    uint scramble, index;
#if INDEPENDENT
    uint key0, key1;
#else
    uint reversed;  // index, its bits in reverse
#endif
} Sequence;

INLINE Sequence sequence(uint scramble, uint index) {
    Sequence s;
    s.scramble = scramble;
    s.index = index;
#if INDEPENDENT
    s.key0 = hash32_1(scramble ^ hash32_1(index + 0x9e3779b9u));
    s.key1 = hash32_1(s.key0 ^ hash32_1(index ^ 0x68bc21ebu));
#else
    uint r = index;
    REVERSE_BITS(r);
    s.reversed = r;
#endif
    return s;
}

// Dimensions of pairs [first, first + 4): the first coordinate of each pair in the low half, the second in the high half.
INLINE uint8 words(const Sequence* s, uint first) {
    const uint4 pair = (uint4)(first) + (uint4)(0, 1, 2, 3);
#if INDEPENDENT
    const uint8 counter = (uint8)(pair, pair + 0x40000000u);
    const uint8 x = hash32_8(hash32_8(counter ^ s->key0) + s->key1);
#else
    const uint4 key = hash32((uint4)(s->scramble) ^ hash32(pair + 0x9e3779b9u));
    uint4 i = (uint4)(s->reversed);
    OWEN_REVERSED(i, key);
    REVERSE_BITS(i);
    uint4 t = i;
    t ^= (t >> 1) & 0x55555555u;
    t ^= (t >> 2) & 0x33333333u;
    t ^= (t >> 4) & 0x0f0f0f0fu;
    t ^= (t >> 8) & 0x00ff00ffu;
    t ^= (t >> 16) & 0x0000ffffu;
    uint8 x = (uint8)(i, t);
    const uint8 keys = hash32_8((uint8)(key ^ 0x68bc21ebu, key ^ 0x02e5be93u));
    OWEN_REVERSED(x, keys);
    REVERSE_BITS(x);
#endif
    return x;
}

// The same as numbers in [0, 1).
INLINE float8 uniform_of(uint8 words_) { return convert_float8(words_ >> 8) * 0x1p-24f; }
INLINE float8 draws(const Sequence* s, uint first) { return uniform_of(words(s, first)); }

// One of `count` entries of an alias table: *entry evenly, *rest in [0, 1) what the word has left.
INLINE void split(uint word, uint count, int* entry, float* rest) {
    *entry = (int)(((ulong)word * count) >> 32);
    *rest = ((float)((word * count) >> 9) + 0.5f) * 0x1p-23f;
}

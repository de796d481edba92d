// W lanes of R and the few operations the kernels need. Included once per level, inside that level's namespace, so that
// no code compiled for one instruction set can be linked in place of another's. Intrinsics live here and nowhere else.
//
// The including file defines SVRGS_LANES (1, 4, 8, 16) and SVRGS_REAL (float, double).
#include "constants.h"

using R = SVRGS_REAL;
constexpr int W = SVRGS_LANES;
using IntR = std::conditional_t<sizeof(R) == 4, int32_t, int64_t>;
using V = R __attribute__((vector_size(sizeof(R) * W)));
using I = IntR __attribute__((vector_size(sizeof(R) * W)));
using U = std::make_unsigned_t<IntR> __attribute__((vector_size(sizeof(R) * W)));  // may wrap around
constexpr int kSub = kBlockPixels / W;  // vectors per 4x4 block

using D = double __attribute__((vector_size(sizeof(double) * W)));
inline D wide(V v) { return __builtin_convertvector(v, D); }
inline V narrow(D d) { return __builtin_convertvector(d, V); }

inline V splat(R x) { return x - V{}; }  // x - 0 is x, -0 included: one broadcast
inline V iota() {  // 0, 1, 2, ...
  V v;
  for (int i = 0; i < W; ++i) v[i] = static_cast<R>(i);
  return v;
}
inline V load(const R* p) {
  V v;
  __builtin_memcpy(&v, p, sizeof v);
  return v;
}
inline void store(R* p, V v) { __builtin_memcpy(p, &v, sizeof v); }
using Halves = uint16_t __attribute__((vector_size(2 * W)));  // the upper ones of floats
inline V load(const uint16_t* p) {
  Halves halves;
  __builtin_memcpy(&halves, p, sizeof halves);
  return (V)(__builtin_convertvector(halves, U) << 16);
}
// load(p + N), |N| < 16, near an aligned p: every unaligned load of 64 bytes is two, so these are joined from the aligned ones.
template <int N>
inline V load_at(const R* p) {
#if SVRGS_LANES == 16
  return (V)_mm512_alignr_epi32((__m512i)load(N < 0 ? p : p + W), (__m512i)load(N < 0 ? p - W : p), N & (W - 1));
#else
  return load(p + N);
#endif
}

#if SVRGS_LANES == 16
using M = __mmask16;
inline M less(V a, V b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
inline M at_least(V a, V b) { return _mm512_cmp_ps_mask(a, b, _CMP_GE_OQ); }
inline M both(M a, M b) { return a & b; }
inline M either(M a, M b) { return a | b; }
inline V select(M m, V yes, V no) { return _mm512_mask_blend_ps(m, no, yes); }
inline V keep(M m, V v) { return _mm512_maskz_mov_ps(m, v); }
inline bool any(M m) { return m != 0; }
inline uint32_t bits(M m) { return m; }
inline M and_not(M a, M b) { return b & ~a; }  // b where not a
inline V add_if(M m, V a, V b) { return _mm512_mask_add_ps(a, m, a, b); }
inline V fma(V a, V b, V c) { return _mm512_fmadd_ps(a, b, c); }
inline V fnma(V a, V b, V c) { return _mm512_fnmadd_ps(a, b, c); }
inline V min(V a, V b) { return _mm512_min_ps(a, b); }
inline V max(V a, V b) { return _mm512_max_ps(a, b); }
inline V sqrt(V a) { return _mm512_sqrt_ps(a); }
inline V rough_reciprocal(V a) { return _mm512_rcp14_ps(a); }
inline R sum(V v) { return _mm512_reduce_add_ps(v); }
inline __m256 fold(V v) { return _mm256_add_ps(_mm512_castps512_ps256(v), _mm512_extractf32x8_ps(v, 1)); }
inline R largest(V v) { return _mm512_reduce_max_ps(v); }
#else
using M = I;
inline M less(V a, V b) { return a < b; }
inline M at_least(V a, V b) { return a >= b; }
inline M both(M a, M b) { return a & b; }
inline M either(M a, M b) { return a | b; }
inline V keep(M m, V v) { return (V)((I)v & m); }
inline V add_if(M m, V a, V b) { return a + keep(m, b); }
inline M and_not(M a, M b) { return b & ~a; }
#if SVRGS_LANES >= 8
inline bool any(M m) { return !_mm256_testz_si256((__m256i)m, (__m256i)m); }
inline uint32_t bits(M m) { return static_cast<uint32_t>(_mm256_movemask_ps((__m256)m)); }
inline V fma(V a, V b, V c) { return _mm256_fmadd_ps(a, b, c); }
inline V fnma(V a, V b, V c) { return _mm256_fnmadd_ps(a, b, c); }
inline V min(V a, V b) { return _mm256_min_ps(a, b); }
inline V max(V a, V b) { return _mm256_max_ps(a, b); }
inline V select(M m, V yes, V no) { return _mm256_blendv_ps(no, yes, (__m256)m); }
inline V sqrt(V a) { return _mm256_sqrt_ps(a); }
inline V rough_reciprocal(V a) { return _mm256_rcp_ps(a); }
#else
inline uint32_t bits(M m) {
  uint32_t b = 0;
  for (int i = 0; i < W; ++i) b |= static_cast<uint32_t>(m[i] != 0) << i;
  return b;
}
inline bool any(M m) {
  IntR joined = 0;
  for (int i = 0; i < W; ++i) joined |= m[i];
  return joined != 0;
}
inline V fma(V a, V b, V c) { return a * b + c; }
inline V fnma(V a, V b, V c) { return c - a * b; }
inline V min(V a, V b) { return a < b ? a : b; }  // b where a is NaN, as the processor's own instruction does
inline V max(V a, V b) { return a > b ? a : b; }
inline V select(M m, V yes, V no) { return m ? yes : no; }
inline V sqrt(V a) {
  for (int i = 0; i < W; ++i) a[i] = std::sqrt(a[i]);
  return a;
}
#endif
inline R sum(V v) {  // fixed order: ((0 + W/2) + (1 + W/2 + 1)) ..., the same for every run
  for (int half = W / 2; half; half /= 2)
    for (int i = 0; i < half; ++i) v[i] += v[i + half];
  return v[0];
}
inline R largest(V v) {
  R best = v[0];
  for (int i = 1; i < W; ++i) best = v[i] > best ? v[i] : best;
  return best;
}
#endif

inline bool any_nan(V v) { return bits(at_least(v, v)) != (1ull << W) - 1; }

// Lane i of the result is lane from(i) of a or, from W on, of b; any where from(i) is -1. `from` captures nothing.
template <class From, int... lane>
inline V shuffle(V a, V b, From, std::integer_sequence<int, lane...>) {
  return __builtin_shufflevector(a, b, From{}(lane)...);
}
template <class From>
inline V shuffle(V a, V b, From from) {
  return shuffle(a, b, from, std::make_integer_sequence<int, W>{});
}

// Column `column` of W rows of `width` values that lie one after the other, as far as their first part + 1 vectors hold it.
template <int width, int column, int part = width - 1>
inline V column_of(const R* rows) {
  if constexpr (part == 0) {
    return load(rows);
  } else {
    return shuffle(column_of<width, column, part - 1>(rows), load(rows + W * part), [](int i) {
      const int at = width * i + column;
      return at / W == part ? W + at % W : part > 1 ? i : at < W ? at : -1;
    });
  }
}
template <int width, int... column>
inline void columns_of(const R* rows, V* out, std::integer_sequence<int, column...>) {
  ((out[column] = column_of<width, column>(rows)), ...);
}
template <int width>
inline void columns_of(const R* rows, V* out) {
  columns_of<width>(rows, out, std::make_integer_sequence<int, width>{});
}

// The kth vector of the W rows of `width` values that columns make.
template <int width, int k, int column = width - 1>
inline V of_columns(const V* columns) {
  if constexpr (column == 0)
    return shuffle(columns[0], columns[0], [](int lane) { return (W * k + lane) / width; });
  else
    return shuffle(of_columns<width, k, column - 1>(columns), columns[column], [](int lane) {
      const int at = W * k + lane;
      return at % width == column ? W + at / width : lane;
    });
}
// The way back from columns_of.
template <int width, int k = 0>
inline void interleave(const V* columns, R* rows) {
  if constexpr (k < width) {
    store(rows + W * k, of_columns<width, k>(columns));
    interleave<width, k + 1>(columns, rows);
  }
}

// W rows of W values become columns, or columns rows; with half = 2, each four rows by themselves, in every four lanes. Always inline,
// as rows_of is: in registers.
template <int half = W / 2>
[[gnu::always_inline]] inline void transpose(V* rows) {
  if constexpr (half > 0) {
    for (int pair = 0; pair < W / 2; ++pair) {
      V &top = rows[pair / half * half * 2 + pair % half], &bottom = (&top)[half];
      const V a = top, b = bottom;
      top = shuffle(a, b, [](int lane) { return lane & half ? W + lane - half : lane; });
      bottom = shuffle(a, b, [](int lane) { return lane & half ? W + lane : lane + half; });
    }
    transpose<half / 2>(rows);
  }
}

constexpr int kRow = 16;  // values of a projected Gaussian, or of an SH basis

// W rows of kRow values from their columns.
[[gnu::always_inline]] inline void rows_of(V* columns, R* rows) {
  for (int part = 0; part < kRow; part += W) {
    transpose(columns + part);
    for (int i = 0; i < W; ++i) store(rows + kRow * i + part, columns[part + i]);
  }
}

// The way back, as far as the first `used` columns.
template <int used = kRow>
[[gnu::always_inline]] inline void columns_of_rows(const R* rows, V* columns) {
  for (int part = 0; part < used; part += W) {
    for (int i = 0; i < W; ++i) columns[part + i] = load(rows + kRow * i + part);
    transpose(columns + part);
  }
}

// One lane a bit of `set`.
inline M lanes_of(uint32_t set) {
#if SVRGS_LANES == 16
  return static_cast<M>(set);
#else
  I bit;
  for (int i = 0; i < W; ++i) bit[i] = IntR(1) << i;
  return (bit & (I{} + static_cast<IntR>(set))) == bit;
#endif
}

#if SVRGS_LANES >= 8
// The first n <= 4 and n <= 8 values from p on, 0 behind them.
template <int n>
inline __m128 load_four(const float* p) {
  if constexpr (n == 4) {
    return _mm_loadu_ps(p);
  } else if constexpr (n == 2) {
    double two;
    __builtin_memcpy(&two, p, sizeof two);
    return _mm_castpd_ps(_mm_set_sd(two));
  } else {
    return _mm_maskload_ps(p, _mm_setr_epi32(-1, n > 1 ? -1 : 0, n > 2 ? -1 : 0, 0));
  }
}
template <int n>
inline __m256 load_eight(const float* p) {
  if constexpr (n <= 4)
    return _mm256_zextps128_ps256(load_four<n>(p));
  else
    return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p)), load_four<n - 4>(p + 4), 1);
}
#endif

// The first n <= W values from p on, 0 behind them. In parts, no longer than they must be: a masked load waits for all the memory it
// spans, what it leaves out included.
template <int n, class T>
inline V load_first(const T* p) {
  if constexpr (n == W) {
    return load(p);
#if SVRGS_LANES == 16
  } else if constexpr (std::is_same_v<T, R> && n <= 8) {
    return _mm512_zextps256_ps512(load_eight<n>(p));
  } else if constexpr (std::is_same_v<T, R>) {
    return _mm512_insertf32x8(_mm512_zextps256_ps512(load_eight<8>(p)), load_eight<n - 8>(p + 8), 1);
#elif SVRGS_LANES == 8
  } else if constexpr (std::is_same_v<T, R>) {
    return load_eight<n>(p);
#endif
  } else {
    T spare[W] = {};
    std::copy_n(p, n, spare);
    return load(spare);
  }
}

// Which of the W rows from `base` on ascending `ids` name, a bit each; ids[0] is one of them, and `known` are there.
inline uint32_t rows_from(uint32_t base, const uint32_t* ids, int64_t known) {
  [[maybe_unused]] constexpr uint32_t all = (1ull << W) - 1;
#if SVRGS_LANES == 16
  if (known >= W) return all & static_cast<uint32_t>(_mm512_reduce_or_epi32(_mm512_sllv_epi32(_mm512_set1_epi32(1), _mm512_sub_epi32(_mm512_loadu_si512(ids), _mm512_set1_epi32(static_cast<int>(base))))));
#elif SVRGS_LANES == 8
  if (known >= W) {
    const __m256i place = _mm256_sub_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(ids)), _mm256_set1_epi32(static_cast<int>(base)));
    const __m256i bit = _mm256_sllv_epi32(_mm256_set1_epi32(1), place);
    const __m128i half = _mm_or_si128(_mm256_castsi256_si128(bit), _mm256_extracti128_si256(bit, 1));
    const uint64_t pair = static_cast<uint64_t>(_mm_extract_epi64(half, 0) | _mm_extract_epi64(half, 1));
    return all & static_cast<uint32_t>(pair | pair >> 32);
  }
#endif
  uint32_t rows = 0;
  for (int64_t i = 0; i < known && ids[i] - base < W; ++i) rows |= 1u << (ids[i] - base);
  return rows;
}

template <int width>
struct RowBits {  // the row, as a bit, of each value of W rows
  IntR bit[W * width] = {};
  constexpr RowBits() {
    for (int i = 0; i < W * width; ++i) bit[i] = IntR(1) << i / width;
  }
};
template <int width>
constexpr RowBits<width> kRowBits;

// The lanes that hold values of `rows` in the kth vector of W rows.
template <int width>
inline M lanes_of_rows(uint32_t rows, int k) {
  I bit;
  __builtin_memcpy(&bit, kRowBits<width>.bit + W * k, sizeof bit);
#if SVRGS_LANES == 16
  return _mm512_test_epi32_mask((__m512i)bit, _mm512_set1_epi32(static_cast<int>(rows)));
#else
  return (bit & (I{} + static_cast<IntR>(rows))) != 0;
#endif
}

#if SVRGS_LANES == 8
struct SetRanks {  // how many set bits of every 8 lie below each bit, a byte each
  uint64_t ranks[256] = {};
  constexpr SetRanks() {
    for (int set = 0; set < 256; ++set)
      for (int i = 0, n = 0; i < 8; n += set >> i++ & 1) ranks[set] |= static_cast<uint64_t>(n) << 8 * i;
  }
};
constexpr SetRanks kSetRanks;
#endif

// Values that lie one after the other, the first to the lowest set bit's lane and so on; 0 in the other lanes.
inline V spread(uint32_t set, const R* packed) {
  [[maybe_unused]] const uint32_t first = (1u << __builtin_popcount(set)) - 1;  // as many lanes
#if SVRGS_LANES == 16
  return _mm512_maskz_expand_ps(static_cast<M>(set), _mm512_maskz_loadu_ps(static_cast<M>(first), packed));
#elif SVRGS_LANES == 8
  const __m256i from = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(static_cast<long long>(kSetRanks.ranks[set])));
  return keep(lanes_of(set), _mm256_permutevar8x32_ps(_mm256_maskload_ps(packed, (__m256i)lanes_of(first)), from));
#else
  V v = {};
  for (; set; set &= set - 1) v[__builtin_ctz(set)] = *packed++;
  return v;
#endif
}

#if SVRGS_LANES == 4 || SVRGS_LANES == 8
using Bytes = std::conditional_t<W == 8, uint64_t, uint32_t>;
struct SetBits {  // the positions of the set bits of every W bits, a byte each
  Bytes positions[1 << W] = {};
  constexpr SetBits() {
    for (int set = 0; set < 1 << W; ++set)
      for (int i = 0, n = 0; i < W; ++i)
        if (set >> i & 1) positions[set] |= static_cast<Bytes>(i) << 8 * n++;
  }
};
constexpr SetBits kSetBits;
#endif

// Appends first + i to list for each set bit i of `set`; writes up to 16 bytes from list + count on. Returns the new count.
inline int append_lanes(uint8_t* list, int count, int first, uint32_t set) {
#if SVRGS_LANES == 16
  const __m512i lanes = _mm512_add_epi32(_mm512_set1_epi32(first), _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15));
  const __m128i bytes = _mm512_cvtepi32_epi8(_mm512_maskz_compress_epi32(static_cast<__mmask16>(set), lanes));
  _mm_storeu_si128(reinterpret_cast<__m128i*>(list + count), bytes);
#elif SVRGS_LANES > 1
  const Bytes bytes = kSetBits.positions[set] + static_cast<Bytes>(0x0101010101010101) * static_cast<Bytes>(first);
  __builtin_memcpy(list + count, &bytes, sizeof bytes);
#else
  list[count] = static_cast<uint8_t>(first);
#endif
  return count + __builtin_popcount(set);
}

// Writes the lanes of `set` from `to` on, one after the other, and anything behind them: W values in all.
inline void pack(uint32_t set, V v, R* to) {
#if SVRGS_LANES == 16
  store(to, _mm512_maskz_compress_ps(static_cast<M>(set), v));
#elif SVRGS_LANES == 8
  const __m256i from = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(static_cast<long long>(kSetBits.positions[set])));
  store(to, _mm256_permutevar8x32_ps(v, from));
#else
  for (; set; set &= set - 1) *to++ = v[__builtin_ctz(set)];
#endif
}

// The same for first + lane.
inline void pack_lanes(uint32_t set, uint32_t first, uint32_t* to) {
#if SVRGS_LANES == 16
  const __m512i lanes = _mm512_add_epi32(_mm512_set1_epi32(static_cast<int>(first)), _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15));
  _mm512_storeu_si512(to, _mm512_maskz_compress_epi32(static_cast<M>(set), lanes));
#else
  for (; set; set &= set - 1) *to++ = first + static_cast<uint32_t>(__builtin_ctz(set));
#endif
}

// The sums of four vectors, to out[0..3].
#if SVRGS_LANES >= 8
#if SVRGS_LANES == 8
inline __m256 fold(V v) { return v; }
#endif
inline void sum4(V a, V b, V c, V d, R* out) {
  const __m256 s = _mm256_hadd_ps(_mm256_hadd_ps(fold(a), fold(b)), _mm256_hadd_ps(fold(c), fold(d)));
  _mm_storeu_ps(out, _mm_add_ps(_mm256_castps256_ps128(s), _mm256_extractf128_ps(s, 1)));
}
#else
inline void sum4(V a, V b, V c, V d, R* out) { out[0] = sum(a), out[1] = sum(b), out[2] = sum(c), out[3] = sum(d); }
#endif

// Writes a row of kRow values past the caches, where the processor can: nobody reads it soon. `to` begins with a line of memory.
inline void stream_row(const R* row, void* to) {
#if SVRGS_LANES == 16
  _mm512_stream_ps(static_cast<R*>(to), load(row));
#elif SVRGS_LANES == 8
  _mm256_stream_ps(static_cast<R*>(to), load(row)), _mm256_stream_ps(static_cast<R*>(to) + W, load(row + W));
#else
  std::copy_n(row, kRow, static_cast<R*>(to));
#endif
}
// After the last one, before others read.
inline void end_of_stream() {
#if SVRGS_LANES >= 8
  _mm_sfence();
#endif
}

// 1 / a, to float rounding (one Newton step on the processor's estimate where it has one).
inline V reciprocal(V a) {
#if SVRGS_LANES >= 8
  const V r = rough_reciprocal(a);
  return fma(r, fnma(a, r, splat(1)), r);
#else
  return splat(1) / a;
#endif
}

inline V magnitude(V x) { return max(x, -x); }
inline V floor(V x) {  // of values that fit into an integer
  const V t = __builtin_convertvector(__builtin_convertvector(x, I), V);
  return select(less(x, t), t - R(1), t);
}
inline V ceil(V x) { return -floor(-x); }
inline V clamp(V x, V low, V high) { return min(max(x, low), high); }

#ifndef SVRGS_EXP_DEGREE
#define SVRGS_EXP_DEGREE 5
#endif
// Minimax in relative error on [-0.5, 0.5], exact at 0: worst 9.2e-8 (degree 5), 2.8e-6 (4), 1.0e-4 (3).
#if SVRGS_EXP_DEGREE == 5
constexpr R kExp2[] = {R(1), R(6.931469776e-1), R(2.402224208e-1), R(5.550733748e-2), R(9.671512959e-3), R(1.326472663e-3)};
inline V exp2_end(V f) { return fma(splat(kExp2[5]), f, splat(kExp2[4])); }
#elif SVRGS_EXP_DEGREE == 4
constexpr R kExp2[] = {R(1), R(6.931241930e-1), R(2.402409864e-1), R(5.590642784e-2), R(9.582852818e-3)};
inline V exp2_end(V) { return splat(kExp2[4]); }
#else
constexpr R kExp2[] = {R(1), R(6.932829300e-1), R(2.422109769e-1), R(5.500892575e-2)};
inline V exp2_end(V) { return splat(0); }
#endif

// 2^x for -126 <= x <= 127, relative error below 2e-7 in float; meaningless outside.
inline V exp2(V x) {
  if constexpr (sizeof(R) == 8) {
    for (int i = 0; i < W; ++i) x[i] = std::exp2(x[i]);
    return x;
  } else {
    const V magic = splat(12582912.0f);  // 1.5 * 2^23: adding it rounds to an integer in the low bits
    const V t = x + magic;
    const V f = x - (t - magic);
    const V f2 = f * f;  // pairs of terms side by side: a shorter chain than one term after the other
    V p = fma(exp2_end(f), f2, fma(splat(kExp2[3]), f, splat(kExp2[2])));
    p = fma(p, f2, fma(splat(kExp2[1]), f, splat(kExp2[0])));
    return (V)((U)p + ((U)t << 23));
  }
}
// log2 x for normal x > 0, error below 2e-7 of the larger of 1 and the result.
inline V log2(V x) {
  if constexpr (sizeof(R) == 8) {
    for (int i = 0; i < W; ++i) x[i] = std::log2(x[i]);
    return x;
  } else {
    const I shifted = (I)((U)x - 0x3f3504f3);  // bits of sqrt(1/2): the mantissa comes to lie in [sqrt(1/2), sqrt(2))
    const V exponent = __builtin_convertvector(shifted >> 23, V);
    const V m = (V)((shifted & 0x7fffff) + 0x3f3504f3);
    const V s = (m - splat(1)) / (m + splat(1)), s2 = s * s;  // log m = 2 (s + s^3 / 3 + s^5 / 5 + ...), |s| < 0.172
    V p = fma(s2, splat(R(0.320598912)), splat(R(0.412198603)));
    p = fma(p, s2, splat(R(0.577078016)));
    p = fma(p, s2, splat(R(0.961796694)));
    p = fma(p, s2, splat(R(2.885390082)));
    return fma(p, s, exponent);
  }
}
inline V exp(V x) { return exp2(clamp(x * splat(R(1.4426950408889634)), splat(-126), splat(126))); }
inline V sigmoid(V x) { return splat(1) / (splat(1) + exp(-x)); }

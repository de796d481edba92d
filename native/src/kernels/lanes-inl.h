// W lanes of R and their elementary operations: load, store, arithmetic, comparison, selection, sums. W is 1, 4, 8 or 16.
//
// The files of this folder are parts of kernels.cc, not headers. kernels.cc includes them in order, inside the namespace of a SIMD level,
// and is compiled once per level. Code for one instruction set can therefore not be linked in place of code for another.
//
// native/CMakeLists.txt defines for each level SVRGS_LANES, SVRGS_REAL (float or double) and, where they may be used, SVRGS_HAVE_AVX2,
// SVRGS_HAVE_AVX512 or SVRGS_HAVE_NEON. Only lanes, math and compact contain intrinsics.

using R = SVRGS_REAL;
constexpr int W = SVRGS_LANES;
using IntR = std::conditional_t<sizeof(R) == 4, int32_t, int64_t>;
using V = R __attribute__((vector_size(sizeof(R) * W)));
using I = IntR __attribute__((vector_size(sizeof(R) * W)));
using U = std::make_unsigned_t<IntR> __attribute__((vector_size(sizeof(R) * W)));  // may wrap around

constexpr int kVectorsPerBlock = kBlockPixels / W;
constexpr int kPaddedRow = 16;  // values of a row that rows_of writes and columns_of_rows reads, whatever it contains
static_assert(kBlockPixels % W == 0 && kPaddedRow % W == 0);
#if defined(SVRGS_HAVE_AVX512)
static_assert(W == 16 && sizeof(R) == 4);
#elif defined(SVRGS_HAVE_AVX2)
static_assert(W == 8 && sizeof(R) == 4);
#elif defined(SVRGS_HAVE_NEON)
static_assert(W == 4 && sizeof(R) == 4);
#endif

using D = double __attribute__((vector_size(sizeof(double) * W)));
inline D wide(V v) { return __builtin_convertvector(v, D); }
inline V narrow(D d) { return __builtin_convertvector(d, V); }

inline V broadcast(R x) { return x - V{}; }  // x - 0 is x, -0 included: one instruction

// 0, 1, 2, ...
inline V iota() {
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
#if defined(SVRGS_HAVE_NEON)
  return (V)vshll_n_u16(vld1_u16(p), 16);
#else
  Halves halves;
  __builtin_memcpy(&halves, p, sizeof halves);
  return (V)(__builtin_convertvector(halves, U) << 16);
#endif
}
// load(p + N) for an aligned p and |N| < 16. An unaligned load of 64 bytes costs two loads; this joins two aligned ones instead.
template <int N>
inline V load_at(const R* p) {
#if defined(SVRGS_HAVE_AVX512)
  return (V)_mm512_alignr_epi32((__m512i)load(N < 0 ? p : p + W), (__m512i)load(N < 0 ? p - W : p), N & (W - 1));
#else
  return load(p + N);
#endif
}

#if defined(SVRGS_HAVE_AVX512)
using M = __mmask16;
inline M less(V a, V b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
inline M at_least(V a, V b) { return _mm512_cmp_ps_mask(a, b, _CMP_GE_OQ); }
inline M at_least_in(M m, V a, V b) { return _mm512_mask_cmp_ps_mask(m, a, b, _CMP_GE_OQ); }  // both(m, at_least(a, b))
inline M both(M a, M b) { return _kand_mask16(a, b); }
inline M either(M a, M b) { return a | b; }
inline V select(M m, V yes, V no) { return _mm512_mask_blend_ps(m, no, yes); }
inline V keep(M m, V v) { return _mm512_maskz_mov_ps(m, v); }
inline bool any(M m) { return !_kortestz_mask16_u8(m, m); }
inline uint32_t bits(M m) { return m; }
inline bool any_of_both(M a, M b) { return !_ktestz_mask16_u8(a, b); }  // any(both(a, b))
inline M and_not(M a, M b) { return b & ~a; }                           // b where not a
inline V add_if(M m, V a, V b) { return _mm512_mask_add_ps(a, m, a, b); }
inline V fma_if(M m, V a, V b, V c) { return _mm512_mask3_fmadd_ps(a, b, c, m); }  // a b + c; c where not m
inline V fnma_if(M m, V a, V b, V c) { return _mm512_mask3_fnmadd_ps(a, b, c, m); }
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
#if defined(SVRGS_HAVE_AVX2)
inline bool any(M m) { return !_mm256_testz_si256((__m256i)m, (__m256i)m); }
inline uint32_t bits(M m) { return static_cast<uint32_t>(_mm256_movemask_ps((__m256)m)); }
inline V fma(V a, V b, V c) { return _mm256_fmadd_ps(a, b, c); }
inline V fnma(V a, V b, V c) { return _mm256_fnmadd_ps(a, b, c); }
inline V min(V a, V b) { return _mm256_min_ps(a, b); }
inline V max(V a, V b) { return _mm256_max_ps(a, b); }
inline V select(M m, V yes, V no) { return _mm256_blendv_ps(no, yes, (__m256)m); }
inline V sqrt(V a) { return _mm256_sqrt_ps(a); }
inline V rough_reciprocal(V a) { return _mm256_rcp_ps(a); }
#elif defined(SVRGS_HAVE_NEON)
inline bool any(M m) { return vget_lane_u64(vreinterpret_u64_u16(vmovn_u32((uint32x4_t)m)), 0) != 0; }
inline uint32_t bits(M m) { return vaddvq_u32(vandq_u32((uint32x4_t)m, uint32x4_t{1, 2, 4, 8})); }
inline V fma(V a, V b, V c) { return vfmaq_f32(c, a, b); }
inline V fnma(V a, V b, V c) { return vfmsq_f32(c, a, b); }
inline V min(V a, V b) { return vminnmq_f32(a, b); }
inline V max(V a, V b) { return vmaxnmq_f32(a, b); }
inline V select(M m, V yes, V no) { return vbslq_f32((uint32x4_t)m, yes, no); }
inline V sqrt(V a) { return vsqrtq_f32(a); }
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
inline V min(V a, V b) { return a < b ? a : b; }  // b where a is NaN, as at every level
inline V max(V a, V b) { return a > b ? a : b; }
inline V select(M m, V yes, V no) { return m ? yes : no; }
inline V sqrt(V a) {
  for (int i = 0; i < W; ++i) a[i] = std::sqrt(a[i]);
  return a;
}
#endif
inline bool any_of_both(M a, M b) { return any(both(a, b)); }
inline M at_least_in(M m, V a, V b) { return both(m, at_least(a, b)); }
inline V fma_if(M m, V a, V b, V c) { return fma(keep(m, a), b, c); }
inline V fnma_if(M m, V a, V b, V c) { return fnma(keep(m, a), b, c); }
#if defined(SVRGS_HAVE_NEON)
inline R sum(V v) { return vaddvq_f32(v); }
inline R largest(V v) { return vmaxnmvq_f32(v); }
#else
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
#endif

#if defined(SVRGS_HAVE_NEON)
inline bool any_nan(V v) { return any(v != v); }
#else
inline bool any_nan(V v) { return bits(at_least(v, v)) != (1ull << W) - 1; }
#endif

// The mask whose lane i is bit i of `set`.
inline M lanes_of(uint32_t set) {
#if defined(SVRGS_HAVE_AVX512)
  return static_cast<M>(set);
#elif defined(SVRGS_HAVE_NEON)
  return (M)vtstq_u32(vdupq_n_u32(set), uint32x4_t{1, 2, 4, 8});
#else
  I bit;
  for (int i = 0; i < W; ++i) bit[i] = IntR(1) << i;
  return (bit & (I{} + static_cast<IntR>(set))) == bit;
#endif
}

#if defined(SVRGS_HAVE_AVX2)
// The first n values from p on (n <= 4, n <= 8), then zeros.
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

// The first n <= W values from p on, then zeros. It loads in parts that are as short as possible: a masked load waits for all the memory
// it spans, including the lanes it leaves out.
template <int n, class T>
inline V load_first(const T* p) {
  if constexpr (n == W) {
    return load(p);
#if defined(SVRGS_HAVE_AVX512)
  } else if constexpr (std::is_same_v<T, R> && n <= 8) {
    return _mm512_zextps256_ps512(load_eight<n>(p));
  } else if constexpr (std::is_same_v<T, R>) {
    return _mm512_insertf32x8(_mm512_zextps256_ps512(load_eight<8>(p)), load_eight<n - 8>(p + 8), 1);
#elif defined(SVRGS_HAVE_AVX2)
  } else if constexpr (std::is_same_v<T, R>) {
    return load_eight<n>(p);
#elif defined(SVRGS_HAVE_NEON)
  } else if constexpr (std::is_same_v<T, R>) {
    const float32x2_t first = n == 1 ? vset_lane_f32(*p, vdup_n_f32(0), 0) : vld1_f32(p);
    return vcombine_f32(first, n == 3 ? vset_lane_f32(p[2], vdup_n_f32(0), 0) : vdup_n_f32(0));
#endif
  } else {
    T spare[W] = {};
    std::copy_n(p, n, spare);
    return load(spare);
  }
}

// Writes the sums of four vectors to out[0..3].
#if defined(SVRGS_HAVE_AVX2)
#if defined(SVRGS_HAVE_AVX2) && !defined(SVRGS_HAVE_AVX512)
inline __m256 fold(V v) { return v; }
#endif
inline void sum4(V a, V b, V c, V d, R* out) {
  const __m256 s = _mm256_hadd_ps(_mm256_hadd_ps(fold(a), fold(b)), _mm256_hadd_ps(fold(c), fold(d)));
  _mm_storeu_ps(out, _mm_add_ps(_mm256_castps256_ps128(s), _mm256_extractf128_ps(s, 1)));
}
#elif defined(SVRGS_HAVE_NEON)
inline void sum4(V a, V b, V c, V d, R* out) { store(out, vpaddq_f32(vpaddq_f32(a, b), vpaddq_f32(c, d))); }
#else
inline void sum4(V a, V b, V c, V d, R* out) { out[0] = sum(a), out[1] = sum(b), out[2] = sum(c), out[3] = sum(d); }
#endif

// Writes a row of kPaddedRow values past the caches, if the processor can. For rows that are not read soon. `to` is aligned to a cache line.
inline void stream_row(const R* row, void* to) {
#if defined(SVRGS_HAVE_AVX512)
  _mm512_stream_ps(static_cast<R*>(to), load(row));
#elif defined(SVRGS_HAVE_AVX2)
  _mm256_stream_ps(static_cast<R*>(to), load(row)), _mm256_stream_ps(static_cast<R*>(to) + W, load(row + W));
#else
  std::copy_n(row, kPaddedRow, static_cast<R*>(to));
#endif
}
// To be called after the last stream_row, before another thread reads.
inline void end_of_stream() {
#if defined(SVRGS_HAVE_AVX2)
  _mm_sfence();
#endif
}

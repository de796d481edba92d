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
constexpr int kSub = kBlockPixels / W;  // vectors per 4x4 block

inline V splat(R x) { return V{} + x; }
inline V load(const R* p) {
  V v;
  __builtin_memcpy(&v, p, sizeof v);
  return v;
}
inline void store(R* p, V v) { __builtin_memcpy(p, &v, sizeof v); }

#if SVRGS_LANES == 16
using M = __mmask16;
inline M less(V a, V b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
inline M at_least(V a, V b) { return _mm512_cmp_ps_mask(a, b, _CMP_GE_OQ); }
inline M both(M a, M b) { return a & b; }
inline V select(M m, V yes, V no) { return _mm512_mask_blend_ps(m, no, yes); }
inline V keep(M m, V v) { return _mm512_maskz_mov_ps(m, v); }
inline bool any(M m) { return m != 0; }
inline uint32_t bits(M m) { return m; }
inline V add_if(M m, V a, V b) { return _mm512_mask_add_ps(a, m, a, b); }
inline V fma(V a, V b, V c) { return _mm512_fmadd_ps(a, b, c); }
inline V fnma(V a, V b, V c) { return _mm512_fnmadd_ps(a, b, c); }
inline V min(V a, V b) { return _mm512_min_ps(a, b); }
inline V max(V a, V b) { return _mm512_max_ps(a, b); }
inline V sqrt(V a) { return _mm512_sqrt_ps(a); }
inline R sum(V v) { return _mm512_reduce_add_ps(v); }
inline __m256 fold(V v) { return _mm256_add_ps(_mm512_castps512_ps256(v), _mm512_extractf32x8_ps(v, 1)); }
inline R largest(V v) { return _mm512_reduce_max_ps(v); }
#else
using M = I;
inline M less(V a, V b) { return a < b; }
inline M at_least(V a, V b) { return a >= b; }
inline M both(M a, M b) { return a & b; }
inline V select(M m, V yes, V no) { return m ? yes : no; }
inline V keep(M m, V v) { return (V)((I)v & m); }
inline V add_if(M m, V a, V b) { return a + keep(m, b); }
inline V min(V a, V b) { return a < b ? a : b; }  // b where a is NaN, as the processor's own instruction does
inline V max(V a, V b) { return a > b ? a : b; }
#if SVRGS_LANES >= 8
inline bool any(M m) { return !_mm256_testz_si256((__m256i)m, (__m256i)m); }
inline uint32_t bits(M m) { return static_cast<uint32_t>(_mm256_movemask_ps((__m256)m)); }
inline V fma(V a, V b, V c) { return _mm256_fmadd_ps(a, b, c); }
inline V fnma(V a, V b, V c) { return _mm256_fnmadd_ps(a, b, c); }
inline V sqrt(V a) { return _mm256_sqrt_ps(a); }
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

inline V clamp(V x, V low, V high) { return min(max(x, low), high); }

// 2^x for x <= 127, relative error below 2e-7 in float (degree 5, minimax on [-0.5, 0.5], exact at whole x); 2^-126 below.
inline V exp2(V x) {
  if constexpr (sizeof(R) == 8) {
    for (int i = 0; i < W; ++i) x[i] = std::exp2(x[i]);
    return x;
  } else {
    x = max(x, splat(-126));
    const V magic = splat(12582912.0f);  // 1.5 * 2^23: adding it rounds to an integer in the low bits
    const V t = x + magic;
    const V f = x - (t - magic);
    V p = splat(1.326472542e-3f);
    p = fma(p, f, splat(9.671512768e-3f));
    p = fma(p, f, splat(5.550733749e-2f));
    p = fma(p, f, splat(2.402224208e-1f));
    p = fma(p, f, splat(6.931469776e-1f));
    p = fma(p, f, splat(1));
    return (V)((I)p + ((I)t << 23));
  }
}
inline V exp(V x) { return exp2(clamp(x * splat(R(1.4426950408889634)), splat(-126), splat(126))); }
inline V sigmoid(V x) { return splat(1) / (splat(1) + exp(-x)); }

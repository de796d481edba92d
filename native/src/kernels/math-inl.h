// Functions of vectors: rounding, reciprocal, powers, logarithm, sigmoid.

// 1 / a, to float rounding (one Newton step on the processor's estimate where it has one).
inline V reciprocal(V a) {
#if defined(SVRGS_HAVE_AVX2)
  const V r = rough_reciprocal(a);
  return fma(r, fnma(a, r, broadcast(1)), r);
#else
  return broadcast(1) / a;
#endif
}

inline V magnitude(V x) { return max(x, -x); }
inline V floor(V x) {  // of values that fit into an integer
#if defined(SVRGS_HAVE_NEON)
  return vrndmq_f32(x);
#else
  const V t = __builtin_convertvector(__builtin_convertvector(x, I), V);
  return select(less(x, t), t - R(1), t);
#endif
}
inline V ceil(V x) { return -floor(-x); }
inline V clamp(V x, V low, V high) { return min(max(x, low), high); }

#ifndef SVRGS_EXP_DEGREE
#define SVRGS_EXP_DEGREE 5
#endif
// Minimax in relative error on [-0.5, 0.5], exact at 0: worst 9.2e-8 (degree 5), 2.8e-6 (4), 1.0e-4 (3).
#if SVRGS_EXP_DEGREE == 5
constexpr R kExp2[] = {R(1), R(6.931469776e-1), R(2.402224208e-1), R(5.550733748e-2), R(9.671512959e-3), R(1.326472663e-3)};
inline V exp2_end(V f) { return fma(broadcast(kExp2[5]), f, broadcast(kExp2[4])); }
#elif SVRGS_EXP_DEGREE == 4
constexpr R kExp2[] = {R(1), R(6.931241930e-1), R(2.402409864e-1), R(5.590642784e-2), R(9.582852818e-3)};
inline V exp2_end(V) { return broadcast(kExp2[4]); }
#else
constexpr R kExp2[] = {R(1), R(6.932829300e-1), R(2.422109769e-1), R(5.500892575e-2)};
inline V exp2_end(V) { return broadcast(0); }
#endif

// 2^x for -126 <= x <= 127, relative error below 2e-7 in float; undefined outside.
inline V exp2(V x) {
  if constexpr (sizeof(R) == 8) {
    for (int i = 0; i < W; ++i) x[i] = std::exp2(x[i]);
    return x;
  } else {
#if defined(SVRGS_HAVE_AVX512)
    const V f = _mm512_reduce_ps(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC), whole = x - f;
#else
    const V magic = broadcast(R(12582912));  // 1.5 * 2^23: adding it rounds to an integer in the low bits
    const V t = x + magic, f = x - (t - magic);
#endif
    const V f2 = f * f;  // pairs of terms side by side: a shorter chain than one term after the other
    V p = fma(exp2_end(f), f2, fma(broadcast(kExp2[3]), f, broadcast(kExp2[2])));
    p = fma(p, f2, fma(broadcast(kExp2[1]), f, broadcast(kExp2[0])));
#if defined(SVRGS_HAVE_AVX512)
    return _mm512_scalef_ps(p, whole);
#else
    return (V)((U)p + ((U)t << 23));
#endif
  }
}
// log2 x for normal x > 0, error below 2e-7 max(1, |result|).
inline V log2(V x) {
  if constexpr (sizeof(R) == 8) {
    for (int i = 0; i < W; ++i) x[i] = std::log2(x[i]);
    return x;
  } else {
    const I shifted = (I)((U)x - 0x3f3504f3);  // bits of sqrt(1/2): the mantissa comes to lie in [sqrt(1/2), sqrt(2))
    const V exponent = __builtin_convertvector(shifted >> 23, V);
    const V m = (V)((shifted & 0x7fffff) + 0x3f3504f3);
    const V s = (m - broadcast(1)) / (m + broadcast(1)), s2 = s * s;  // log m = 2 (s + s^3 / 3 + s^5 / 5 + ...), |s| < 0.172
    V p = fma(s2, broadcast(R(0.320598912)), broadcast(R(0.412198603)));
    p = fma(p, s2, broadcast(R(0.577078016)));
    p = fma(p, s2, broadcast(R(0.961796694)));
    p = fma(p, s2, broadcast(R(2.885390082)));
    return fma(p, s, exponent);
  }
}
inline V exp(V x) { return exp2(clamp(x * broadcast(R(1.4426950408889634)), broadcast(-126), broadcast(126))); }
inline V sigmoid(V x) { return broadcast(1) / (broadcast(1) + exp(-x)); }

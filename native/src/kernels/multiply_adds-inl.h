// Measures the arithmetic peak of this level, for the lower bounds that svrgs bench prints.

// `rounds` rounds of independent multiply-adds in registers; returns the operations done (2 a lane each).
double multiply_adds(int64_t rounds) {
  constexpr int kChains = 12;
  V sums[kChains];
  for (int k = 0; k < kChains; ++k) sums[k] = broadcast(R(k));
  volatile R unknown = R(0.999);
  const V factor = broadcast(unknown);
  for (int64_t r = 0; r < rounds; ++r)
    for (int k = 0; k < kChains; ++k) sums[k] = fma(sums[k], factor, factor);
  V total = broadcast(0);
  for (int k = 0; k < kChains; ++k) total += sums[k];
  volatile R result = sum(total);
  (void)result;
  return 2.0 * W * kChains * static_cast<double>(rounds);
}

// Adam (Kingma and Ba, Algorithm 1) on rows: param -= lr[column] / bias1 * m / (sqrt(v / bias2) + eps).

inline void adam_lanes(const svrgs_adam_settings& a, const R* rate, R* param, R* m, R* v, const R* grad) {
  const V g = load(grad), b1 = splat(R(a.beta1)), b2 = splat(R(a.beta2));
  const V m1 = fma(b1, load(m), splat(R(1 - a.beta1)) * g), v1 = fma(b2, load(v), splat(R(1 - a.beta2)) * g * g);
  const V denominator = fma(sqrt(v1), splat(R(1 / std::sqrt(a.bias2))), splat(R(a.eps)));
  store(m, m1);
  store(v, v1);
  store(param, load(param) - load(rate) * m1 / denominator);
}

inline bool row_finite(const R* row, int width) {
  bool ok = true;
  for (int k = 0; k < width; ++k) ok &= finite(row[k]);
  return ok;
}

constexpr int kAdamWidth = 64;  // widest row, values

// Rows [begin, end) of one tensor, W rows at a time through a contiguous copy. Returns how many rows were not finite.
int64_t adam_rows(const svrgs_adam_settings& a, R* param, R* m, R* v, const R* grad, const uint32_t* ids, int64_t begin, int64_t end, int width) {
  R buffer[4][W * kAdamWidth], rate[W * kAdamWidth];
  int64_t rows[W], bad = 0;
  for (int i = 0; i < W * width; ++i) rate[i] = static_cast<R>(a.lr[i % width] / a.bias1);
  for (int64_t r = begin; r < end;) {
    int n = 0;
    for (; n < W && r < end; ++r) {
      if (!row_finite(grad + r * width, width)) {
        ++bad;
        continue;
      }
      rows[n] = (ids ? static_cast<int64_t>(ids[r]) : r) * width;
      const R* source[4] = {param + rows[n], m + rows[n], v + rows[n], grad + r * width};
      for (int k = 0; k < 4; ++k) __builtin_memcpy(buffer[k] + n * width, source[k], sizeof(R) * width);
      ++n;
    }
    for (int i = n * width; i < W * width; ++i)
      for (int k = 0; k < 4; ++k) buffer[k][i] = 0;
    for (int i = 0; i < n * width; i += W) adam_lanes(a, rate + i, buffer[0] + i, buffer[1] + i, buffer[2] + i, buffer[3] + i);
    for (int i = 0; i < n; ++i) {
      R* target[3] = {param + rows[i], m + rows[i], v + rows[i]};
      for (int k = 0; k < 3; ++k) __builtin_memcpy(target[k], buffer[k] + i * width, sizeof(R) * width);
    }
  }
  return bad;
}

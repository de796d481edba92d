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

struct AdamTensors {
  R *param, *m, *v;
  const R* grad;
  const uint32_t* ids;
  int width;
  int64_t row(int64_t r) const { return (ids ? static_cast<int64_t>(ids[r]) : r) * width; }
};

// W rows through a contiguous copy: narrow rows fill whole vectors too.
inline void adam_narrow(const svrgs_adam_settings& a, const AdamTensors& t, const R* rate, const int64_t* from, int n) {
  R buffer[4][W * kAdamWidth] = {};
  for (int i = 0; i < n; ++i) {
    const int64_t at = t.row(from[i]);
    const R* source[4] = {t.param + at, t.m + at, t.v + at, t.grad + from[i] * t.width};
    for (int k = 0; k < 4; ++k) __builtin_memcpy(buffer[k] + i * t.width, source[k], sizeof(R) * t.width);
  }
  for (int i = 0; i < n * t.width; i += W) adam_lanes(a, rate + i, buffer[0] + i, buffer[1] + i, buffer[2] + i, buffer[3] + i);
  for (int i = 0; i < n; ++i) {
    const int64_t at = t.row(from[i]);
    R* target[3] = {t.param + at, t.m + at, t.v + at};
    for (int k = 0; k < 3; ++k) __builtin_memcpy(target[k], buffer[k] + i * t.width, sizeof(R) * t.width);
  }
}

// Rows [begin, end) of one tensor. Returns how many had a gradient that is not finite, and were left alone.
int64_t adam_rows(const svrgs_adam_settings& a, const AdamTensors& t, int64_t begin, int64_t end) {
  R rate[W * kAdamWidth];
  int64_t waiting[W], bad = 0;
  int n = 0;
  for (int i = 0; i < W * t.width; ++i) rate[i] = static_cast<R>(a.lr[i % t.width] / a.bias1);
  for (int64_t r = begin; r < end; ++r) {
    const R* grad = t.grad + r * t.width;
    if (!row_finite(grad, t.width)) {
      ++bad;
    } else if (t.width % W == 0) {
      const int64_t at = t.row(r);
      for (int k = 0; k < t.width; k += W) adam_lanes(a, rate + k, t.param + at + k, t.m + at + k, t.v + at + k, grad + k);
    } else {
      waiting[n++] = r;
      if (n == W) adam_narrow(a, t, rate, waiting, n), n = 0;
    }
  }
  if (n) adam_narrow(a, t, rate, waiting, n);
  return bad;
}

// Adam (Kingma and Ba, Algorithm 1) on rows: param -= lr[column] / bias1 * m / (sqrt(v / bias2) + eps).

constexpr int kAdamWidth = 64;  // widest row, values

struct AdamRates {  // constants of a step, in the level's type
  R rate[W * kAdamWidth];  // lr / bias1 by column, repeated
  V beta1, beta2, rest1, rest2, root_bias2, eps;
};

inline AdamRates adam_rates(const svrgs_adam_settings& a, const double* lr, int width) {
  AdamRates s;
  for (int k = 0; k < width; ++k) s.rate[k] = static_cast<R>(lr[k] / a.bias1);
  for (int i = 1; i < W; ++i) std::copy_n(s.rate, width, s.rate + i * width);
  s.beta1 = splat(R(a.beta1)), s.rest1 = splat(R(1 - a.beta1)), s.beta2 = splat(R(a.beta2)), s.rest2 = splat(R(1 - a.beta2));
  s.root_bias2 = splat(R(1 / std::sqrt(a.bias2))), s.eps = splat(R(a.eps));
  return s;
}

struct Moments {
  V m, v;
};

inline Moments next_moments(const AdamRates& a, V m, V v, V g) { return {fma(a.beta1, m, a.rest1 * g), fma(a.beta2, v, a.rest2 * g * g)}; }
inline V moved(const AdamRates& a, const R* rate, const Moments& n, V param) {
  return fnma(load(rate) * n.m, reciprocal(fma(sqrt(n.v), a.root_bias2, a.eps)), param);
}

inline void adam_lanes(const AdamRates& a, const R* rate, R* param, R* m, R* v, V g) {
  const Moments n = next_moments(a, load(m), load(v), g);
  store(m, n.m);
  store(v, n.v);
  store(param, moved(a, rate, n, load(param)));
}

inline bool row_finite(const R* row, int width) {
  R zero = 0;
  for (int k = 0; k < width; ++k) zero += row[k] * 0;
  return zero == 0;
}

struct AdamTensors {
  R *param, *m, *v;
};

// Rows of whole vectors, in place. Returns 1 if the gradient is not finite, and the row left alone.
inline int adam_wide(const AdamRates& a, const AdamTensors& t, int64_t at, const R* grad, int width) {
  V zero = splat(0);
  for (int k = 0; k < width; k += W) zero += load(grad + k) * R(0);
  if (!(sum(zero) == 0)) return 1;
  for (int k = 0; k < width; k += W) adam_lanes(a, a.rate + k, t.param + at + k, t.m + at + k, t.v + at + k, load(grad + k));
  return 0;
}

// n <= W rows of `width` values through a contiguous copy, so that narrow rows fill whole vectors too; row i is ids[i].
template <int fixed>
inline int adam_narrow(const AdamRates& a, const AdamTensors& t, const uint32_t* ids, const R* grad, int n, int any_width) {
  const int width = fixed ? fixed : any_width;
  if (n < 1 || n > W || width < 1 || width > kAdamWidth) __builtin_unreachable();
  constexpr int kRoom = W * (fixed ? fixed : kAdamWidth);
  alignas(64) R p[kRoom], m[kRoom], v[kRoom], g[kRoom];
  for (int i = 0; i < n; ++i) {
    const int64_t at = static_cast<int64_t>(ids[i]) * width;
    __builtin_memcpy(p + i * width, t.param + at, sizeof(R) * width);
    __builtin_memcpy(m + i * width, t.m + at, sizeof(R) * width);
    __builtin_memcpy(v + i * width, t.v + at, sizeof(R) * width);
  }
  __builtin_memcpy(g, grad, sizeof(R) * n * width);
  const int values = n * width;
  for (int i = values; i < (values + W - 1) / W * W; ++i) p[i] = m[i] = v[i] = g[i] = 0;
  for (int i = 0; i < values; i += W) adam_lanes(a, a.rate + i, p + i, m + i, v + i, load(g + i));
  int bad = 0;
  for (int i = 0; i < n; ++i) {
    if (!row_finite(grad + i * width, width)) {
      ++bad;
      continue;
    }
    const int64_t at = static_cast<int64_t>(ids[i]) * width;
    __builtin_memcpy(t.param + at, p + i * width, sizeof(R) * width);
    __builtin_memcpy(t.m + at, m + i * width, sizeof(R) * width);
    __builtin_memcpy(t.v + at, v + i * width, sizeof(R) * width);
  }
  return bad;
}

inline void prefetch_row(const AdamTensors& t, int64_t at, int width) {
  constexpr int kLine = 64 / sizeof(R);
  for (int k = 0; k < width; k += kLine)
    for (const R* array : {t.param, t.m, t.v}) __builtin_prefetch(array + at + k, 1);
}

constexpr int kRowsAhead = 8;

// n <= W rows; ids names them in the tensors, and `known` >= n of those to come; grad holds theirs one after the other.
// Returns how many were left alone.
inline int adam_group(const AdamRates& a, const AdamTensors& t, const uint32_t* ids, int64_t known, const R* grad, int n, int width) {
  if (width == 1) return adam_narrow<1>(a, t, ids, grad, n, 1);
  if (width == 3) return adam_narrow<3>(a, t, ids, grad, n, 3);
  if (width == 4) return adam_narrow<4>(a, t, ids, grad, n, 4);
  if (width % W) return adam_narrow<0>(a, t, ids, grad, n, width);
  int bad = 0;
  for (int i = 0; i < n; ++i) {
    if (i + kRowsAhead < known) prefetch_row(t, static_cast<int64_t>(ids[i + kRowsAhead]) * width, width);
    bad += adam_wide(a, t, static_cast<int64_t>(ids[i]) * width, grad + i * width, width);
  }
  return bad;
}

// Narrow rows ids[begin, end), W rows of the tensor at a time where they lie: those that are not named keep their values. Another
// thread may be at the first and the last of these, or the tensor may end within it: there rows are taken one by one.
template <int width>
inline int64_t adam_in_place(const AdamRates& a, const AdamTensors& t, const uint32_t* ids, const R* grad, int64_t begin, int64_t end) {
  int64_t bad = 0;
  for (int64_t r = begin; r < end;) {
    const int64_t from = r, base = ids[r] / W * W;
    uint64_t named = 0;  // a bit for each value of the W rows
    for (; r < end && ids[r] < base + W; ++r) named |= ((1ull << width) - 1) << width * (ids[r] - base);
    V g[width], zero = splat(0);
    const R* packed = grad + from * width;
    for (int k = 0; k < width; ++k) {
      const uint32_t set = named >> W * k & ((1u << W) - 1);
      g[k] = spread(set, packed), zero += g[k] * R(0);
      packed += __builtin_popcount(set);
    }
    if (from == begin || r == end || !(sum(zero) == 0)) {
      bad += adam_narrow<width>(a, t, ids + from, grad + from * width, static_cast<int>(r - from), width);
      continue;
    }
    for (int k = 0; k < width; ++k) {
      const int64_t at = base * width + W * k;
      const M set = lanes_of(named >> W * k & ((1u << W) - 1));
      const V m = load(t.m + at), v = load(t.v + at), param = load(t.param + at);
      const Moments n = next_moments(a, m, v, g[k]);
      store(t.m + at, select(set, n.m, m));
      store(t.v + at, select(set, n.v, v));
      store(t.param + at, select(set, moved(a, a.rate + W * k, n, param), param));
    }
  }
  return bad;
}

// Rows [begin, end) of one tensor; ids null: row r is r.
int64_t adam_rows(const AdamRates& a, const AdamTensors& t, const R* grad, const uint32_t* ids, int64_t begin, int64_t end, int width) {
  if (W >= 8 && ids && width == 1) return adam_in_place<1>(a, t, ids, grad, begin, end);
  if (W >= 8 && ids && width == 3) return adam_in_place<3>(a, t, ids, grad, begin, end);
  if (W >= 8 && ids && width == 4) return adam_in_place<4>(a, t, ids, grad, begin, end);
  int64_t bad = 0;
  for (int64_t r = begin; r < end; r += W) {
    const int n = static_cast<int>(std::min<int64_t>(W, end - r));
    uint32_t own[W];
    for (int i = 0; i < n && !ids; ++i) own[i] = static_cast<uint32_t>(r + i);
    bad += adam_group(a, t, ids ? ids + r : own, ids ? end - r : n, grad + r * width, n, width);
  }
  return bad;
}

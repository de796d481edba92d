// Adam (Kingma and Ba, Algorithm 1) on rows: param -= lr[column] / bias1 * m / (sqrt(v / bias2) + eps).

constexpr int kAdamWidth = 64;  // widest row, values

struct MomentPair {
  R m, v;
};
using Packed = std::conditional_t<sizeof(R) == 4, uint32_t, MomentPair>;  // both moments of a value: svrgs.h

// Constants of a step, in the level's type.
struct AdamRates {
  R rate[W * kAdamWidth];  // lr / bias1 by column, repeated
  V beta1, beta2, rest1, rest2, root_bias2, eps;
  uint32_t salt;  // of the step's roundings
};

inline AdamRates adam_rates(const svrgs_adam_settings& a, const double* lr, int width) {
  AdamRates s;
  const double steps = static_cast<double>(a.step), bias1 = 1 - std::pow(a.beta1, steps), bias2 = 1 - std::pow(a.beta2, steps);
  for (int k = 0; k < width; ++k) s.rate[k] = static_cast<R>(lr[k] / bias1);
  for (int i = 1; i < W; ++i) std::copy_n(s.rate, width, s.rate + i * width);
  s.beta1 = broadcast(R(a.beta1)), s.rest1 = broadcast(R(1 - a.beta1)), s.beta2 = broadcast(R(a.beta2)), s.rest2 = broadcast(R(1 - a.beta2));
  s.root_bias2 = broadcast(R(1 / std::sqrt(bias2))), s.eps = broadcast(R(a.eps));
  s.salt = static_cast<uint32_t>(a.step) * 0x9e3779b1u;
  return s;
}

struct Moments {
  V m, v;
};

inline Moments load_moments(const MomentPair* p) {
  Moments n;
  for (int i = 0; i < W; ++i) n.m[i] = p[i].m, n.v[i] = p[i].v;
  return n;
}
inline void store_moments(const AdamRates&, MomentPair* p, const Moments& n, M set) {
  for (int i = 0; i < W; ++i)
    if (bits(set) >> i & 1) p[i] = {n.m[i], n.v[i]};
}

inline U load_words(const uint32_t* p) {
  U word;
  __builtin_memcpy(&word, p, sizeof word);
  return word;
}
inline Moments load_moments(const uint32_t* p) {
  const U word = load_words(p);
  return {(V)(word & 0xfffff000u), (V)(word << 20 >> 1)};
}
// The upper 20 bits of a float, rounded to nearest; and 32 pseudo-random bits made from them and from the step.
inline U leading_bits(V m) { return ((U)m + 0x800u) & 0xfffff000u; }
inline U rounding_noise(const AdamRates& a, U bits) {
  const U x = bits ^ a.salt;
  return (x ^ x >> 15) * 0x85ebca6bu;
}
inline U packed(const AdamRates& a, const Moments& n) {
  const U m = leading_bits(n.m);
  return m | ((U)n.v + (rounding_noise(a, m) >> 13)) >> 19;
}
inline void store_moments(const AdamRates& a, uint32_t* p, const Moments& n, M set) {
  const V word = select(set, (V)packed(a, n), (V)load_words(p));
  __builtin_memcpy(p, &word, sizeof word);
}

inline Moments next_moments(const AdamRates& a, const Moments& n, V g) { return {fma(a.beta1, n.m, a.rest1 * g), fma(a.beta2, n.v, a.rest2 * g * g)}; }
inline V moved(const AdamRates& a, const R* rate, const Moments& n, V param) {
  return fnma(load(rate) * n.m, reciprocal(fma(sqrt(n.v), a.root_bias2, a.eps)), param);
}

inline void adam_lanes(const AdamRates& a, const R* rate, R* param, Packed* moments, V g) {
  const Moments n = next_moments(a, load_moments(moments), g);
  store_moments(a, moments, n, lanes_of((1u << W) - 1));
  store(param, moved(a, rate, n, load(param)));
}

inline bool row_finite(const R* row, int width) {
  R zero = 0;
  for (int k = 0; k < width; ++k) zero += row[k] * 0;
  return zero == 0;
}

struct AdamTensors {
  R* param;
  Packed* moments;
};

// n <= W rows of `width` values, copied to contiguous memory so that narrow rows fill whole vectors too; row i is ids[i].
template <int fixed>
inline int adam_narrow(const AdamRates& a, const AdamTensors& t, const uint32_t* ids, const R* grad, int n, int any_width) {
  const int width = fixed ? fixed : any_width;
  if (n < 1 || n > W || width < 1 || width > kAdamWidth) __builtin_unreachable();
  constexpr int kRoom = W * (fixed ? fixed : kAdamWidth);
  alignas(64) R p[kRoom], g[kRoom];
  alignas(64) Packed moments[kRoom];
  for (int i = 0; i < n; ++i) {
    const int64_t at = static_cast<int64_t>(ids[i]) * width;
    __builtin_memcpy(p + i * width, t.param + at, sizeof(R) * width);
    __builtin_memcpy(moments + i * width, t.moments + at, sizeof(Packed) * width);
  }
  __builtin_memcpy(g, grad, sizeof(R) * n * width);
  const int values = n * width;
  for (int i = values; i < (values + W - 1) / W * W; ++i) p[i] = g[i] = 0, moments[i] = {};
  for (int i = 0; i < values; i += W) adam_lanes(a, a.rate + i, p + i, moments + i, load(g + i));
  int bad = 0;
  for (int i = 0; i < n; ++i) {
    if (!row_finite(grad + i * width, width)) {
      ++bad;
      continue;
    }
    const int64_t at = static_cast<int64_t>(ids[i]) * width;
    __builtin_memcpy(t.param + at, p + i * width, sizeof(R) * width);
    __builtin_memcpy(t.moments + at, moments + i * width, sizeof(Packed) * width);
  }
  return bad;
}

inline void prefetch_row(const AdamTensors& t, int64_t at, int width) {
  constexpr int kLine = 64 / sizeof(R);
  for (int k = 0; k < width; k += kLine) __builtin_prefetch(t.param + at + k, 1), __builtin_prefetch(t.moments + at + k, 1);
}

inline void prefetch_grads(const R* grad, int values) {
  for (int k = 0; k < values; k += 64 / sizeof(R)) __builtin_prefetch(grad + k);
}

constexpr int kNarrowAhead = 256;

// n <= W rows: ids are their indices in the tensors, and grad has their gradients, contiguous. Returns how many rows were left alone.
inline int adam_group(const AdamRates& a, const AdamTensors& t, const uint32_t* ids, const R* grad, int n, int width) {
  if (width == 1) return adam_narrow<1>(a, t, ids, grad, n, 1);
  if (width == 3) return adam_narrow<3>(a, t, ids, grad, n, 3);
  if (width == 4) return adam_narrow<4>(a, t, ids, grad, n, 4);
  return adam_narrow<0>(a, t, ids, grad, n, width);
}

// The first and the last row that one thread updates.
struct OwnedRows {
  uint32_t first, last;
};

// Narrow rows ids[begin, end), updated in place, W rows of the tensor at a time; rows that are not in ids keep their values. At the first
// and the last W rows of `own` another thread may write to the same W rows, or the tensor may end: there single rows are updated.
template <int width>
inline int64_t adam_in_place(const AdamRates& a, const AdamTensors& t, const uint32_t* ids, const R* grad, int64_t begin, int64_t end, OwnedRows own) {
  int64_t bad = 0;
  for (int64_t r = begin, next; r < end; r = next) {
    const uint32_t base = ids[r] / W * W, rows = rows_from(base, ids + r, end - r);
    next = r + lane_count(rows);
    V g[width], zero = broadcast(0);
    const R* packed = grad + r * width;  // the named rows' gradients
    if (base + kNarrowAhead <= ids[end - 1]) prefetch_row(t, (base + int64_t{kNarrowAhead}) * width, W * width);
    if (r + kNarrowAhead < end) prefetch_grads(packed + kNarrowAhead * width, W * width);
    for (int k = 0; k < width; ++k) {
      const uint32_t set = bits(lanes_of_rows<width>(rows, k));
      g[k] = spread(set, packed), zero += g[k] * R(0);
      packed += lane_count(set);
    }
    if (base == own.first / W * W || base == own.last / W * W || any_nan(zero)) {
      bad += adam_narrow<width>(a, t, ids + r, grad + r * width, static_cast<int>(next - r), width);
      continue;
    }
    for (int k = 0; k < width; ++k) {
      const int64_t at = static_cast<int64_t>(base) * width + W * k;
      const M set = lanes_of_rows<width>(rows, k);
      const V param = load(t.param + at);
      const Moments n = next_moments(a, load_moments(t.moments + at), g[k]);
      store_moments(a, t.moments + at, n, set);
      store(t.param + at, select(set, moved(a, a.rate + W * k, n, param), param));
    }
  }
  return bad;
}

// Rows [begin, end) of one tensor; without ids row r is r, and `own` is not read.
int64_t adam_rows(const AdamRates& a, const AdamTensors& t, const R* grad, const uint32_t* ids, int64_t begin, int64_t end, int width, OwnedRows own) {
  if (W >= 8 && ids && width == 1) return adam_in_place<1>(a, t, ids, grad, begin, end, own);
  if (W >= 8 && ids && width == 3) return adam_in_place<3>(a, t, ids, grad, begin, end, own);
  if (W >= 8 && ids && width == 4) return adam_in_place<4>(a, t, ids, grad, begin, end, own);
  int64_t bad = 0;
  for (int64_t r = begin; r < end; r += W) {
    const int n = static_cast<int>(std::min<int64_t>(W, end - r));
    uint32_t all[W];
    for (int i = 0; i < n && !ids; ++i) all[i] = static_cast<uint32_t>(r + i);
    bad += adam_group(a, t, ids ? ids + r : all, grad + r * width, n, width);
  }
  return bad;
}

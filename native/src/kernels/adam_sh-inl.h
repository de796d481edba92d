// Adam on rows of SH coefficients. A row has one second moment (svrgs.h), that of its three values of degree 0. The reason: the gradient of
// coefficient k is basis_k(direction) dL/dcolour, and the mean of basis_k^2 over all directions is 1 / (4 pi) = basis_0^2 for every k.

using FirstMoment = std::conditional_t<sizeof(R) == 4, uint16_t, R>;  // float: the upper half of its bits

// A row of moments, in values of R: the first ones, then the second.
constexpr int sh_moments(int width) { return (width * int{sizeof(FirstMoment)} + int{sizeof(R)} - 1) / int{sizeof(R)} + 1; }

struct ShTensors {
  R *param, *moments;
};

inline void store_first_moments(const AdamRates&, double* p, V m) { __builtin_memcpy(p, &m, sizeof m); }
inline void store_first_moments(const AdamRates& a, uint16_t* p, V m) {  // stochastic rounding
  const U noise = rounding_noise(a, leading_bits(m)) >> 16;
  const Halves halves = __builtin_convertvector(((U)m + noise) >> 16, Halves);
  __builtin_memcpy(p, &halves, sizeof halves);
}

// n <= W coefficients; scale: 1 / (sqrt(v / bias2) + eps).
template <int n>
inline void adam_sh_lanes(const AdamRates& a, const R* rate, V scale, R* param, FirstMoment* first, const R* grad) {
  const V m = fma(a.beta1, load_first<n>(first), a.rest1 * load_first<n>(grad)), moved = fnma(load(rate) * m, scale, load_first<n>(param));
  if constexpr (n == W) {
    store_first_moments(a, first, m);
    store(param, moved);
  } else {
    FirstMoment m_spare[W];
    R spare[W];
    store_first_moments(a, m_spare, m);
    store(spare, moved);
    std::copy_n(m_spare, n, first);
    std::copy_n(spare, n, param);
  }
}

template <int width, int k = 0>
inline V times_zero(const R* row) {  // NaN where a value is not finite
  if constexpr (k < width)
    return load_first<std::min(W, width - k)>(row + k) * R(0) + times_zero<width, k + W>(row);
  else
    return broadcast(0);
}

template <int width, int k = 0>
inline void adam_sh_values(const AdamRates& a, V scale, R* param, FirstMoment* first, const R* grad) {
  if constexpr (k < width) {
    adam_sh_lanes<std::min(W, width - k)>(a, a.rate + k, scale, param + k, first + k, grad + k);
    adam_sh_values<width, k + W>(a, scale, param, first, grad);
  }
}

// Returns 1 if the gradient is not finite; the row is left alone then.
template <int width>
inline int adam_sh_row(const AdamRates& a, R* param, R* moments, const R* grad) {
  if (any_nan(times_zero<width>(grad))) return 1;
  R& v = moments[sh_moments(width) - 1];
  v = a.beta2[0] * v + a.rest2[0] * ((grad[0] * grad[0] + grad[1] * grad[1] + grad[2] * grad[2]) / 3);
  const V scale = broadcast(R(1) / (std::sqrt(v) * a.root_bias2[0] + a.eps[0]));
  adam_sh_values<width>(a, scale, param, reinterpret_cast<FirstMoment*>(moments), grad);
  return 0;
}

constexpr int kRowsAhead = 8, kGradsAhead = 16;

[[gnu::always_inline]] inline void prefetch_values(const R* p, int values, bool write) {
  for (int k = 0; k < values; k += 64 / sizeof(R)) write ? __builtin_prefetch(p + k, 1) : __builtin_prefetch(p + k);
  write ? __builtin_prefetch(p + values - 1, 1) : __builtin_prefetch(p + values - 1);
}

// n rows: ids are their indices in the tensors (null: row r is r), and grad has their gradients, contiguous. For prefetching there are
// `known` >= n ids and `ready` >= n gradients. Returns how many rows were left alone.
template <int width>
inline int64_t adam_sh_rows(const AdamRates& a, const ShTensors& t, const uint32_t* ids, int64_t known, const R* grad, int64_t ready, int64_t n) {
  const auto row = [&](int64_t i) { return ids ? int64_t{ids[i]} : i; };
  int64_t bad = 0;
  for (int64_t i = 0; i < n; ++i) {
    if (i + kRowsAhead < known) {
      prefetch_values(t.param + row(i + kRowsAhead) * width, width, true);
      prefetch_values(t.moments + row(i + kRowsAhead) * sh_moments(width), sh_moments(width), true);
    }
    if (i + kGradsAhead < ready) prefetch_values(grad + (i + kGradsAhead) * width, width, false);
    bad += adam_sh_row<width>(a, t.param + row(i) * width, t.moments + row(i) * sh_moments(width), grad + i * width);
  }
  return bad;
}

inline int64_t adam_sh_rows(const AdamRates& a, const ShTensors& t, const uint32_t* ids, int64_t known, const R* grad, int64_t ready, int64_t n, int width) {
  switch (width) {
    case 3: return adam_sh_rows<3>(a, t, ids, known, grad, ready, n);
    case 12: return adam_sh_rows<12>(a, t, ids, known, grad, ready, n);
    case 27: return adam_sh_rows<27>(a, t, ids, known, grad, ready, n);
    default: return adam_sh_rows<48>(a, t, ids, known, grad, ready, n);
  }
}

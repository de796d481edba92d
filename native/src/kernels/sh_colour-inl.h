// Stage 1b: SH colours of W Gaussians whose rows of coefficients are anywhere in memory.

constexpr int kShRowsAhead = 32;  // of those that may be seen, how many ahead SH rows are fetched

constexpr int kCoefficientsPerVector = W / 4;  // SH coefficients that lie side by side in a vector, three values each

// Adds basis_k sh_k of one Gaussian, for the coefficients from vector `block` on; the channels of a coefficient are in three adjacent
// lanes. Lanes 4 quad ... 4 quad + 3 of basis[k], k = 0, 4, 8 ..., hold this Gaussian's values of basis functions k ... k + 3.
template <int used, int quad, int block = 0>
inline V sh_sum(const V* basis, const R* row, V sum) {
  constexpr int first = block * kCoefficientsPerVector, left = 3 * (used - first);
  if constexpr (left <= 0) {
    return sum;
  } else {
    const V four = basis[first / 4 * 4],
            weights = shuffle(four, four, [](int lane) { return 4 * quad + first % 4 + std::min(lane / 3, kCoefficientsPerVector - 1); });
    V values;
    if constexpr (left >= W)
      values = load(row + 3 * first);
    else
      values = load_first<left>(row + 3 * first);
    return sh_sum<used, quad, block + 1>(basis, row, fma(weights, values, sum));
  }
}

// The same for W Gaussians; prefetches the rows of the Gaussians behind them.
template <int used, int quad = 0, class Row>
[[gnu::always_inline]] inline void sh_sums(const V* basis, Row row, V* sums) {
  if constexpr (quad < W / 4) {
    for (int i = 0; i < 4; ++i) {
      fetch<3 * used * sizeof(R)>(row(4 * quad + i + kShRowsAhead));
      sums[4 * quad + i] = sh_sum<used, quad>(basis + i, row(4 * quad + i), broadcast(0));
    }
    sh_sums<used, quad + 1>(basis, row, sums);
  }
}

// In each group of `size` lanes three of four are used. Adds the second half of the used lanes to the first, for a and for b; the
// results of a are put before those of b, in half as many lanes each.
template <int size>
constexpr int lane_of_half(int lane, int half) {
  const int group = lane / (size / 2), at = lane % (size / 2), counts = 3 * size / 8;
  return at < counts ? group % 2 * W + group / 2 * size + half * counts + at : -1;
}
template <int size>
inline V fold_pair(V a, V b) {
  return shuffle(a, b, [](int lane) { return lane_of_half<size>(lane, 0); }) + shuffle(a, b, [](int lane) { return lane_of_half<size>(lane, 1); });
}
// W rows of kCoefficientsPerVector coefficients, three values each, become their sums:
// the sums of rows i, i + 4, i + 8 ... are in rows[i], four lanes each.
template <int size = W>
[[gnu::always_inline]] inline void fold_rows(V* rows) {
  if constexpr (size > 4) {
    for (int i = 0; i < size / 2; ++i) rows[i] = fold_pair<size>(rows[i], rows[i + size / 2]);
    fold_rows<size / 2>(rows);
  }
}
// Lane `lane` of every group of four in rows[0..3], in the order of the original rows.
template <int lane>
inline V fourth(const V* rows) {
  constexpr auto pair = [](int l) { return l % 2 * W + l / 4 * 4 + lane; };
  return shuffle(shuffle(rows[0], rows[1], pair), shuffle(rows[2], rows[3], pair), [](int l) { return l % 4 < 2 ? l : W + l - 2; });
}

// Colours of W Gaussians before they are clamped at 0. Prefetches the rows of those behind them in `ids`.
template <int degree>
[[gnu::always_inline]] inline void colours(const Frame& f, const V direction[3], const uint32_t* ids, const R* sh, V rgb[3]) {
  constexpr int used = (degree + 1) * (degree + 1);
  const auto row = [&](int i) { return sh + static_cast<int64_t>(ids[i]) * f.sh_coefficients * 3; };
  V basis[kPaddedRow];
  sh_basis(degree, direction, basis);
  if constexpr (W >= 4) {
    for (int k = used; k < kPaddedRow; ++k) basis[k] = broadcast(0);
    for (int part = 0; part < used; part += W) transpose<2>(basis + part);
    V sums[W];
    sh_sums<used>(basis, row, sums);
    fold_rows(sums);
    rgb[0] = fourth<0>(sums), rgb[1] = fourth<1>(sums), rgb[2] = fourth<2>(sums);
  } else {
    for (int c = 0; c < 3; ++c) rgb[c] = broadcast(0);
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < used; ++k) rgb[c][0] += basis[k][0] * row(0)[3 * k + c];
  }
  for (int c = 0; c < 3; ++c) rgb[c] += R(0.5);  // last: what is summed is smaller, and rounds less
}

inline void colours(const Frame& f, const V direction[3], const uint32_t* ids, V rgb[3]) {
  const R* sh = static_cast<const R*>(f.sh);
  switch (f.sh_degree) {
    case 0: return colours<0>(f, direction, ids, sh, rgb);
    case 1: return colours<1>(f, direction, ids, sh, rgb);
    case 2: return colours<2>(f, direction, ids, sh, rgb);
    default: return colours<3>(f, direction, ids, sh, rgb);
  }
}

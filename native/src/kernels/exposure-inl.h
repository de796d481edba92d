// A 3 x 4 colour matrix, applied to pixels, and its gradients (svrgs_expose in svrgs.h).

// Three colours of n <= W pixels from `first` on; 0 where pixels do not count.
inline void counting_colours(const void* array, const uint8_t* valid, int64_t first, int n, V colours[3]) {
  columns_from<3>(array, first, n, colours);
  if (!valid) return;
  R counts[W] = {};
  for (int lane = 0; lane < n; ++lane) counts[lane] = valid[first + lane] ? R(1) : R(0);
  for (int k = 0; k < 3; ++k) colours[k] = keep(less(broadcast(0), load(counts)), colours[k]);
}

// Pixels [begin, end) of svrgs_expose.
void expose_range(const ExposureArguments& a, int64_t begin, int64_t end) {
  const auto entry = [&](int row, int column) { return broadcast(static_cast<R>(a.matrix[4 * row + column])); };
  for (int64_t i = begin; i < end; i += W) {
    const int n = static_cast<int>(std::min<int64_t>(W, end - i));
    V rgb[3], seen[3];
    columns_from<3>(a.rgb, i, n, rgb);
    for (int k = 0; k < 3; ++k) seen[k] = fma(rgb[0], entry(k, 0), fma(rgb[1], entry(k, 1), fma(rgb[2], entry(k, 2), entry(k, 3))));
    scatter<3>(a.out, i, n, seen);
    if (a.valid) {
      R* out = static_cast<R*>(a.out) + 3 * i;
      for (int lane = 0; lane < n; ++lane)
        if (!a.valid[i + lane]) std::fill_n(out + 3 * lane, 3, R(0));
    }
  }
}

// Pixels [begin, end) of svrgs_expose_vjp. Adds to d_matrix.
void expose_vjp_range(const ExposureArguments& a, int64_t begin, int64_t end, double d_matrix[12]) {
  const auto entry = [&](int row, int column) { return broadcast(static_cast<R>(a.matrix[4 * row + column])); };
  V sums[12];
  for (V& one : sums) one = broadcast(0);
  for (int64_t i = begin; i < end; i += W) {
    const int n = static_cast<int>(std::min<int64_t>(W, end - i));
    V rgb[3], d_seen[3], d_rgb[3];
    columns_from<3>(a.rgb, i, n, rgb), counting_colours(a.d_seen, a.valid, i, n, d_seen);
    for (int k = 0; k < 3; ++k) {
      for (int j = 0; j < 3; ++j) sums[4 * k + j] = fma(d_seen[k], rgb[j], sums[4 * k + j]);
      sums[4 * k + 3] = sums[4 * k + 3] + d_seen[k];
    }
    for (int j = 0; j < 3; ++j) d_rgb[j] = fma(d_seen[0], entry(0, j), fma(d_seen[1], entry(1, j), d_seen[2] * entry(2, j)));
    scatter<3>(a.out, i, n, d_rgb);
  }
  for (int k = 0; k < 12; ++k) d_matrix[k] += static_cast<double>(sum(sums[k]));
}

// Display colours, in sRGB, to linear ones.

inline V power(V x, V exponent) { return exp2(log2(max(x, broadcast(R(1e-30)))) * exponent); }
inline V linear(V srgb) {
  const V curve = power((srgb + broadcast(R(0.055))) * broadcast(R(1 / 1.055)), broadcast(R(2.4)));
  return select(less(broadcast(R(0.04045)), srgb), curve, srgb * broadcast(R(1 / 12.92)));
}

constexpr R kBrightest = R(1e15);  // the linear value of a brighter one would not be finite

// Pixels [begin, end) of svrgs_linear_rgba.
void linear_range(const LinearArguments& a, int64_t begin, int64_t end) {
  const auto share = [&](int from, int to) { return broadcast(static_cast<R>(a.working_space[3 * from + to])); };
  for (int64_t i = begin; i < end; i += W) {
    const int n = static_cast<int>(std::min<int64_t>(W, end - i));
    V alpha, rgb[3], rgba[4];
    columns_from<1>(a.alpha, i, n, &alpha), columns_from<3>(a.rgb, i, n, rgb);
    const M shown = less(broadcast(0), alpha);
    for (V& channel : rgb) channel = linear(min(keep(shown, channel / select(shown, alpha, broadcast(1))), broadcast(kBrightest)));
    for (int k = 0; k < 3; ++k) rgba[k] = fma(rgb[0], share(0, k), fma(rgb[1], share(1, k), rgb[2] * share(2, k))) * alpha;
    rgba[3] = alpha;
    scatter<4>(a.rgba, i, n, rgba);
  }
}

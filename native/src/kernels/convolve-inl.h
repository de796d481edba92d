// A layer of VGG16: 3 x 3 filters, zeros around the image, then ReLU (svrgs_convolve in svrgs.h).
//
// A filter's row of three taps is a dot product with 3 * inputs values that stand side by side in a row of the image. Sums of some pixels and
// some vectors of output channels stay in registers.

constexpr int kConvolveVectors = 2, kConvolvePixels = W == 16 ? 12 : 6;
constexpr int64_t kConvolveValues = 192;  // of a filter, for which a row of the image is gone through: a cache of 32 KiB holds them
static_assert(kConvolvePanel % (kConvolveVectors * W) == 0);

// Adds to the sums of P neighbouring pixels, for kConvolveVectors * W output channels, the products of `count` values of each with a filter.
template <int P>
void add_products(const ConvolveArguments& a, const R* values, int64_t count, const R* filters, R* sums) {
  V s[P][kConvolveVectors];
  for (int p = 0; p < P; ++p)
    for (int v = 0; v < kConvolveVectors; ++v) s[p][v] = load(sums + p * a.outputs + v * W);
  for (int64_t i = 0; i < count; ++i, filters += kConvolvePanel) {
    V f[kConvolveVectors];
    for (int v = 0; v < kConvolveVectors; ++v) f[v] = load(filters + v * W);
#pragma GCC unroll 12
    for (int p = 0; p < P; ++p) {
      const V value = broadcast(values[p * a.inputs + i]);
      for (int v = 0; v < kConvolveVectors; ++v) s[p][v] = fma(value, f[v], s[p][v]);
    }
  }
  for (int p = 0; p < P; ++p)
    for (int v = 0; v < kConvolveVectors; ++v) store(sums + p * a.outputs + v * W, s[p][v]);
}

// What the values [begin, end) of the three taps of a row of the image give to a row of sums.
void add_row(const ConvolveArguments& a, int64_t begin, int64_t end, const R* image, const R* filters, R* sums) {
  const int64_t n = a.inputs, last = a.width - 1;
  const auto edge = [&](int64_t x) {
    const int64_t from = std::max(begin, x == 0 ? n : 0), to = std::min(end, x == last ? 2 * n : 3 * n);
    add_products<1>(a, image + (x - 1) * n + from, to - from, filters + from * kConvolvePanel, sums + x * a.outputs);
  };
  edge(0);
  int64_t x = 1;
  for (; x + kConvolvePixels <= last; x += kConvolvePixels)
    add_products<kConvolvePixels>(a, image + (x - 1) * n + begin, end - begin, filters + begin * kConvolvePanel, sums + x * a.outputs);
  for (; x <= last; ++x) edge(x);
}

// One row of pixels and one panel of output channels.
void convolve_row(const ConvolveArguments& a, int64_t y, int64_t panel) {
  const R *const image = static_cast<const R*>(a.image), *const bias = static_cast<const R*>(a.bias) + panel * kConvolvePanel;
  const R* const filters = static_cast<const R*>(a.filters) + panel * kConvolvePanel * 9 * a.inputs;
  R* const out = static_cast<R*>(a.out) + y * a.width * a.outputs + panel * kConvolvePanel;
  for (int64_t x = 0; x < a.width; ++x) std::copy_n(bias, kConvolvePanel, out + x * a.outputs);
  for (int64_t row = std::max<int64_t>(y - 1, 0); row <= std::min(y + 1, a.height - 1); ++row)
    for (int64_t begin = 0; begin < 3 * a.inputs; begin += kConvolveValues)
      for (int c = 0; c < kConvolvePanel; c += kConvolveVectors * W)
        add_row(a, begin, std::min(begin + kConvolveValues, 3 * a.inputs), image + row * a.width * a.inputs,
                filters + (row - y + 1) * 3 * a.inputs * kConvolvePanel + c, out + c);
  for (int64_t x = 0; x < a.width; ++x)
    for (int c = 0; c < kConvolvePanel; c += W) store(out + x * a.outputs + c, max(load(out + x * a.outputs + c), broadcast(0)));
}

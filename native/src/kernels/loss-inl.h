// L1 + SSIM with gradient. A tile of the image is processed in blocks of kLossBlockRows rows: first the four products whose blurs make
// SSIM, then the three maps of SSIM's derivatives, then the gradient. A blur needs two blocks, so two blocks of products and maps are
// stored; they fit into the core's cache. A tile also computes the pixels around it that it needs, so tiles are independent.
//
// Rows are interleaved RGB: one pixel is three values, a horizontal tap is a step of three.

constexpr int kBlurRadius = 5, kLossBlockRows = 2 * kBlurRadius;
constexpr int kLossHalo = 16;     // 3 * kBlurRadius values, rounded up to whole vectors
constexpr int kLossProducts = 4;  // x, y, x^2 + y^2 and x y
constexpr int kLossMaps = 3;      // dL/d of the blurred x, x^2 and x y
// A row has 2 * kLossHalo more values to the left of the tile and as many to the right; then kLossHalo more, which make it an odd number of
// vectors, so that the values of a column are spread over the cache.
constexpr int kLossStride = kLossTileValues + 5 * kLossHalo;
constexpr int kLossBlockValues = kLossBlockRows * kLossStride;
constexpr R kC1Ssim = R(1e-4), kC2Ssim = R(9e-4);
static_assert(kLossTileValues % (2 * kLossHalo) == 0 && kLossHalo % W == 0);

struct Window {
  R tap[kBlurRadius + 1];  // tap[k]: weight at distance k
};

inline Window gaussian_window() {
  double raw[kBlurRadius + 1], total = 0;
  for (int k = 0; k <= kBlurRadius; ++k) {
    raw[k] = std::exp(-k * k / (2 * 1.5 * 1.5));
    total += k ? 2 * raw[k] : raw[k];
  }
  Window w;
  for (int k = 0; k <= kBlurRadius; ++k) w.tap[k] = static_cast<R>(raw[k] / total);
  return w;
}

// The window is passed by value: given a reference, the compiler would read it again after every store of a vector. Most taps come from two
// aligned loads and a shuffle, which occupies an arithmetic unit. Three taps are loaded unaligned instead: the load units have time left.
inline V blur_horizontally(Window w, const R* at) {
  V s = broadcast(w.tap[0]) * load(at);
  s = fma(broadcast(w.tap[1]), load(at - 3) + load_at<3>(at), s);
  s = fma(broadcast(w.tap[2]), load_at<-6>(at) + load(at + 6), s);
  s = fma(broadcast(w.tap[3]), load(at - 9) + load_at<9>(at), s);
  s = fma(broadcast(w.tap[4]), load_at<-12>(at) + load_at<12>(at), s);
  return fma(broadcast(w.tap[5]), load_at<-15>(at) + load_at<15>(at), s);
}

// Blurs the rows from the middle of block `above` to the middle of block `below`. A column is loaded once for all of its rows.
void blur_vertically(Window w, const R* above, const R* below, int64_t values, R* out) {
  for (int64_t i = 0; i < values; i += W) {
    V row[2 * kLossBlockRows];
#pragma GCC unroll 10
    for (int k = 0; k < kLossBlockRows; ++k) row[k] = load(above + k * kLossStride + i), row[kLossBlockRows + k] = load(below + k * kLossStride + i);
#pragma GCC unroll 10
    for (int y = 0; y < kLossBlockRows; ++y) {
      const V* middle = row + kBlurRadius + y;
      V s = broadcast(w.tap[0]) * middle[0];
#pragma GCC unroll 5
      for (int k = 1; k <= kBlurRadius; ++k) s = fma(broadcast(w.tap[k]), middle[-k] + middle[k], s);
      store(out + y * kLossStride + i, s);
    }
  }
}

// SSIM of the lanes from blurred products, and its derivatives with respect to the blurred x, x^2 and x y.
struct Ssim {
  V value, d_mean, d_square, d_product;
};

inline Ssim ssim(V mx, V my, V squares, V xy) {
  const V two = broadcast(2), c1 = broadcast(kC1Ssim), c2 = broadcast(kC2Ssim);
  const V a1 = fma(two * mx, my, c1), a2 = fma(two, fnma(mx, my, xy), c2);
  const V b1 = fma(mx, mx, fma(my, my, c1)), b2 = fnma(mx, mx, fnma(my, my, squares)) + c2;
  const V inv = reciprocal(b1 * b2), s = a1 * a2 * inv;
  return {s, two * inv * (my * (a2 - a1) - mx * s * (b2 - b1)), -s * b1 * inv, two * a1 * inv};
}

struct Picture {
  const R* values;
  int64_t height, row;  // row: values in a row

  // Prefetches; harmless outside.
  void fetch(int64_t y, int64_t i) const { __builtin_prefetch(values + y * row + i); }

  // W values; zero outside.
  V at(int64_t y, int64_t i) const {
    V v = broadcast(0);
    if (y < 0 || y >= height || i < 0) return v;
    if (i + W <= row) return load(values + y * row + i);
    for (int k = 0; i + k < row; ++k) v[k] = values[y * row + i + k];
    return v;
  }
};

struct LossTile {
  Picture image, target;
  R* grad;
  int64_t y0, y1, i0, i1;  // rows [y0, y1), values [i0, i1) of each
  R l1_scale, ssim_scale;  // dL/d of each value's |difference| and of each value's SSIM
  R* blurred;              // kLossProducts blocks
  double l1, ssim;
};

// The products of rows y ... y + kLossBlockRows.
void loss_products(const LossTile& t, int64_t y, R* out) {
  const Picture image = t.image, target = t.target;
  const int64_t first = t.i0 - 2 * kLossHalo, end = t.i1 + 2 * kLossHalo;
  for (int r = 0; r < kLossBlockRows; ++r, ++y, out += kLossStride)
    for (int64_t i = first; i < end; i += W) {
      image.fetch(y + kLossBlockRows, i), target.fetch(y + kLossBlockRows, i);  // the next block: the rows of a tile are too short for the processor to foresee
      const V a = image.at(y, i), b = target.at(y, i);
      R* to = out + i - first;
      store(to, a), store(to + kLossBlockValues, b), store(to + 2 * kLossBlockValues, fma(a, a, b * b)), store(to + 3 * kLossBlockValues, a * b);
    }
}

// The maps of rows y ... y + kLossBlockRows from the vertically blurred products; adds the tile's own values to its sums.
void loss_maps(LossTile& t, Window w, int64_t y, R* maps) {
  using Total = std::conditional_t<W >= 8, V, D>;  // of a lane in a row: too many values for float where lanes are few
  const Picture image = t.image, target = t.target;
  const int64_t i0 = t.i0, i1 = t.i1, row = image.row;
  const V scale = broadcast(t.ssim_scale);
  V lanes;
  for (int k = 0; k < W; ++k) lanes[k] = static_cast<R>(k);
  for (int r = 0; r < kLossBlockRows; ++r, ++y) {
    const bool inside = y >= 0 && y < image.height;
    const int64_t own = y >= t.y0 && y < t.y1 ? i0 : i1;
    Total l1 = {}, total = {};
    for (int64_t i = i0 - kLossHalo, at = r * kLossStride + kLossHalo; i < i1 + kLossHalo; i += W, at += W) {
      const R* from = t.blurred + at;
      Ssim s = ssim(blur_horizontally(w, from), blur_horizontally(w, from + kLossBlockValues), blur_horizontally(w, from + 2 * kLossBlockValues),
                    blur_horizontally(w, from + 3 * kLossBlockValues));
      if (!inside || i < 0 || i + W > row) {
        const M seen = less(lanes, broadcast(inside && i >= 0 ? static_cast<R>(row - i) : 0));
        s = {keep(seen, s.value), keep(seen, s.d_mean), keep(seen, s.d_square), keep(seen, s.d_product)};
      }
      if (i >= own && i < i1) {
        l1 += __builtin_convertvector(magnitude(image.at(y, i) - target.at(y, i)), Total);
        total += __builtin_convertvector(s.value, Total);
      }
      store(maps + at, scale * s.d_mean), store(maps + kLossBlockValues + at, scale * s.d_square), store(maps + 2 * kLossBlockValues + at, scale * s.d_product);
    }
#pragma GCC unroll 16
    for (int k = 0; k < W; ++k) t.l1 += static_cast<double>(l1[k]), t.ssim += static_cast<double>(total[k]);
  }
}

// dL/dimage of rows y ... y + kLossBlockRows from the vertically blurred maps: the blur is its own adjoint.
void loss_grads(const LossTile& t, Window w, int64_t y) {
  const Picture image = t.image, target = t.target;
  const int64_t i0 = t.i0, i1 = t.i1, row = image.row, end = std::min(y + kLossBlockRows, t.y1);
  const V up = broadcast(t.l1_scale);
  const R* from = t.blurred + 2 * kLossHalo - i0;
  for (; y < end; ++y, from += kLossStride)
    for (int64_t i = i0; i < i1; i += W) {
      const V a = image.at(y, i), b = target.at(y, i), d = a - b;
      V g = blur_horizontally(w, from + i);
      g = fma(a + a, blur_horizontally(w, from + kLossBlockValues + i), g);
      g = fma(b, blur_horizontally(w, from + 2 * kLossBlockValues + i), g);
      g = add_if(less(broadcast(0), d), g, up);
      g = add_if(less(d, broadcast(0)), g, -up);
      R* out = t.grad + y * row + i;
      if (i + W <= row)
        store(out, g);
      else
        for (int k = 0; i + k < row; ++k) out[k] = g[k];
    }
}

constexpr int kLossScratch = (2 * kLossProducts + 2 * kLossMaps + kLossProducts) * kLossBlockValues;  // two blocks of each, and the blurred one

void loss_tile(LossTile& t, R* scratch) {
  const Window w = gaussian_window();
  R* products[2] = {scratch, scratch + kLossProducts * kLossBlockValues};
  R* maps[2] = {scratch + 2 * kLossProducts * kLossBlockValues, scratch + (2 * kLossProducts + kLossMaps) * kLossBlockValues};
  t.blurred = scratch + 2 * (kLossProducts + kLossMaps) * kLossBlockValues;
  const int64_t values = t.i1 - t.i0 + 4 * kLossHalo;
  loss_products(t, t.y0 - kLossBlockRows, products[0]);
  for (int64_t y = t.y0, step = 1; y < t.y1 + kLossBlockRows; y += kLossBlockRows, ++step) {  // maps lag half a block behind products, gradients a whole one
    R *above = products[(step - 1) % 2], *below = products[step % 2], *map = maps[step % 2];
    loss_products(t, y, below);
    for (int p = 0; p < kLossProducts; ++p)
      blur_vertically(w, above + p * kLossBlockValues, below + p * kLossBlockValues, values, t.blurred + p * kLossBlockValues);
    loss_maps(t, w, y - kBlurRadius, map);
    if (step == 1 || !t.grad) continue;
    for (int m = 0; m < kLossMaps; ++m)
      blur_vertically(w, maps[(step - 1) % 2] + m * kLossBlockValues + kLossHalo, map + m * kLossBlockValues + kLossHalo, values - 2 * kLossHalo,
                      t.blurred + m * kLossBlockValues + kLossHalo);
    loss_grads(t, w, y - kLossBlockRows);
  }
}

// The sum of F^2 over values [begin, end) of `mask`; grad receives `scale` times F.
double mask_loss_range(const void* mask, double scale, int64_t begin, int64_t end, void* grad) {
  const R *from = static_cast<const R*>(mask), by = static_cast<R>(scale);
  R* const to = static_cast<R*>(grad);
  D lanes = {};
  int64_t i = begin;
  for (; i + W <= end; i += W) {
    const V F = load(from + i);
    lanes += __builtin_convertvector(F * F, D);
    store(to + i, broadcast(by) * F);
  }
  double sum = 0;
  for (int k = 0; k < W; ++k) sum += lanes[k];
  for (; i < end; ++i) sum += static_cast<double>(from[i] * from[i]), to[i] = by * from[i];
  return sum;
}

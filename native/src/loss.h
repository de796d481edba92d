// L1 + SSIM with gradient. Each output row is blurred vertically from 11 input rows, then horizontally, so nothing is
// computed twice. Rows are interleaved RGB: one pixel is three values, a horizontal tap is a step of three.

constexpr int kRadius = 5, kTaps = 2 * kRadius + 1, kPad = 3 * kRadius;
constexpr R kC1Ssim = R(1e-4), kC2Ssim = R(9e-4);

struct Window {
  R tap[kRadius + 1];  // tap[k]: weight at distance k
};

inline Window gaussian_window() {
  double raw[kRadius + 1], total = 0;
  for (int k = 0; k <= kRadius; ++k) {
    raw[k] = std::exp(-k * k / (2 * 1.5 * 1.5));
    total += k ? 2 * raw[k] : raw[k];
  }
  Window w;
  for (int k = 0; k <= kRadius; ++k) w.tap[k] = static_cast<R>(raw[k] / total);
  return w;
}

// A blurred row in progress: kPad zeros, `row` values rounded up to whole vectors, kPad + W zeros.
inline V blur_horizontally(const Window& w, const R* padded, int64_t at) {
  V s = splat(w.tap[0]) * load(padded + at);
  for (int k = 1; k <= kRadius; ++k) s = fma(splat(w.tap[k]), load(padded + at - 3 * k) + load(padded + at + 3 * k), s);
  return s;
}

inline V load_tail(const R* p, int64_t left) {
  if (left >= W) return load(p);
  V v = splat(0);
  for (int i = 0; i < left; ++i) v[i] = p[i];
  return v;
}

inline void store_tail(R* p, V v, int64_t left) {
  if (left >= W) return store(p, v);
  for (int i = 0; i < left; ++i) p[i] = v[i];
}

struct LossJob {
  const R *image, *target;
  int height, width;
  R l1_scale, ssim_scale;  // dL/d of each value's |difference| and of each value's SSIM
  R *d_mean, *d_square, *d_product;  // (H, stride): dL/d of blurred x, x^2, x y
  R* grad;
  double *row_l1, *row_ssim;
  int64_t row() const { return 3 * static_cast<int64_t>(width); }
};

inline int64_t padded_row(int width) { return 2 * kPad + 3 * static_cast<int64_t>(width) + 2 * W; }

// SSIM of the lanes, and its derivatives with respect to the blurred x, x^2 and x y.
struct Ssim {
  V value, d_mean, d_square, d_product;
};

inline Ssim ssim(V mx, V my, V xx, V yy, V xy) {
  const V two = splat(2), a1 = two * mx * my + splat(kC1Ssim), a2 = two * (xy - mx * my) + splat(kC2Ssim);
  const V b1 = mx * mx + my * my + splat(kC1Ssim), b2 = (xx - mx * mx) + (yy - my * my) + splat(kC2Ssim);
  const V inv = splat(1) / (b1 * b2), s = a1 * a2 * inv;
  return {s, two * (my * (a2 - a1) * inv - mx * s * (b2 - b1) * inv), -s * b1 * inv, two * a1 * inv};
}

// Pass 1, one row: values, and the derivative maps if a gradient is wanted. scratch: 5 padded rows, zeroed.
void loss_row(const LossJob& j, int y, R* scratch) {
  const Window w = gaussian_window();
  const int64_t row = j.row(), pad = padded_row(j.width);
  for (int64_t i = 0; i < row; i += W) {
    V s[5] = {};
    for (int k = -kRadius; k <= kRadius; ++k) {
      if (y + k < 0 || y + k >= j.height) continue;
      const V t = splat(w.tap[k < 0 ? -k : k]);
      const V a = load_tail(j.image + (y + k) * row + i, row - i), b = load_tail(j.target + (y + k) * row + i, row - i);
      const V ta = t * a, tb = t * b;
      s[0] += ta, s[1] += tb;
      s[2] = fma(ta, a, s[2]), s[3] = fma(tb, b, s[3]), s[4] = fma(ta, b, s[4]);
    }
    for (int m = 0; m < 5; ++m) store_tail(scratch + m * pad + kPad + i, s[m], row - i);
  }
  double l1 = 0, total = 0;
  for (int64_t i = 0; i < row; i += W) {
    V m[5];
    for (int k = 0; k < 5; ++k) m[k] = blur_horizontally(w, scratch + k * pad, kPad + i);
    const Ssim s = ssim(m[0], m[1], m[2], m[3], m[4]);
    const V d = load_tail(j.image + y * row + i, row - i) - load_tail(j.target + y * row + i, row - i);
    const int n = static_cast<int>(std::min<int64_t>(W, row - i));
    l1 += static_cast<double>(sum(max(d, -d)));
    if (n == W) total += static_cast<double>(sum(s.value));
    else for (int k = 0; k < n; ++k) total += static_cast<double>(s.value[k]);
    if (!j.grad) continue;
    const V g = splat(j.ssim_scale);
    store_tail(j.d_mean + y * row + i, g * s.d_mean, row - i);
    store_tail(j.d_square + y * row + i, g * s.d_square, row - i);
    store_tail(j.d_product + y * row + i, g * s.d_product, row - i);
  }
  j.row_l1[y] = l1, j.row_ssim[y] = total;
}

// Pass 2, one row of dL/dimage: the blur is its own adjoint. scratch: 3 padded rows, zeroed.
void loss_grad_row(const LossJob& j, int y, R* scratch) {
  const Window w = gaussian_window();
  const int64_t row = j.row(), pad = padded_row(j.width);
  const R* maps[3] = {j.d_mean, j.d_square, j.d_product};
  for (int m = 0; m < 3; ++m)
    for (int64_t i = 0; i < row; i += W) {
      V s = splat(0);
      for (int k = -kRadius; k <= kRadius; ++k)
        if (y + k >= 0 && y + k < j.height) s = fma(splat(w.tap[k < 0 ? -k : k]), load_tail(maps[m] + (y + k) * row + i, row - i), s);
      store_tail(scratch + m * pad + kPad + i, s, row - i);
    }
  for (int64_t i = 0; i < row; i += W) {
    const V a = load_tail(j.image + y * row + i, row - i), b = load_tail(j.target + y * row + i, row - i), d = a - b;
    V g = blur_horizontally(w, scratch, kPad + i);
    g = fma(splat(2) * a, blur_horizontally(w, scratch + pad, kPad + i), g);
    g = fma(b, blur_horizontally(w, scratch + 2 * pad, kPad + i), g);
    g = add_if(less(splat(0), d), g, splat(j.l1_scale));
    g = add_if(less(d, splat(0)), g, splat(-j.l1_scale));
    store_tail(j.grad + y * row + i, g, row - i);
  }
}

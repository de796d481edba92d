// One batch of W Gaussians from world to screen, and back (projection and its vector-Jacobian product, side by side).
// Equations: 3DGS Eq. 5-6 (covariance, EWA projection), with the full K and the 3DGS clamp of x/z, y/z. Where rays are parallel
// (Frame::orthographic), 1 stands for 1/z, and x/z, y/z within the Jacobian are 0.

struct Batch {  // raw parameters of W Gaussians, transposed
  D offset[3];  // mean from the camera centre
  V mean[3];    // the same, rounded
  V log_scale[3], quat[4], opacity_logit;
};

constexpr int kNumbers = 11;  // of a Gaussian, SH aside: mean 3, log-scale 3, quaternion 4, opacity

inline Batch batch_of(const Frame& f, const V numbers[kNumbers]) {
  Batch b;
  for (int k = 0; k < 3; ++k) {
    b.offset[k] = wide(numbers[k]) - f.position[k];
    b.mean[k] = narrow(b.offset[k]), b.log_scale[k] = numbers[3 + k];
  }
  for (int k = 0; k < 4; ++k) b.quat[k] = numbers[6 + k];
  b.opacity_logit = numbers[10];
  return b;
}

inline Batch load_batch(const Frame& f, const uint32_t* ids) {
  const R *means = static_cast<const R*>(f.means), *scales = static_cast<const R*>(f.log_scales),
          *quats = static_cast<const R*>(f.quats), *logits = static_cast<const R*>(f.opacity_logits);
  alignas(64) R rows[W * kRow] = {};
  for (int i = 0; i < W; ++i) {
    const int64_t g = ids[i];
    R* const row = rows + kRow * i;
    std::copy_n(means + 3 * g, 3, row), std::copy_n(scales + 3 * g, 3, row + 3), std::copy_n(quats + 4 * g, 4, row + 6);
    row[10] = logits[g];
  }
  V numbers[kRow];
  columns_of_rows<kNumbers>(rows, numbers);
  return batch_of(f, numbers);
}

struct Projected {
  V c[3];                    // camera-space centre
  V ratio_x, ratio_y;        // x/z, y/z clamped to the widened frustum
  V free_x, free_y;          // 1 where not clamped
  V scale[3], quat[4], inv_norm;
  V rotation[3][3];          // of the Gaussian
  V to_screen[2][3];         // P = J W, 2x3
  V factor[2][3];            // A = P R S: covariance before blur = A A^T
  V cxx, cxy, cyy;           // covariance after blur, pixels^2
  V det, det_before;         // of it, and before blur
  V compensation;            // 1, or sqrt(det_before / det)
  V opacity;                 // sigmoid, without compensation
};

inline void rotation_matrix(const V q[4], V m[3][3]) {
  const V w = q[0], x = q[1], y = q[2], z = q[3], x2 = x + x, y2 = y + y, z2 = z + z, one = splat(1);
  const V rest = fnma(x, x2, one), yy = y * y2, xy = x * y2, xz = x * z2, yz = y * z2;
  m[0][0] = fnma(z, z2, one - yy), m[0][1] = fnma(w, z2, xy), m[0][2] = fma(w, y2, xz);
  m[1][0] = fma(w, z2, xy), m[1][1] = fnma(z, z2, rest), m[1][2] = fnma(w, x2, yz);
  m[2][0] = fnma(w, y2, xz), m[2][1] = fma(w, x2, yz), m[2][2] = rest - yy;
}

// The camera in the level's type, made once for many Gaussians.
struct Eye {
  R axis[3][3];                      // rows of the view rotation
  R position[3], position_rest[3];   // together the camera centre
  R fx, fy;
  R low_x, high_x, low_y, high_y;    // x/z, y/z are clamped between these where the Jacobian is taken
  bool orthographic, antialiased;

  explicit Eye(const Frame& f) : fx(R(f.fx)), fy(R(f.fy)), orthographic(f.orthographic), antialiased(f.antialiased) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) axis[i][j] = static_cast<R>(f.viewmat[4 * i + j]);
      position[i] = static_cast<R>(f.position[i]), position_rest[i] = static_cast<R>(f.position[i] - static_cast<double>(position[i]));
    }
    const double margin_x = kFrustumMargin * f.width / (2 * f.fx), margin_y = kFrustumMargin * f.height / (2 * f.fy);
    low_x = R(-f.cx / f.fx - margin_x), high_x = R((f.width - f.cx) / f.fx + margin_x);
    low_y = R(-f.cy / f.fy - margin_y), high_y = R((f.height - f.cy) / f.fy + margin_y);
  }

  V view(int row, int column) const { return splat(axis[row][column]); }
  V along(int row, const V v[3]) const { return fma(view(row, 0), v[0], fma(view(row, 1), v[1], view(row, 2) * v[2])); }
  V inverse_depth(V z) const { return orthographic ? splat(1) : reciprocal(z); }
};

inline void clamp_ratios(const Eye& e, V inv_z, Projected& p) {
  if (e.orthographic) {
    p.ratio_x = p.ratio_y = p.free_x = p.free_y = splat(0);
    return;
  }
  const V rx = p.c[0] * inv_z, ry = p.c[1] * inv_z;
  p.ratio_x = clamp(rx, splat(e.low_x), splat(e.high_x));
  p.ratio_y = clamp(ry, splat(e.low_y), splat(e.high_y));
  p.free_x = select(both(at_least(rx, p.ratio_x), at_least(p.ratio_x, rx)), splat(1), splat(0));
  p.free_y = select(both(at_least(ry, p.ratio_y), at_least(p.ratio_y, ry)), splat(1), splat(0));
}

[[gnu::always_inline]] inline Projected project(const Eye& e, const Batch& b) {
  Projected p;
  for (int i = 0; i < 3; ++i) p.c[i] = e.along(i, b.mean);
  const V inv_z = e.inverse_depth(p.c[2]), fx = splat(e.fx), fy = splat(e.fy);
  clamp_ratios(e, inv_z, p);

  V norm2 = splat(0);
  for (int k = 0; k < 4; ++k) norm2 = fma(b.quat[k], b.quat[k], norm2);
  p.inv_norm = reciprocal(sqrt(norm2));
  for (int k = 0; k < 4; ++k) p.quat[k] = b.quat[k] * p.inv_norm;
  for (int k = 0; k < 3; ++k) p.scale[k] = exp(b.log_scale[k]);
  rotation_matrix(p.quat, p.rotation);

  for (int j = 0; j < 3; ++j) {
    p.to_screen[0][j] = fx * inv_z * fnma(p.ratio_x, e.view(2, j), e.view(0, j));
    p.to_screen[1][j] = fy * inv_z * fnma(p.ratio_y, e.view(2, j), e.view(1, j));
  }
  for (int r = 0; r < 2; ++r)
    for (int j = 0; j < 3; ++j) {
      V a = p.to_screen[r][0] * p.rotation[0][j];
      a = fma(p.to_screen[r][1], p.rotation[1][j], a);
      a = fma(p.to_screen[r][2], p.rotation[2][j], a);
      p.factor[r][j] = a * p.scale[j];
    }
  const V *u = p.factor[0], *v = p.factor[1], blur = splat(R(kBlur));
  const V uu = fma(u[0], u[0], fma(u[1], u[1], u[2] * u[2])), vv = fma(v[0], v[0], fma(v[1], v[1], v[2] * v[2]));
  p.cxx = uu + blur, p.cyy = vv + blur;
  p.cxy = fma(u[0], v[0], fma(u[1], v[1], u[2] * v[2]));
  // det(A A^T) = |u x v|^2: a sum of squares, no cancellation for needles
  const V x0 = u[1] * v[2] - u[2] * v[1], x1 = u[2] * v[0] - u[0] * v[2], x2 = u[0] * v[1] - u[1] * v[0];
  p.det_before = fma(x0, x0, fma(x1, x1, x2 * x2));
  p.det = p.det_before + blur * (uu + vv) + blur * blur;
  p.opacity = sigmoid(b.opacity_logit);
  p.compensation = splat(1);
  if (e.antialiased) p.compensation = sqrt(max(splat(R(kCompensationFloor)), p.det_before / p.det));
  return p;
}

// The Cholesky factor L of the conic, scaled so that alpha = opacity 2^-(u^2 + v^2) with (u, v) = L (dx, dy): u = l11 dx + l12 dy,
// v = l22 dy. The inverse covariance is kWhiten^2 L^T L.
constexpr R kWhiten = R(1.1774100225154747);  // sqrt(2 ln 2)

struct Whitening {
  V l11, l12, l22, inv_l11, ratio;  // ratio: -l12 / l11
};

inline Whitening whitening(const Projected& p) {
  const V root = sqrt(p.cyy), root_det = splat(kWhiten) * sqrt(p.det);
  Whitening l;
  l.l11 = root * reciprocal(root_det), l.l22 = reciprocal(splat(kWhiten) * root);
  l.inv_l11 = root_det * (kWhiten * l.l22);
  l.ratio = p.cxy / p.cyy, l.l12 = -l.l11 * l.ratio;  // divided: u of a long thin ellipse hangs on it
  return l;
}

// dL/d of one batch: what the raster pass sums (moments of g = alpha dL/dalpha in u, v; enum Slot) ...
struct ScreenGrads {
  V g, gu, gv, guu, guv, gvv;
  V depth;  // dL/d camera z from the depth image
};
// ... and what it means for the parameters.
struct ParameterGrads {
  V mean[3], log_scale[3], quat[4], opacity_logit, mean2d[2];
};

// dL/dR of a rotation matrix to dL/dquat of the unit quaternion it came from.
inline void rotation_matrix_vjp(const V q[4], const V d[3][3], V out[4]) {
  const V w = q[0], x = q[1], y = q[2], z = q[3], two = splat(2), four = splat(4);
  out[0] = two * (x * (d[2][1] - d[1][2]) + y * (d[0][2] - d[2][0]) + z * (d[1][0] - d[0][1]));
  out[1] = two * (y * (d[1][0] + d[0][1]) + z * (d[2][0] + d[0][2]) + w * (d[2][1] - d[1][2])) - four * x * (d[1][1] + d[2][2]);
  out[2] = two * (x * (d[1][0] + d[0][1]) + z * (d[2][1] + d[1][2]) + w * (d[0][2] - d[2][0])) - four * y * (d[0][0] + d[2][2]);
  out[3] = two * (x * (d[2][0] + d[0][2]) + y * (d[2][1] + d[1][2]) + w * (d[1][0] - d[0][1])) - four * z * (d[0][0] + d[1][1]);
}

// dL/dA (A = P R S, the covariance factor): 2 G A with G = dL/dcov = Q S2 Q / 2, Q the inverse covariance and S2 the second
// moments of g; in whitened moments W that is kWhiten^4 L^T W (L A).
inline void factor_vjp(const Eye& e, const Projected& p, const Whitening& l, const ScreenGrads& g, V d_factor[2][3]) {
  constexpr R scale = kWhiten * kWhiten;
  const V unit = splat(1 / scale);  // L cov L^T
  V wuu = g.guu, wvv = g.gvv;
  V before_xx = splat(0), before_xy = splat(0), before_yy = splat(0);
  if (e.antialiased) {  // d ln(compensation) = (d ln det_before - d ln det) / 2 above the floor
    const M active = less(splat(R(kCompensationFloor)), p.det_before / p.det);
    wuu -= keep(active, g.g * unit), wvv -= keep(active, g.g * unit);
    const V share = keep(active, g.g / max(p.det_before, splat(R(1e-37)))), blur = splat(R(kBlur));
    before_xx = share * (p.cyy - blur), before_xy = -share * p.cxy, before_yy = share * (p.cxx - blur);
  }
  const V *u = p.factor[0], *v = p.factor[1];
  for (int j = 0; j < 3; ++j) {
    const V a = fma(l.l11, u[j], l.l12 * v[j]), b = l.l22 * v[j];    // L A
    const V c = fma(wuu, a, g.guv * b), d = fma(g.guv, a, wvv * b);  // W L A
    d_factor[0][j] = splat(scale * scale) * l.l11 * c + before_xx * u[j] + before_xy * v[j];
    d_factor[1][j] = splat(scale * scale) * fma(l.l12, c, l.l22 * d) + before_xy * u[j] + before_yy * v[j];
  }
}

// What dL/dP says of x/z, y/z and z: P = (1/z) [fx (w0 - rx w2); fy (w1 - ry w2)], w = rows of the view rotation.
inline void jacobian_vjp(const Eye& e, const Projected& p, V inv_z, const V d_screen[2][3], V& d_rx, V& d_ry, V& d_z) {
  const V fx = splat(e.fx), fy = splat(e.fy);
  V radial = splat(0);
  for (int i = 0; i < 3; ++i) {
    radial = fma(d_screen[0][i], p.to_screen[0][i], fma(d_screen[1][i], p.to_screen[1][i], radial));
    d_rx = fnma(d_screen[0][i], fx * inv_z * e.view(2, i), d_rx);
    d_ry = fnma(d_screen[1][i], fy * inv_z * e.view(2, i), d_ry);
  }
  d_z -= radial * inv_z;
  d_rx *= p.free_x, d_ry *= p.free_y;
}

// Always inline: as a call it costs the backward pass 5 % (AVX2).
[[gnu::always_inline]] inline ParameterGrads project_vjp(const Eye& e, const Projected& p, const ScreenGrads& g) {
  ParameterGrads out;
  const V inv_z = e.inverse_depth(p.c[2]), fx = splat(e.fx), fy = splat(e.fy);
  const Whitening l = whitening(p);
  out.opacity_logit = g.g * (splat(1) - p.opacity);
  out.mean2d[0] = splat(kWhiten * kWhiten) * l.l11 * g.gu;  // Q (sum of g d)
  out.mean2d[1] = splat(kWhiten * kWhiten) * fma(l.l12, g.gu, l.l22 * g.gv);

  V d_factor[2][3], d_screen[2][3], d_rotation[3][3];
  factor_vjp(e, p, l, g, d_factor);
  for (int j = 0; j < 3; ++j) {
    V d_scale = splat(0);
    for (int i = 0; i < 3; ++i) {
      const V d = p.to_screen[0][i] * d_factor[0][j] + p.to_screen[1][i] * d_factor[1][j];  // dL/d(R S)
      d_scale = fma(d, p.rotation[i][j], d_scale);
      d_rotation[i][j] = d * p.scale[j];
    }
    out.log_scale[j] = d_scale * p.scale[j];
  }
  for (int r = 0; r < 2; ++r)
    for (int i = 0; i < 3; ++i) {
      V d = splat(0);
      for (int j = 0; j < 3; ++j) d = fma(d_factor[r][j] * p.scale[j], p.rotation[i][j], d);
      d_screen[r][i] = d;
    }
  V d_quat[4], along = splat(0);
  rotation_matrix_vjp(p.quat, d_rotation, d_quat);
  for (int k = 0; k < 4; ++k) along = fma(d_quat[k], p.quat[k], along);
  for (int k = 0; k < 4; ++k) out.quat[k] = (d_quat[k] - along * p.quat[k]) * p.inv_norm;

  V d_c[3] = {splat(0), splat(0), g.depth}, d_rx = splat(0), d_ry = splat(0);
  if (!e.orthographic) jacobian_vjp(e, p, inv_z, d_screen, d_rx, d_ry, d_c[2]);
  d_rx = fma(out.mean2d[0], fx, d_rx), d_ry = fma(out.mean2d[1], fy, d_ry);  // centre = (fx x/z + cx, fy y/z + cy)
  d_c[0] = d_rx * inv_z, d_c[1] = d_ry * inv_z;
  if (!e.orthographic) d_c[2] -= (d_rx * (p.c[0] * inv_z) + d_ry * (p.c[1] * inv_z)) * inv_z;
  for (int j = 0; j < 3; ++j) out.mean[j] = e.view(0, j) * d_c[0] + e.view(1, j) * d_c[1] + e.view(2, j) * d_c[2];
  return out;
}

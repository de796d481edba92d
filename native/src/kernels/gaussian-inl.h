// Projects a batch of W Gaussians from the world to the screen.
// Equations: 3DGS Eq. 5-6 (covariance, EWA projection), with the full K. In the Jacobian, x/z and y/z are clamped to the frustum
// widened beyond the true image borders, as in gsplat (camera-inl.h); 3DGS clamps at +-1.3 tan(fov / 2), which is the same only where
// the principal point is the image centre. For orthographic cameras 1/z is replaced by 1, and x/z, y/z in the Jacobian by 0.

struct Batch {  // raw parameters of W Gaussians, transposed
  D offset[3];  // mean from the camera centre
  V mean[3];    // the same, rounded
  V log_scale[3], quat[4], opacity_logit;
};

constexpr int kNarrowParameters = 11;  // of a Gaussian, SH aside: mean 3, log-scale 3, quaternion 4, opacity

inline Batch batch_of(const Frame& f, const V numbers[kNarrowParameters]) {
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
  const R *means = static_cast<const R*>(f.means), *scales = static_cast<const R*>(f.log_scales), *quats = static_cast<const R*>(f.quats),
          *logits = static_cast<const R*>(f.opacity_logits);
  alignas(64) R rows[W * kPaddedRow] = {};
  for (int i = 0; i < W; ++i) {
    const int64_t g = ids[i];
    R* const row = rows + kPaddedRow * i;
    std::copy_n(means + 3 * g, 3, row), std::copy_n(scales + 3 * g, 3, row + 3), std::copy_n(quats + 4 * g, 4, row + 6);
    row[10] = logits[g];
  }
  V numbers[kPaddedRow];
  columns_of_rows<kNarrowParameters>(rows, numbers);
  return batch_of(f, numbers);
}

struct Projection {
  V c[3];              // camera-space centre
  V ratio_x, ratio_y;  // x/z, y/z clamped to the widened frustum
  V free_x, free_y;    // 1 where not clamped
  V scale[3], quat[4], inv_norm;
  V rotation[3][3];   // of the Gaussian
  V to_screen[2][3];  // P = J W, 2x3
  V factor[2][3];     // A = P R S: covariance before blur = A A^T
  V cxx, cxy, cyy;    // covariance after blur, pixels^2
  V det, det_before;  // of it, and before blur
  V compensation;     // 1, or sqrt(det_before / det)
  V opacity;          // sigmoid, without compensation
};

inline void rotation_matrix(const V q[4], V m[3][3]) {
  const V w = q[0], x = q[1], y = q[2], z = q[3], x2 = x + x, y2 = y + y, z2 = z + z, one = broadcast(1);
  const V rest = fnma(x, x2, one), yy = y * y2, xy = x * y2, xz = x * z2, yz = y * z2;
  m[0][0] = fnma(z, z2, one - yy), m[0][1] = fnma(w, z2, xy), m[0][2] = fma(w, y2, xz);
  m[1][0] = fma(w, z2, xy), m[1][1] = fnma(z, z2, rest), m[1][2] = fnma(w, x2, yz);
  m[2][0] = fnma(w, y2, xz), m[2][1] = fma(w, x2, yz), m[2][2] = rest - yy;
}

inline void clamp_ratios(const CameraParams& camera, V inv_z, Projection& p) {
  if (camera.orthographic) {
    p.ratio_x = p.ratio_y = p.free_x = p.free_y = broadcast(0);
    return;
  }
  const V rx = p.c[0] * inv_z, ry = p.c[1] * inv_z;
  p.ratio_x = clamp(rx, broadcast(camera.low_x), broadcast(camera.high_x));
  p.ratio_y = clamp(ry, broadcast(camera.low_y), broadcast(camera.high_y));
  p.free_x = select(both(at_least(rx, p.ratio_x), at_least(p.ratio_x, rx)), broadcast(1), broadcast(0));
  p.free_y = select(both(at_least(ry, p.ratio_y), at_least(p.ratio_y, ry)), broadcast(1), broadcast(0));
}

[[gnu::always_inline]] inline Projection project(const CameraParams& camera, const Batch& b) {
  Projection p;
  for (int i = 0; i < 3; ++i) p.c[i] = camera.along(i, b.mean);
  const V inv_z = camera.inverse_depth(p.c[2]), fx = broadcast(camera.fx), fy = broadcast(camera.fy);
  clamp_ratios(camera, inv_z, p);

  V norm2 = broadcast(0);
  for (int k = 0; k < 4; ++k) norm2 = fma(b.quat[k], b.quat[k], norm2);
  p.inv_norm = reciprocal(sqrt(norm2));
  for (int k = 0; k < 4; ++k) p.quat[k] = b.quat[k] * p.inv_norm;
  for (int k = 0; k < 3; ++k) p.scale[k] = exp(b.log_scale[k]);
  rotation_matrix(p.quat, p.rotation);

  for (int j = 0; j < 3; ++j) {
    p.to_screen[0][j] = fx * inv_z * fnma(p.ratio_x, camera.view(2, j), camera.view(0, j));
    p.to_screen[1][j] = fy * inv_z * fnma(p.ratio_y, camera.view(2, j), camera.view(1, j));
  }
  for (int r = 0; r < 2; ++r)
    for (int j = 0; j < 3; ++j) {
      V a = p.to_screen[r][0] * p.rotation[0][j];
      a = fma(p.to_screen[r][1], p.rotation[1][j], a);
      a = fma(p.to_screen[r][2], p.rotation[2][j], a);
      p.factor[r][j] = a * p.scale[j];
    }
  const V *u = p.factor[0], *v = p.factor[1], blur = broadcast(R(kBlur));
  const V uu = fma(u[0], u[0], fma(u[1], u[1], u[2] * u[2])), vv = fma(v[0], v[0], fma(v[1], v[1], v[2] * v[2]));
  p.cxx = uu + blur, p.cyy = vv + blur;
  p.cxy = fma(u[0], v[0], fma(u[1], v[1], u[2] * v[2]));
  // det(A A^T) = |u x v|^2: a sum of squares, no cancellation for needles
  const V x0 = u[1] * v[2] - u[2] * v[1], x1 = u[2] * v[0] - u[0] * v[2], x2 = u[0] * v[1] - u[1] * v[0];
  p.det_before = fma(x0, x0, fma(x1, x1, x2 * x2));
  p.det = p.det_before + blur * (uu + vv) + blur * blur;
  p.opacity = sigmoid(b.opacity_logit);
  p.compensation = broadcast(1);
  if (camera.antialiased) p.compensation = sqrt(max(broadcast(R(kCompensationFloor)), p.det_before / p.det));
  return p;
}

// The Cholesky factor L of the conic, scaled so that alpha = opacity 2^-(u^2 + v^2) with (u, v) = L (dx, dy): u = l11 dx + l12 dy,
// v = l22 dy. The inverse covariance is kWhiten^2 L^T L.
constexpr R kWhiten = R(1.1774100225154747);  // sqrt(2 ln 2)

struct Whitening {
  V l11, l12, l22, inv_l11, ratio;  // ratio: -l12 / l11
};

inline Whitening whitening(const Projection& p) {
  const V root = sqrt(p.cyy), root_det = broadcast(kWhiten) * sqrt(p.det);
  Whitening l;
  l.l11 = root * reciprocal(root_det), l.l22 = reciprocal(broadcast(kWhiten) * root);
  l.inv_l11 = root_det * (kWhiten * l.l22);
  l.ratio = p.cxy / p.cyy, l.l12 = -l.l11 * l.ratio;  // divided: u of a long thin ellipse hangs on it
  return l;
}

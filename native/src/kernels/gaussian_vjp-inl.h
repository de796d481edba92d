// Vector-Jacobian product of gaussian-inl.h: from gradients on the screen to gradients of the parameters.

// What stage 5 sums for each Gaussian of a batch: moments of g = alpha dL/dalpha in u, v (enum Slot).
struct ScreenGrads {
  V g, gu, gv, guu, guv, gvv;
  V depth;  // dL/d camera z from the depth image
};
// Gradients of a batch's parameters.
struct ParameterGrads {
  V mean[3], log_scale[3], quat[4], opacity_logit, mean2d[2];
};

// dL/dR of a rotation matrix to dL/dquat of the unit quaternion it came from.
inline void rotation_matrix_vjp(const V q[4], const V d[3][3], V out[4]) {
  const V w = q[0], x = q[1], y = q[2], z = q[3], two = broadcast(2), four = broadcast(4);
  out[0] = two * (x * (d[2][1] - d[1][2]) + y * (d[0][2] - d[2][0]) + z * (d[1][0] - d[0][1]));
  out[1] = two * (y * (d[1][0] + d[0][1]) + z * (d[2][0] + d[0][2]) + w * (d[2][1] - d[1][2])) - four * x * (d[1][1] + d[2][2]);
  out[2] = two * (x * (d[1][0] + d[0][1]) + z * (d[2][1] + d[1][2]) + w * (d[0][2] - d[2][0])) - four * y * (d[0][0] + d[2][2]);
  out[3] = two * (x * (d[2][0] + d[0][2]) + y * (d[2][1] + d[1][2]) + w * (d[1][0] - d[0][1])) - four * z * (d[0][0] + d[1][1]);
}

// dL/dA (A = P R S, the covariance factor): 2 G A with G = dL/dcov = Q S2 Q / 2, Q the inverse covariance and S2 the second
// moments of g; in whitened moments W that is kWhiten^4 L^T W (L A).
inline void factor_vjp(const CameraParams& camera, const Projection& p, const Whitening& l, const ScreenGrads& g, V d_factor[2][3]) {
  constexpr R scale = kWhiten * kWhiten;
  const V unit = broadcast(1 / scale);  // L cov L^T
  V wuu = g.guu, wvv = g.gvv;
  V before_xx = broadcast(0), before_xy = broadcast(0), before_yy = broadcast(0);
  if (camera.antialiased) {  // d ln(compensation) = (d ln det_before - d ln det) / 2 above the floor
    const M active = less(broadcast(R(kCompensationFloor)), p.det_before / p.det);
    wuu -= keep(active, g.g * unit), wvv -= keep(active, g.g * unit);
    const V share = keep(active, g.g / max(p.det_before, broadcast(R(1e-37)))), blur = broadcast(R(kBlur));
    before_xx = share * (p.cyy - blur), before_xy = -share * p.cxy, before_yy = share * (p.cxx - blur);
  }
  const V *u = p.factor[0], *v = p.factor[1];
  for (int j = 0; j < 3; ++j) {
    const V a = fma(l.l11, u[j], l.l12 * v[j]), b = l.l22 * v[j];    // L A
    const V c = fma(wuu, a, g.guv * b), d = fma(g.guv, a, wvv * b);  // W L A
    d_factor[0][j] = broadcast(scale * scale) * l.l11 * c + before_xx * u[j] + before_xy * v[j];
    d_factor[1][j] = broadcast(scale * scale) * fma(l.l12, c, l.l22 * d) + before_xy * u[j] + before_yy * v[j];
  }
}

// From dL/dP to the gradients of x/z, y/z and z. P = (1/z) [fx (w0 - rx w2); fy (w1 - ry w2)], w = rows of the view rotation.
inline void jacobian_vjp(const CameraParams& camera, const Projection& p, V inv_z, const V d_screen[2][3], V& d_rx, V& d_ry, V& d_z) {
  const V fx = broadcast(camera.fx), fy = broadcast(camera.fy);
  V radial = broadcast(0);
  for (int i = 0; i < 3; ++i) {
    radial = fma(d_screen[0][i], p.to_screen[0][i], fma(d_screen[1][i], p.to_screen[1][i], radial));
    d_rx = fnma(d_screen[0][i], fx * inv_z * camera.view(2, i), d_rx);
    d_ry = fnma(d_screen[1][i], fy * inv_z * camera.view(2, i), d_ry);
  }
  d_z -= radial * inv_z;
  d_rx *= p.free_x, d_ry *= p.free_y;
}

// Always inline: as a call it costs the backward pass 5 % (AVX2).
[[gnu::always_inline]] inline ParameterGrads project_vjp(const CameraParams& camera, const Projection& p, const ScreenGrads& g) {
  ParameterGrads out;
  const V inv_z = camera.inverse_depth(p.c[2]), fx = broadcast(camera.fx), fy = broadcast(camera.fy);
  const Whitening l = whitening(p);
  out.opacity_logit = g.g * (broadcast(1) - p.opacity);
  out.mean2d[0] = broadcast(kWhiten * kWhiten) * l.l11 * g.gu;  // Q (sum of g d)
  out.mean2d[1] = broadcast(kWhiten * kWhiten) * fma(l.l12, g.gu, l.l22 * g.gv);

  V d_factor[2][3], d_screen[2][3], d_rotation[3][3];
  factor_vjp(camera, p, l, g, d_factor);
  for (int j = 0; j < 3; ++j) {
    V d_scale = broadcast(0);
    for (int i = 0; i < 3; ++i) {
      const V d = p.to_screen[0][i] * d_factor[0][j] + p.to_screen[1][i] * d_factor[1][j];  // dL/d(R S)
      d_scale = fma(d, p.rotation[i][j], d_scale);
      d_rotation[i][j] = d * p.scale[j];
    }
    out.log_scale[j] = d_scale * p.scale[j];
  }
  for (int r = 0; r < 2; ++r)
    for (int i = 0; i < 3; ++i) {
      V d = broadcast(0);
      for (int j = 0; j < 3; ++j) d = fma(d_factor[r][j] * p.scale[j], p.rotation[i][j], d);
      d_screen[r][i] = d;
    }
  V d_quat[4], along = broadcast(0);
  rotation_matrix_vjp(p.quat, d_rotation, d_quat);
  for (int k = 0; k < 4; ++k) along = fma(d_quat[k], p.quat[k], along);
  for (int k = 0; k < 4; ++k) out.quat[k] = (d_quat[k] - along * p.quat[k]) * p.inv_norm;

  V d_c[3] = {broadcast(0), broadcast(0), g.depth}, d_rx = broadcast(0), d_ry = broadcast(0);
  if (!camera.orthographic) jacobian_vjp(camera, p, inv_z, d_screen, d_rx, d_ry, d_c[2]);
  d_rx = fma(out.mean2d[0], fx, d_rx), d_ry = fma(out.mean2d[1], fy, d_ry);  // centre = (fx x/z + cx, fy y/z + cy)
  d_c[0] = d_rx * inv_z, d_c[1] = d_ry * inv_z;
  if (!camera.orthographic) d_c[2] -= (d_rx * (p.c[0] * inv_z) + d_ry * (p.c[1] * inv_z)) * inv_z;
  for (int j = 0; j < 3; ++j) out.mean[j] = camera.view(0, j) * d_c[0] + camera.view(1, j) * d_c[1] + camera.view(2, j) * d_c[2];
  return out;
}

// Spherical harmonics colour, degree 0-3 (3DGS sign convention), and its vector-Jacobian product.
// colour = max(0, 0.5 + sum_k basis_k(dir) sh_k), dir = (mean - camera position) normalised; for orthographic cameras the camera's axis.

constexpr R kC0 = R(0.28209479177387814), kC1 = R(0.4886025119029199);
constexpr R kC2[5] = {R(1.0925484305920792), R(-1.0925484305920792), R(0.31539156525252005), R(-1.0925484305920792), R(0.5462742152960396)};
constexpr R kC3[7] = {R(-0.5900435899266435), R(2.890611442640554), R(-0.4570457994644658), R(0.3731763325901154),
                      R(-0.4570457994644658), R(1.445305721320277), R(-0.5900435899266435)};

struct Direction {
  V d[3], inv_length;
};

inline Direction direction(const CameraParams& camera, const V mean[3]) {
  if (camera.orthographic) return {{camera.view(2, 0), camera.view(2, 1), camera.view(2, 2)}, broadcast(0)};  // does not change with the mean
  Direction out;
  V length2 = broadcast(0);
  for (int k = 0; k < 3; ++k) {
    out.d[k] = mean[k];
    length2 = fma(out.d[k], out.d[k], length2);
  }
  out.inv_length = reciprocal(sqrt(max(length2, broadcast(R(1e-30)))));
  for (int k = 0; k < 3; ++k) out.d[k] *= out.inv_length;
  return out;
}

inline void sh_basis(int degree, const V d[3], V basis[16]) {
  const V x = d[0], y = d[1], z = d[2];
  basis[0] = broadcast(kC0);
  if (degree < 1) return;
  basis[1] = -kC1 * y, basis[2] = kC1 * z, basis[3] = -kC1 * x;
  if (degree < 2) return;
  const V xx = x * x, yy = y * y, zz = z * z;
  basis[4] = kC2[0] * x * y, basis[5] = kC2[1] * y * z, basis[6] = kC2[2] * (R(2) * zz - xx - yy);
  basis[7] = kC2[3] * x * z, basis[8] = kC2[4] * (xx - yy);
  if (degree < 3) return;
  basis[9] = kC3[0] * y * (R(3) * xx - yy), basis[10] = kC3[1] * x * y * z, basis[11] = kC3[2] * y * (R(4) * zz - xx - yy);
  basis[12] = kC3[3] * z * (R(2) * zz - R(3) * xx - R(3) * yy), basis[13] = kC3[4] * x * (R(4) * zz - xx - yy);
  basis[14] = kC3[5] * z * (xx - yy), basis[15] = kC3[6] * x * (xx - R(3) * yy);
}

// Gradient of sum_k weight_k basis_k with respect to the (unit) direction, before the normalisation is undone.
inline void sh_basis_vjp(int degree, const V d[3], const V w[16], V out[3]) {
  const V x = d[0], y = d[1], z = d[2];
  out[0] = out[1] = out[2] = broadcast(0);
  if (degree < 1) return;
  out[0] = -kC1 * w[3], out[1] = -kC1 * w[1], out[2] = kC1 * w[2];
  if (degree < 2) return;
  out[0] += kC2[0] * y * w[4] - R(2) * kC2[2] * x * w[6] + kC2[3] * z * w[7] + R(2) * kC2[4] * x * w[8];
  out[1] += kC2[0] * x * w[4] + kC2[1] * z * w[5] - R(2) * kC2[2] * y * w[6] - R(2) * kC2[4] * y * w[8];
  out[2] += kC2[1] * y * w[5] + R(4) * kC2[2] * z * w[6] + kC2[3] * x * w[7];
  if (degree < 3) return;
  const V xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
  out[0] += R(6) * kC3[0] * xy * w[9] + kC3[1] * yz * w[10] - R(2) * kC3[2] * xy * w[11] - R(6) * kC3[3] * xz * w[12] +
            kC3[4] * (R(4) * zz - R(3) * xx - yy) * w[13] + R(2) * kC3[5] * xz * w[14] + R(3) * kC3[6] * (xx - yy) * w[15];
  out[1] += R(3) * kC3[0] * (xx - yy) * w[9] + kC3[1] * xz * w[10] + kC3[2] * (R(4) * zz - xx - R(3) * yy) * w[11] - R(6) * kC3[3] * yz * w[12] -
            R(2) * kC3[4] * xy * w[13] - R(2) * kC3[5] * yz * w[14] - R(6) * kC3[6] * xy * w[15];
  out[2] += kC3[1] * xy * w[10] + R(8) * kC3[2] * yz * w[11] + R(3) * kC3[3] * (R(2) * zz - xx - yy) * w[12] + R(8) * kC3[4] * xz * w[13] +
            kC3[5] * (xx - yy) * w[14];
}

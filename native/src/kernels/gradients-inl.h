// Stage 6: sums the slots of each visible Gaussian in the order of its tiles, and computes the gradients of its parameters from the sums.

inline void sum_slots(const Frame& f, const R* slots, const GaussianTiles& t, R sums[kSlotWidth]) {
  std::fill_n(sums, kSlotWidth, R(0));
  for (uint32_t i = 0; i < t.tiles; ++i) {
    if (!f.hits[t.slot + i]) continue;
    const R* slot = slots + static_cast<int64_t>(t.slot + i) * kSlotWidth;
    for (int k = 0; k < kSlotWidth; ++k) sums[k] += slot[k];
  }
}

[[gnu::always_inline]] inline void prefetch_sh(const Frame& f, uint32_t g) {
  const int width = 3 * (f.sh_degree + 1) * (f.sh_degree + 1), line = 64 / sizeof(R);
  const R* row = static_cast<const R*>(f.sh) + static_cast<int64_t>(g) * f.sh_coefficients * 3;
  for (int k = 0; k < width; k += line) __builtin_prefetch(row + k);
}

// dL/dcolour of a batch, zero where the colour was clamped at 0.
struct ColourGrads {
  V rgb[3];
};

// From dL/dcolour to the gradients of the SH coefficients (rows of (V, K, 3), bands above sh_degree zero) and of the mean, on which the
// direction depends.
inline void sh_vjp(const Frame& f, const CameraParams& camera, const Batch& b, const uint32_t* ids, int n, const ColourGrads& g, R* sh_rows, V mean[3]) {
  const Direction dir = direction(camera, b.mean);
  const int used = (f.sh_degree + 1) * (f.sh_degree + 1), width = 3 * f.sh_coefficients;
  V basis[kPaddedRow], weight[kPaddedRow];
  for (V& column : basis) column = broadcast(0);
  sh_basis(f.sh_degree, dir.d, basis);
  alignas(64) R basis_rows[W * kPaddedRow], weight_rows[W * kPaddedRow] = {}, stored[3 * kPaddedRow] = {};
  rows_of(basis, basis_rows);
  for (int i = 0; i < n; ++i) {  // coefficients of a Gaussian side by side
    const R* row = static_cast<const R*>(f.sh) + int64_t{ids[i]} * width;
    if (width < 3 * kPaddedRow) row = std::copy_n(row, width, stored) - width;
    R* const out = sh_rows ? sh_rows + static_cast<int64_t>(i) * width : nullptr;
    const V red = broadcast(g.rgb[0][i]), green = broadcast(g.rgb[1][i]), blue = broadcast(g.rgb[2][i]);
    for (int k = 0; k < used; k += W) {
      V c[3];
      columns_of<3>(row + 3 * k, c);
      store(weight_rows + kPaddedRow * i + k, fma(red, c[0], fma(green, c[1], blue * c[2])));
    }
    if (!out) continue;
    R spare[3 * kPaddedRow];
    R* const to = width < 3 * kPaddedRow ? spare : out;
    for (int k = 0; k < kPaddedRow; k += W) {
      const V some = load(basis_rows + kPaddedRow * i + k), c[3] = {some * red, some * green, some * blue};
      interleave<3>(c, to + 3 * k);
    }
    if (to == spare) std::copy_n(spare, width, out);
  }
  columns_of_rows(weight_rows, weight);
  V d[3], along = broadcast(0);
  sh_basis_vjp(f.sh_degree, dir.d, weight, d);
  for (int k = 0; k < 3; ++k) along = fma(d[k], dir.d[k], along);
  for (int k = 0; k < 3; ++k) mean[k] += (d[k] - along * dir.d[k]) * dir.inv_length;
}

// Factor of dL/dM from F: 1; for SVRGS_MASK_EVEN the fixed footprint divided by the area of the Gaussian's 1/255 ellipse.
inline R spatial_weight(const Frame& f, const GaussianShape<R>& s) {
  if (f.mask_kind != SVRGS_MASK_EVEN) return 1;
  const R area = R(3.141592653589793) * (s.log2_opacity - R(kLog2Cut)) / (s.l11 * s.l22);
  return R(SVRGS_EVEN_AREA) / std::max(area, R(1));
}

// Writes n <= W rows of `width` values, from row `first` on, given their columns.
template <int width>
inline void scatter(void* array, int64_t first, int n, const V* columns) {
  if (!array) return;
  R* const rows = static_cast<R*>(array) + first * width;
  if (n == W) return interleave<width>(columns, rows);
  R spare[W * width];
  interleave<width>(columns, spare);
  std::copy_n(spare, n * width, rows);
}

inline AdamTensors tensors(const svrgs_trained& t) { return {static_cast<R*>(t.param), static_cast<Packed*>(t.moments)}; }

// Adam's constants for each tensor of an update.
struct UpdateRates {
  const svrgs_update* settings;
  AdamRates means, log_scales, quats, opacity_logits, sh, masks;
  UpdateRates(const Frame& f, const svrgs_update& u) : settings(&u) {
    const auto rates = [&](const svrgs_trained& t, int width) { return t.param ? adam_rates(u.adam, t.lr, width) : AdamRates{}; };
    means = rates(u.means, 3), log_scales = rates(u.log_scales, 3), quats = rates(u.quats, 4), opacity_logits = rates(u.opacity_logits, 1);
    sh = rates(u.sh, 3 * f.sh_coefficients), masks = rates(u.masks, 1);
  }
};

// Gradients of the narrow parameters of up to kStagedRows visible Gaussians, for the Adam step that follows.
constexpr int64_t kStagedRows = 256;

struct StagedGradients {
  R means[3 * kStagedRows], log_scales[3 * kStagedRows], quats[4 * kStagedRows], opacity_logits[kStagedRows], masks[kStagedRows];

  // Like `out`, but with the gradients of updated parameters written here, for Gaussians from `first` on.
  svrgs_grads in_place_of(const svrgs_grads& out, const svrgs_update& u, int64_t first) {
    svrgs_grads to = out;
    if (u.means.param) to.means = means - 3 * first;
    if (u.log_scales.param) to.log_scales = log_scales - 3 * first;
    if (u.quats.param) to.quats = quats - 4 * first;
    if (u.opacity_logits.param) to.opacity_logits = opacity_logits - first;
    if (u.masks.param) to.masks = masks - first;
    return to;
  }

  // From dL/dM to the gradients of the existence logits, for the Gaussians `ids`.
  void times_slope(const R* slope, const uint32_t* ids, int64_t n) {
    for (int64_t i = 0; i < n; ++i) masks[i] *= slope[ids[i]];
  }
};

inline int64_t apply(const Frame& f, const UpdateRates& u, StagedGradients& g, int64_t first, int64_t n, OwnedRows own) {
  if (u.settings->masks.param) g.times_slope(static_cast<const R*>(u.settings->slope), f.visible + first, n);
  const auto step = [&](const AdamRates& rates, const svrgs_trained& t, const R* rows, int width) {
    return t.param ? adam_rows(rates, tensors(t), rows, f.visible + first, 0, n, width, own) : 0;
  };
  return step(u.means, u.settings->means, g.means, 3) + step(u.log_scales, u.settings->log_scales, g.log_scales, 3) +
         step(u.quats, u.settings->quats, g.quats, 4) + step(u.opacity_logits, u.settings->opacity_logits, g.opacity_logits, 1) +
         step(u.masks, u.settings->masks, g.masks, 1);
}

// Ids of n <= W visible Gaussians from `first` on, and in columns the sums of their slots (enum Slot), their colours and their weights of F.
// Lanes from n on repeat the last Gaussian.
[[gnu::always_inline]] inline void gather_sums(const Frame& f, const WantedGradients& want, const R* slots, int64_t first, int n, uint32_t* ids, V* columns) {
  alignas(64) R rows[W * kPaddedRow];
  static_assert(kSlotWidth + 4 == kPaddedRow);
  for (int i = 0; i < W; ++i) {
    ids[i] = f.visible[first + (i < n ? i : n - 1)];
    if (want.colour && first + i + W < f.visible_count) prefetch_sh(f, f.visible[first + i + W]);
    const uint32_t place = f.places[first + (i < n ? i : n - 1)];
    const GaussianShape<R>& gaussian = static_cast<const ProjectedGaussian<R>*>(f.gaussians)[place].shape;
    R* const row = rows + kPaddedRow * i;
    sum_slots(f, slots, f.tiles[place], row);
    std::copy_n(gaussian.rgb, 3, row + kSlotWidth);
    row[kSlotWidth + 3] = spatial_weight(f, gaussian);
  }
  columns_of_rows(rows, columns);
}

// Columns of svrgs_grads.camera. A rotation of the camera about its centre moves what it sees as the opposite rotation of all Gaussians about
// that point would, but for the view directions of the colours, which stay as they are. mean: without what the colours give.
inline void camera_vjp(const CameraParams& camera, const Batch& b, const ParameterGrads& g, const V mean[3], V out[6]) {
  const V *o = b.mean, *q = b.quat, *d = g.quat, half = broadcast(R(0.5));
  V turn[3], move[3];  // along the world's axes
  for (int i = 0; i < 3; ++i) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    const V of_quat = q[0] * d[1 + i] - q[1 + i] * d[0] + q[1 + j] * d[1 + k] - q[1 + k] * d[1 + j];  // of the quaternion (0, axis) q / 2
    turn[i] = -fma(half, of_quat, o[j] * mean[k] - o[k] * mean[j]), move[i] = -g.mean[i];
  }
  for (int i = 0; i < 3; ++i) out[i] = camera.along(i, turn), out[3 + i] = camera.along(i, move);
}

// Visible Gaussians [first, first + n): writes gradients to the rows of `out`, or updates the parameters.
// Returns how many rows an update left alone.
template <bool updates>
inline int gradient_batch(const Frame& f, const CameraParams& camera, const WantedGradients& want, const svrgs_grads& out, const UpdateRates* update,
                          const R* slots, int64_t first, int n) {
  uint32_t ids[W];
  V s[kPaddedRow];
  gather_sums(f, want, slots, first, n, ids, s);
  s[kSlotMask] += s[kSlotWidth + 3] * s[kSlotSpatial];
  ColourGrads colour;
  for (int c = 0; c < 3; ++c) colour.rgb[c] = keep(less(broadcast(0), s[kSlotWidth + c]), s[kSlotRed + c]);
  if (want.mask) scatter<1>(out.masks, first, n, &s[kSlotMask]);
  if (!want.shape && !want.colour) return 0;
  const Batch b = load_batch(f, ids);
  ParameterGrads g = {};
  if (want.shape) g = project_vjp(camera, project(camera, b), {s[kG], s[kGu], s[kGv], s[kGuu], s[kGuv], s[kGvv], want.depth ? s[kSlotDepth] : broadcast(0)});
  const int width = 3 * f.sh_coefficients;
  alignas(64) R own[W * 48];
  R* const sh_rows = updates ? own : out.sh ? static_cast<R*>(out.sh) + first * width : nullptr;
  const V shape_mean[3] = {g.mean[0], g.mean[1], g.mean[2]};
  if (want.colour)
    sh_vjp(f, camera, b, ids, n, colour, sh_rows, g.mean);
  else if (sh_rows)
    __builtin_memset(sh_rows, 0, sizeof(R) * n * width);
  if (out.camera) {
    V camera_grads[6];
    camera_vjp(camera, b, g, shape_mean, camera_grads);
    scatter<6>(out.camera, first, n, camera_grads);
  }
  scatter<2>(out.means2d, first, n, g.mean2d);
  scatter<3>(out.means, first, n, g.mean);
  scatter<3>(out.log_scales, first, n, g.log_scale);
  scatter<4>(out.quats, first, n, g.quat);
  scatter<1>(out.opacity_logits, first, n, &g.opacity_logit);
  if (!updates) return 0;
  const svrgs_trained& sh = update->settings->sh;
  return static_cast<int>(
      adam_sh_rows(update->sh, {static_cast<R*>(sh.param), static_cast<R*>(sh.moments)}, f.visible + first, f.visible_count - first, own, n, n, width));
}

template <bool updates>
inline int64_t gradient_batches(const Frame& f, const CameraParams& camera, const WantedGradients& want, const svrgs_grads& out, const UpdateRates* update,
                                const R* slots, int64_t begin, int64_t end) {
  int64_t bad = 0;
  for (int64_t i = begin; i < end; i += W)
    bad += gradient_batch<updates>(f, camera, want, out, update, slots, i, static_cast<int>(std::min<int64_t>(W, end - i)));
  return bad;
}

// Visible Gaussians [begin, end). Returns how many rows of parameters were left alone because their gradient was not finite.
int64_t gradients_range(const Frame& f, const svrgs_image_grads& in, const svrgs_grads& out, const svrgs_update* update, const void* slots, int64_t begin,
                        int64_t end) {
  const CameraParams camera(f);
  const WantedGradients want = wanted(f, in, out, update);
  const R* const sums = static_cast<const R*>(slots);
  if (!update) return gradient_batches<false>(f, camera, want, out, nullptr, sums, begin, end);
  const UpdateRates u(f, *update);
  alignas(64) StagedGradients staged;
  int64_t bad = 0;
  for (int64_t from = begin; from < end; from += kStagedRows) {
    const int64_t until = std::min(from + kStagedRows, end);
    bad += gradient_batches<true>(f, camera, want, staged.in_place_of(out, *update, from), &u, sums, from, until);
    bad += apply(f, u, staged, from, until - from, {f.visible[begin], f.visible[end - 1]});
  }
  return bad;
}

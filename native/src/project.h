// Stage 1: cull, project, colour. The only visibility gate: comparisons are written so that NaN fails them.

// Smallest box of pixel rows and columns [begin, end) the 1/255 ellipse can reach; false if none.
struct PixelBox {
  int x0, x1, y0, y1;
};

inline bool reach(double centre, double half, int size, int& begin, int& end) {
  const double low = centre - half - 0.5, high = centre + half - 0.5;  // in units of pixel index
  if (!(high >= 0) || !(low <= size - 1)) return false;
  begin = low <= 0 ? 0 : static_cast<int>(std::ceil(low));
  end = high >= size - 1 ? size : static_cast<int>(high) + 1;
  return begin < end;
}

// Bound of u^2 + v^2 within the ellipse.
inline R reach2(const Frame& f, const Splat<R>& s) {
  return (f.without & SVRGS_OPACITY_BOUNDS ? R(0) : s.log2_opacity) - R(kLog2Cut) + kReachMargin;
}

inline bool pixel_box(const Frame& f, const Splat<R>& s, PixelBox& box) {
  const double r = std::sqrt(static_cast<double>(reach2(f, s)));
  const double half_y = r / s.l22 + kBorderMargin;
  const double half_x = r * std::sqrt(1.0 + (static_cast<double>(s.l12) / s.l22) * (s.l12 / s.l22)) * s.inv_l11 + kBorderMargin;
  return reach(s.x, half_x, f.width, box.x0, box.x1) && reach(s.y, half_y, f.height, box.y0, box.y1);
}

// Survivors of the scalar tests, gathered until a vector is full.
struct Pending {
  uint32_t ids[W];
  double x[W], y[W];  // projected centres, exact to double
  int count = 0;
};

// Depth and opacity of one Gaussian; on success its centre in pixels.
inline bool in_front(const Frame& f, int64_t g, double& x, double& y) {
  const R* mean = static_cast<const R*>(f.means) + 3 * g;
  const double* m = f.viewmat;
  const double z = m[8] * mean[0] + m[9] * mean[1] + m[10] * mean[2] + m[11];
  if (!(z > kNear) || !(z < kFar)) return false;
  if (!(static_cast<const R*>(f.opacity_logits)[g] >= R(kLogitCut))) return false;
  x = f.fx * (m[0] * mean[0] + m[1] * mean[1] + m[2] * mean[2] + m[3]) / z + f.cx;
  y = f.fy * (m[4] * mean[0] + m[5] * mean[1] + m[6] * mean[2] + m[7]) / z + f.cy;
  return true;
}

inline void colour_splats(const Frame& f, const Batch& b, const uint32_t* ids, Splat<R>* out, int count) {
  V basis[16];
  const Direction dir = direction(b.mean);
  sh_basis(f.sh_degree, dir.d, basis);
  const int used = (f.sh_degree + 1) * (f.sh_degree + 1);
  const R* sh = static_cast<const R*>(f.sh);
  for (int i = 0; i < count; ++i) {
    const R* row = sh + static_cast<int64_t>(ids[i]) * f.sh_coefficients * 3;
    R c[3] = {R(0.5), R(0.5), R(0.5)};
    for (int k = 0; k < used; ++k)
      for (int j = 0; j < 3; ++j) c[j] += basis[k][i] * row[3 * k + j];
    for (int j = 0; j < 3; ++j) out[i].rgb[j] = c[j] < 0 && c[j] >= R(-kColourMax) ? R(0) : c[j];
  }
}

inline bool finite(R x) { return std::fabs(x) <= std::numeric_limits<R>::max(); }
inline bool sane(R colour) { return std::fabs(colour) <= R(kColourMax); }

inline bool usable(const Batch& b, const Projected& p, int i) {
  return finite(b.log_scale[0][i] + b.log_scale[1][i] + b.log_scale[2][i]) && p.inv_norm[i] < R(kQuatMax) && p.inv_norm[i] > R(1 / kQuatMax);
}

inline bool usable(const Frame& f, const Splat<R>& s, double x, double y) {
  return reach2(f, s) > kReachMargin * R(0.5) && s.l11 > 0 && s.l22 > 0 && finite(s.l11) && finite(s.l12) && finite(s.l22) &&
         finite(s.inv_l11) && finite(s.y_extreme) && sane(s.rgb[0]) && sane(s.rgb[1]) && sane(s.rgb[2]) &&
         std::fabs(x) < 1e9 && std::fabs(y) < 1e9;
}

inline SplatTiles tile_rows(const PixelBox& box) {
  const int first = box.y0 / kTile, last = (box.y1 - 1) / kTile;
  return {0, 0, static_cast<uint16_t>(first), static_cast<uint16_t>(last - first + 1), 0};
}

// Projects the pending Gaussians; appends the visible ones to ids, returns how many.
inline int64_t flush(const Frame& f, Pending& pending, uint32_t* ids, uint32_t* depth_keys) {
  const int n = pending.count;
  pending.count = 0;
  if (n <= 0) return 0;
  for (int i = n; i < W; ++i) pending.ids[i] = pending.ids[0];
  const Batch b = load_batch(f, pending.ids);
  const Projected p = project(f, b);
  const Whitening l = whitening(p);
  const V l11 = l.l11, l12 = l.l12, l22 = l.l22;
  const V opacity = p.opacity * p.compensation;
  Splat<R> batch[W];
  for (int i = 0; i < n; ++i) {
    Splat<R>& s = batch[i];
    s = {pending.x[i], pending.y[i], l11[i], l12[i], l22[i], std::log2(opacity[i]), {}, p.c[2][i], R(1) / l11[i], 0, R(1), -l12[i] / l11[i]};
    s.y_extreme = -l12[i] * std::sqrt(reach2(f, s)) / (l22[i] * std::sqrt(l22[i] * l22[i] + l12[i] * l12[i]));
    if (f.masks) s.mask = f.masks[pending.ids[i]] ? R(1) : R(0);
  }
  colour_splats(f, b, pending.ids, batch, n);
  int64_t kept = 0;
  for (int i = 0; i < n; ++i) {
    PixelBox box;
    if (!usable(b, p, i) || !usable(f, batch[i], pending.x[i], pending.y[i]) || !pixel_box(f, batch[i], box)) continue;
    const uint32_t g = pending.ids[i];
    static_cast<Splat<R>*>(f.splats)[g] = batch[i];
    f.tiles[g] = tile_rows(box);
    const float z = static_cast<float>(batch[i].depth);
    __builtin_memcpy(depth_keys + kept, &z, 4);  // positive floats order as their bits
    ids[kept++] = g;
  }
  return kept;
}

// Gaussians [begin, end): writes the visible ones' ids and depth keys from `begin` on; returns their number.
int64_t project_range(const Frame& f, int64_t begin, int64_t end, uint32_t* ids, uint32_t* depth_keys) {
  Pending pending;
  int64_t kept = 0;
  for (int64_t g = begin; g < end; ++g) {
    double x, y;
    if (!in_front(f, g, x, y)) continue;
    pending.ids[pending.count] = static_cast<uint32_t>(g);
    pending.x[pending.count] = x, pending.y[pending.count] = y;
    if (++pending.count == W) kept += flush(f, pending, ids + kept, depth_keys + kept);
  }
  return kept + flush(f, pending, ids + kept, depth_keys + kept);
}

// Stage 2: the exact tiles of one visible Gaussian, row by row; returns how many.
uint32_t fill_spans(const Frame& f, uint32_t g, Span* spans) {
  const Splat<R>& s = static_cast<const Splat<R>*>(f.splats)[g];
  const SplatTiles& t = f.tiles[g];
  const R bound = reach2(f, s);
  uint32_t tiles = 0;
  for (int r = 0; r < t.rows; ++r) {
    const int y0 = (t.row + r) * kTile, y1 = std::min(y0 + kTile, f.height) - 1;
    const R low = static_cast<R>(y0 + 0.5 - s.y) - kBorderMargin, high = static_cast<R>(y1 + 0.5 - s.y) + kBorderMargin;
    const Extent<R> e = ellipse_extent<R>(bound, s.l22, s.inv_l11, s.slope, s.y_extreme, low, high);
    int x0, x1;
    if (f.without & SVRGS_EXACT_TILES) {
      PixelBox box = {};
      pixel_box(f, s, box);
      spans[r] = {static_cast<uint16_t>(box.x0 / kTile), static_cast<uint16_t>((box.x1 - 1) / kTile + 1)};
      tiles += spans[r].end - spans[r].begin;
      continue;
    }
    const double middle = s.x + 0.5 * (static_cast<double>(e.left) + e.right), half = 0.5 * (static_cast<double>(e.right) - e.left) + kBorderMargin;
    spans[r] = {0, 0};
    if (e.depth < 0 || !reach(middle, half, f.width, x0, x1)) continue;
    spans[r] = {static_cast<uint16_t>(x0 / kTile), static_cast<uint16_t>((x1 - 1) / kTile + 1)};
    tiles += spans[r].end - spans[r].begin;
  }
  return tiles;
}

// Stage 1: cull, project, colour. The only visibility gate: comparisons are written so that NaN fails them.

// Pixels [begin, end) of a row or column of `size` that centre +- half covers, both at `begin` if none.
inline void reach(double centre, double half, int size, int& begin, int& end) {
  const double low = centre - half - 0.5, high = centre + half - 0.5;  // in units of pixel index
  begin = end = 0;
  if (!(high >= 0) || !(low <= size - 1)) return;
  begin = low <= 0 ? 0 : static_cast<int>(low) + (low > static_cast<int>(low));
  end = high >= size - 1 ? size : static_cast<int>(high) + 1;
}

// The same for vectors; `half` has a margin for the rounding of the centre.
struct Reach {
  V begin, end;
};

inline Reach reach(V centre, V half, int size) {
  const V zero = splat(0), full = splat(static_cast<R>(size));
  const V low = clamp(centre - half - R(0.5), zero, full), high = clamp(centre + half - R(0.5), splat(-1), full);
  return {ceil(low), min(floor(high) + R(1), full)};
}

// Half the width and height of the ellipse u^2 + v^2 <= bound, with a margin for the rounding of the two. Scalars or vectors.
template <class T>
inline T half_width(T bound, T l12, T l22, T inv_l11) {
  const T slope = l12 / l22;
  return root(bound * (slope * slope + R(1))) * inv_l11 * (1 + kRelativeMargin) + kBorderMargin;
}
template <class T>
inline T half_height(T bound, T l22) {
  return root(bound) / l22 * (1 + kRelativeMargin) + kBorderMargin;
}

// Bound of u^2 + v^2 within the ellipse.
template <class T>
inline T reach2(const Frame& f, T log2_opacity) {
  return (f.without & SVRGS_OPACITY_BOUNDS ? T{} : log2_opacity) + (kReachMargin - R(kLog2Cut));
}

// SH rows are far apart where not every Gaussian is visible: the processor does not foresee them.
inline void prefetch_sh(const Frame& f, uint32_t g) {
  const int size = f.sh_half ? 2 : sizeof(R);
  const char* row = static_cast<const char*>(f.sh) + static_cast<int64_t>(g) * f.sh_coefficients * 3 * size;
  for (int k = 0; k < 3 * (f.sh_degree + 1) * (f.sh_degree + 1) * size; k += 64) __builtin_prefetch(row + k);
}

// The first n of W rows of `width` values; what lies behind the scene's end reads as 0.
template <int width>
inline const R* padded(const void* array, int64_t first, int n, R* spare) {
  const R* at = static_cast<const R*>(array) + first * width;
  if (n >= W) return at;
  std::fill_n(spare, W * width, R(0));
  std::copy_n(at, n * width, spare);
  return spare;
}

// Which of the n <= W Gaussians from `first` on may be seen: in front of the camera, not too faint, and near enough to the
// image. One bit each. It errs on the side of projecting: a ball of the largest scale, fully opaque, bounds the ellipse.
inline uint32_t may_be_seen(const Frame& f, int64_t first, int n) {
  R spare[7 * W];
  const R *means = padded<3>(f.means, first, n, spare), *scales = padded<3>(f.log_scales, first, n, spare + 3 * W),
          *logits = padded<1>(f.opacity_logits, first, n, spare + 6 * W);
  V x, y, z, scale;
  for (int i = 0; i < W; ++i) {
    x[i] = means[3 * i], y[i] = means[3 * i + 1], z[i] = means[3 * i + 2];
    scale[i] = std::max(std::max(scales[3 * i], scales[3 * i + 1]), scales[3 * i + 2]);
  }
  const double* m = f.viewmat;
  const D wx = wide(x), wy = wide(y), wz = wide(z);
  const auto camera = [&](int row) { return narrow(m[4 * row] * wx + m[4 * row + 1] * wy + m[4 * row + 2] * wz + m[4 * row + 3]); };
  const V depth = camera(2), inv = inverse_depth(f, depth), rx = camera(0) * inv, ry = camera(1) * inv;
  const M front = both(less(splat(R(kNear)), depth), less(depth, splat(R(kFar))));
  V stretch = splat(1);  // of what a slanting ray meets
  if (!f.orthographic) {
    const V limit_x = splat(R(kFrustumMargin * f.width / (2 * f.fx) + std::max(f.cx, f.width - f.cx) / f.fx));
    const V limit_y = splat(R(kFrustumMargin * f.height / (2 * f.fy) + std::max(f.cy, f.height - f.cy) / f.fy));
    const V tx = min(magnitude(rx), limit_x), ty = min(magnitude(ry), limit_y);
    stretch = splat(1) + tx * tx + ty * ty;
  }
  const V size = exp(scale) * splat(R(std::max(f.fx, f.fy))) * inv;  // of the largest scale across the view, pixels
  const V reach = splat(kWhiten) * root(splat(kReachMargin - R(kLog2Cut)));
  const V radius = reach * sqrt(fma(size * size, stretch, splat(R(kBlur)))) * R(1.001) + R(1);
  const V px = rx * R(f.fx) + R(f.cx), py = ry * R(f.fy) + R(f.cy), spread_x = radius + magnitude(px) * R(1e-3), spread_y = radius + magnitude(py) * R(1e-3);
  const M outside = either(either(less(px + spread_x, splat(0)), less(splat(R(f.width)), px - spread_x)),
                           either(less(py + spread_y, splat(0)), less(splat(R(f.height)), py - spread_y)));
  return bits(both(and_not(outside, front), at_least(load(logits), splat(R(kLogitCut))))) & ((1u << n) - 1);
}

using Four = R __attribute__((vector_size(4 * sizeof(R))));

inline Four load_four(const R* p) {
  Four v;
  __builtin_memcpy(&v, p, sizeof v);
  return v;
}
inline Four load_four(const _Float16* p) {
  _Float16 __attribute__((vector_size(8))) v;
  __builtin_memcpy(&v, p, sizeof v);
  return __builtin_convertvector(v, Four);
}

// 0.5 + sum_k basis_k sh_k of one Gaussian; lane i of `basis` is its own. Three channels and a spare.
template <int last, class T>
inline Four sh_sum(const V* basis, int i, const T* row) {
  Four c[2] = {{R(0.5), R(0.5), R(0.5), 0}, {}};
  for (int k = 0; k < last; ++k) c[k % 2] += basis[k][i] * load_four(row + 3 * k);  // takes a value of the next coefficient along, ...
  const T* end = row + 3 * last;
  return c[0] + c[1] + basis[last][i] * Four{R(end[0]), R(end[1]), R(end[2]), 0};  // ... which the last one does not have
}

template <class T>
inline Four sh_colour(int degree, const V* basis, int i, const T* row) {
  switch (degree) {
    case 0: return sh_sum<0>(basis, i, row);
    case 1: return sh_sum<3>(basis, i, row);
    case 2: return sh_sum<8>(basis, i, row);
    default: return sh_sum<15>(basis, i, row);
  }
}

inline Four colour(const Frame& f, const V* basis, int i, uint32_t g) {
  const int64_t at = static_cast<int64_t>(g) * f.sh_coefficients * 3;
  return f.sh_half ? sh_colour(f.sh_degree, basis, i, static_cast<const _Float16*>(f.sh) + at) : sh_colour(f.sh_degree, basis, i, static_cast<const R*>(f.sh) + at);
}

inline bool finite(R x) { return std::fabs(x) <= std::numeric_limits<R>::max(); }
inline M finite(V x) { return at_least(splat(std::numeric_limits<R>::max()), magnitude(x)); }
inline bool sane(R colour) { return std::fabs(colour) <= R(kColourMax); }

inline Span tile_range(int begin, int end) { return {static_cast<uint16_t>(begin / kTile), static_cast<uint16_t>((end - 1) / kTile + 1)}; }

// W Gaussians on the screen: what Splat and SplatTiles hold, colours aside.
struct Screen {
  D x, y;
  V l11, l12, l22, log2_opacity, depth, inv_l11, y_extreme, slope;
  Reach columns, rows;
  M visible;
};

inline Screen to_screen(const Frame& f, const Batch& b) {
  const Projected p = project(f, b);
  const Whitening l = whitening(p);
  Screen s;
  const double* m = f.viewmat;
  const auto along = [&](int row) { return m[4 * row] * b.offset[0] + m[4 * row + 1] * b.offset[1] + m[4 * row + 2] * b.offset[2]; };
  const D z = along(2), inv = f.orthographic ? D{} + 1.0 : 1.0 / z;
  s.x = f.fx * along(0) * inv + f.cx, s.y = f.fy * along(1) * inv + f.cy;
  s.l11 = l.l11, s.l12 = l.l12, s.l22 = l.l22, s.log2_opacity = log2(p.opacity * p.compensation);
  s.depth = narrow(z);  // from double, so that all levels sort alike
  s.inv_l11 = splat(1) / l.l11, s.slope = -l.l12 * s.inv_l11;
  const V bound = reach2(f, s.log2_opacity), x = narrow(s.x), y = narrow(s.y), far = splat(R(1e9));
  s.y_extreme = -l.l12 * sqrt(bound) / (l.l22 * sqrt(fma(l.l22, l.l22, l.l12 * l.l12)));
  s.columns = reach(x, half_width(bound, l.l12, l.l22, s.inv_l11) + magnitude(x) * kRelativeMargin, f.width);
  s.rows = reach(y, half_height(bound, l.l22) + magnitude(y) * kRelativeMargin, f.height);
  const V zero = splat(0), quat_max = splat(R(kQuatMax)), quat_min = splat(R(1 / kQuatMax));
  M ok = both(less(splat(kReachMargin * R(0.5)), bound), both(less(zero, s.l11), less(zero, s.l22)));
  ok = both(ok, both(both(finite(s.l11), finite(s.l12)), both(finite(s.l22), finite(s.inv_l11))));
  ok = both(ok, both(finite(s.y_extreme), finite(b.log_scale[0] + b.log_scale[1] + b.log_scale[2])));
  ok = both(ok, both(both(less(p.inv_norm, quat_max), less(quat_min, p.inv_norm)), both(less(magnitude(x), far), less(magnitude(y), far))));
  s.visible = both(ok, both(less(s.columns.begin, s.columns.end), less(s.rows.begin, s.rows.end)));
  return s;
}

// Where the visible Gaussians of a range go, one after the other.
struct Projection {
  int64_t place;  // of the next one
  uint32_t *ids, *depth_keys;
};

// Projects n <= W Gaussians and adds the visible ones.
inline void project_batch(const Frame& f, uint32_t* ids, int n, Projection& out) {
  for (int i = n; i < W; ++i) ids[i] = ids[0];
  const Batch b = load_batch(f, ids);
  const Screen s = to_screen(f, b);
  V basis[16] = {};
  sh_basis(f.sh_degree, direction(f, b.mean).d, basis);
  for (uint32_t left = bits(s.visible) & ((1u << n) - 1); left; left &= left - 1) {
    const int i = __builtin_ctz(left);
    const uint32_t g = ids[i];
    Four c = colour(f, basis, i, g);
    if (!sane(c[0]) || !sane(c[1]) || !sane(c[2])) continue;
    c = c < 0 ? Four{} : c;
    const R mask = f.masks && !f.masks[g] ? R(0) : R(1);
    static_cast<Splat<R>*>(f.splats)[out.place] = {s.x[i], s.y[i], s.l11[i], s.l12[i], s.l22[i], s.log2_opacity[i], {c[0], c[1], c[2]}, s.depth[i],
                                                   s.inv_l11[i], s.y_extreme[i], mask, s.slope[i]};
    const Span rows = tile_range(static_cast<int>(s.rows.begin[i]), static_cast<int>(s.rows.end[i]));
    f.tiles[out.place] = {0, 0, rows.begin, static_cast<uint16_t>(rows.end - rows.begin),
                          tile_range(static_cast<int>(s.columns.begin[i]), static_cast<int>(s.columns.end[i])), 0};
    const float depth = static_cast<float>(s.depth[i]);
    __builtin_memcpy(out.depth_keys + out.place, &depth, 4);  // positive floats order as their bits
    out.ids[out.place++] = g;
  }
}

// Gaussians [begin, end): the visible ones' splats, ids and depth keys, from place `begin` on; returns their number.
int64_t project_range(const Frame& f, int64_t begin, int64_t end, uint32_t* ids, uint32_t* depth_keys) {
  Projection out = {begin, ids, depth_keys};
  uint32_t pending[W];
  int waiting = 0;
  for (int64_t first = begin; first < end; first += W) {
    for (uint32_t left = may_be_seen(f, first, static_cast<int>(std::min<int64_t>(W, end - first))); left; left &= left - 1) {
      const uint32_t g = static_cast<uint32_t>(first + __builtin_ctz(left));
      prefetch_sh(f, g);
      pending[waiting++] = g;
      if (waiting == W) project_batch(f, pending, W, out), waiting = 0;
    }
  }
  if (waiting) project_batch(f, pending, waiting, out);
  return out.place - begin;
}

// Stage 2: the exact tiles of one visible Gaussian of several tile rows, row by row; returns how many.
uint32_t fill_spans(const Frame& f, uint32_t place, Span* spans) {
  const Splat<R>& s = static_cast<const Splat<R>*>(f.splats)[place];
  const SplatTiles& t = f.tiles[place];
  if (f.without & SVRGS_EXACT_TILES) {
    std::fill_n(spans, t.rows, t.columns);
    return static_cast<uint32_t>(t.rows) * (t.columns.end - t.columns.begin);
  }
  const R bound = reach2(f, s.log2_opacity);
  uint32_t tiles = 0;
  for (int r = 0; r < t.rows; ++r) {
    const int y0 = (t.row + r) * kTile, y1 = std::min(y0 + kTile, f.height) - 1;
    const R low = static_cast<R>(y0 + 0.5 - s.y) - kBorderMargin, high = static_cast<R>(y1 + 0.5 - s.y) + kBorderMargin;
    const Extent<R> e = ellipse_extent<R>(bound, s.l22, s.inv_l11, s.slope, s.y_extreme, low, high);
    int x0, x1;
    const double left = e.left, right = e.right, middle = s.x + 0.5 * (left + right), half = 0.5 * (right - left) + double(kBorderMargin);
    spans[r] = {0, 0};
    if (e.depth < 0) continue;
    reach(middle, half, f.width, x0, x1);
    if (x0 >= x1) continue;
    spans[r] = tile_range(x0, x1);
    tiles += spans[r].end - spans[r].begin;
  }
  return tiles;
}

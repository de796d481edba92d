// Stage 1: cull, project, colour. The only visibility gate: comparisons are written so that NaN fails them.

// Pixels [begin, end) of a row or column of `size` that centre +- half covers, none where begin >= end. `half` has a margin for the
// rounding of the centre.
struct Reach {
  V begin, end;
};

inline Reach reach(V centre, V half, int size) {
  const V zero = splat(0), full = splat(static_cast<R>(size));
  const V low = clamp(centre - half - R(0.5), zero, full), high = clamp(centre + half - R(0.5), splat(-1), full);
  return {ceil(low), min(floor(high) + R(1), full)};
}

// Half the width or height of the ellipse u^2 + v^2 <= bound, given the variance along it, with a margin for the rounding of the two.
inline V half_side(V root_bound, V root_variance) { return root_bound * root_variance * (kWhiten * (1 + kRelativeMargin)) + kBorderMargin; }

const R kLargestReach = kWhiten * std::sqrt(kReachMargin - R(kLog2Cut));  // of an opaque Gaussian, in standard deviations
// Bound of u^2 + v^2 within the ellipse; of one Gaussian or of W.
template <class T>
inline T reach2(const Frame& f, T log2_opacity) {
  return (f.without & SVRGS_OPACITY_BOUNDS ? T{} : log2_opacity) + (kReachMargin - R(kLog2Cut));
}

constexpr int kStretch = 128;        // Gaussians looked at before those of them that may be seen are projected
constexpr int kInputsFetched = 128;  // how many ahead what is looked at is fetched
constexpr int kFetched = 32;         // of those that may be seen, how many ahead SH rows are fetched

// Asks for so many bytes: SH rows are far apart where not every Gaussian is visible, and the processor does not foresee them.
// Always inline: GCC drops calls of a function that does nothing else.
template <int bytes>
[[gnu::always_inline]] inline void fetch(const void* p) {
  for (int k = 0; k < bytes; k += 64) __builtin_prefetch(static_cast<const char*>(p) + k);
}

// W rows of `width` values.
template <int width>
[[gnu::always_inline]] inline void fetch_rows(const void* array, int64_t first) {
  fetch<W * width * sizeof(R)>(static_cast<const R*>(array) + first * width);
}

// The first n of W rows of `width` values, in columns; what lies behind the scene's end is 0.
template <int width>
inline void columns_from(const void* array, int64_t first, int n, V* columns) {
  const R* at = static_cast<const R*>(array) + first * width;
  if (n >= W) return columns_of<width>(at, columns);
  R spare[W * width] = {};
  std::copy_n(at, n * width, spare);
  columns_of<width>(spare, columns);
}

// Which of W Gaussians may be seen: in front of the camera, not too faint, and near enough to the image. One bit each.
// It errs on the side of projecting: a ball of the largest scale, fully opaque, bounds the ellipse, and `doubt` what rounding may do.
inline uint32_t may_be_seen(const Frame& f, const Eye& e, const V offset[3], V largest_scale, V opacity_logit) {
  const V x = e.along(0, offset), y = e.along(1, offset), z = e.along(2, offset);
  const V depth = max(z, splat(R(kNear))), slack = (magnitude(x) + magnitude(y) + depth) * R(1e-5);
  const V inv = e.inverse_depth(depth), rx = x * inv, ry = y * inv, doubt = fma(slack, inv, splat(R(1e-3)));
  V stretch = splat(1);  // of what a slanting ray meets
  if (!e.orthographic) {
    const V tx = min(magnitude(rx), splat(std::max(-e.low_x, e.high_x))), ty = min(magnitude(ry), splat(std::max(-e.low_y, e.high_y)));
    stretch = splat(1) + tx * tx + ty * ty;
  }
  const V size = exp(largest_scale) * splat(std::max(e.fx, e.fy)) * inv;  // across the view, pixels
  const V radius = splat(kLargestReach) * sqrt(fma(size * size, stretch, splat(R(kBlur))));
  const V px = fma(rx, splat(e.fx), splat(R(f.cx))), py = fma(ry, splat(e.fy), splat(R(f.cy)));
  const V spread_x = fma(radius + magnitude(px), doubt, radius + R(1)), spread_y = fma(radius + magnitude(py), doubt, radius + R(1));
  const M outside = either(either(less(px + spread_x, splat(0)), less(splat(R(f.width)), px - spread_x)),
                           either(less(py + spread_y, splat(0)), less(splat(R(f.height)), py - spread_y)));
  const M off = and_not(less(splat(R(0.1)), doubt), outside);
  return bits(both(and_not(off, less(splat(R(kNear)), z + slack)), at_least(opacity_logit, splat(R(kLogitCut)))));
}

constexpr int kSide = W / 4;  // SH coefficients that lie side by side in a vector, three values each

// Adds basis_k sh_k of one Gaussian, from the block-th vector of coefficients on, to lanes 3 apart. basis[k], k = 0, 4, 8 ...: in the
// quad-th four lanes its values of four coefficients.
template <int used, int quad, int block = 0>
inline V sh_sum(const V* basis, const R* row, V sum) {
  constexpr int first = block * kSide, left = 3 * (used - first);
  if constexpr (left <= 0) {
    return sum;
  } else {
    const V four = basis[first / 4 * 4], weights = shuffle(four, four, [](int lane) { return 4 * quad + first % 4 + std::min(lane / 3, kSide - 1); });
    V values;
    if constexpr (left >= W)
      values = load(row + 3 * first);
    else
      values = load_first<left>(row + 3 * first);
    return sh_sum<used, quad, block + 1>(basis, row, fma(weights, values, sum));
  }
}

// The same for W Gaussians, four after four; what lies behind them is fetched.
template <int used, int quad = 0, class Row>
[[gnu::always_inline]] inline void sh_sums(const V* basis, Row row, V* sums) {
  if constexpr (quad < W / 4) {
    for (int i = 0; i < 4; ++i) {
      fetch<3 * used * sizeof(R)>(row(4 * quad + i + kFetched));
      sums[4 * quad + i] = sh_sum<used, quad>(basis + i, row(4 * quad + i), splat(0));
    }
    sh_sums<used, quad + 1>(basis, row, sums);
  }
}

// Adds the first and the second half of what counts, three lanes of four, in each `size` lanes of a and of b: those of a come to lie
// before those of b, in half as many lanes each.
template <int size>
constexpr int lane_of_half(int lane, int half) {
  const int group = lane / (size / 2), at = lane % (size / 2), counts = 3 * size / 8;
  return at < counts ? group % 2 * W + group / 2 * size + half * counts + at : -1;
}
template <int size>
inline V fold_pair(V a, V b) {
  return shuffle(a, b, [](int lane) { return lane_of_half<size>(lane, 0); }) + shuffle(a, b, [](int lane) { return lane_of_half<size>(lane, 1); });
}
// W rows of kSide coefficients, three values each, become their sums: those of rows i, i + 4, i + 8 ... in rows[i], four lanes each.
template <int size = W>
[[gnu::always_inline]] inline void fold_rows(V* rows) {
  if constexpr (size > 4) {
    for (int i = 0; i < size / 2; ++i) rows[i] = fold_pair<size>(rows[i], rows[i + size / 2]);
    fold_rows<size / 2>(rows);
  }
}
// One lane of every four of rows[0..3], in the order of the rows they were.
template <int lane>
inline V fourth(const V* rows) {
  constexpr auto pair = [](int l) { return l % 2 * W + l / 4 * 4 + lane; };
  return shuffle(shuffle(rows[0], rows[1], pair), shuffle(rows[2], rows[3], pair), [](int l) { return l % 4 < 2 ? l : W + l - 2; });
}

// Colours of W Gaussians, before they are clamped; what lies behind them in `ids` is fetched.
template <int degree>
[[gnu::always_inline]] inline void colours(const Frame& f, const V direction[3], const uint32_t* ids, const R* sh, V rgb[3]) {
  constexpr int used = (degree + 1) * (degree + 1);
  const auto row = [&](int i) { return sh + static_cast<int64_t>(ids[i]) * f.sh_coefficients * 3; };
  V basis[kRow];
  sh_basis(degree, direction, basis);
  if constexpr (W >= 4) {
    for (int k = used; k < kRow; ++k) basis[k] = splat(0);
    for (int part = 0; part < used; part += W) transpose<2>(basis + part);
    V sums[W];
    sh_sums<used>(basis, row, sums);
    fold_rows(sums);
    rgb[0] = fourth<0>(sums), rgb[1] = fourth<1>(sums), rgb[2] = fourth<2>(sums);
  } else {
    for (int c = 0; c < 3; ++c) rgb[c] = splat(0);
    for (int c = 0; c < 3; ++c)
      for (int k = 0; k < used; ++k) rgb[c][0] += basis[k][0] * row(0)[3 * k + c];
  }
  for (int c = 0; c < 3; ++c) rgb[c] += R(0.5);  // last: what is summed is smaller, and rounds less
}

inline void colours(const Frame& f, const V direction[3], const uint32_t* ids, V rgb[3]) {
  const R* sh = static_cast<const R*>(f.sh);
  switch (f.sh_degree) {
    case 0: return colours<0>(f, direction, ids, sh, rgb);
    case 1: return colours<1>(f, direction, ids, sh, rgb);
    case 2: return colours<2>(f, direction, ids, sh, rgb);
    default: return colours<3>(f, direction, ids, sh, rgb);
  }
}

inline M finite(V x) { return at_least(splat(std::numeric_limits<R>::max()), magnitude(x)); }
inline M sane(V colour) { return at_least(splat(R(kColourMax)), magnitude(colour)); }

// The first of them, and the one behind the last, for vectors of whole numbers with begin < end.
struct TileRange {
  U begin, end;
};
inline TileRange tile_range(const Reach& r) {
  const auto tile = [](V pixel) { return (U)__builtin_convertvector(pixel, I) / kTile; };
  return {tile(r.begin), tile(r.end - R(1)) + 1};
}

// W Gaussians on the screen: what Splat and SplatTiles hold, colours aside.
struct Screen {
  D x, y;
  V l11, l12, l22, log2_opacity, depth, inv_l11, y_extreme, slope;
  Reach columns, rows;
  M visible;
};

[[gnu::always_inline]] inline Screen to_screen(const Frame& f, const Eye& e, const Batch& b) {
  const Projected p = project(e, b);
  const Whitening l = whitening(p);
  Screen s;
  const double* m = f.viewmat;
  const auto along = [&](int row) { return m[4 * row] * b.offset[0] + m[4 * row + 1] * b.offset[1] + m[4 * row + 2] * b.offset[2]; };
  const D z = along(2), inv = f.orthographic ? D{} + 1.0 : 1.0 / z;
  s.x = f.fx * along(0) * inv + f.cx, s.y = f.fy * along(1) * inv + f.cy;
  s.l11 = l.l11, s.l12 = l.l12, s.l22 = l.l22, s.log2_opacity = log2(p.opacity * p.compensation);
  s.depth = narrow(z);  // from double, so that all levels sort alike
  s.inv_l11 = l.inv_l11, s.slope = l.ratio;
  const V bound = reach2(f, s.log2_opacity), root_bound = sqrt(bound), root_cxx = sqrt(p.cxx), root_cyy = sqrt(p.cyy);
  const V x = narrow(s.x), y = narrow(s.y), far = splat(R(1e9));
  s.y_extreme = p.cxy * root_bound * kWhiten * reciprocal(root_cxx);
  s.columns = reach(x, half_side(root_bound, root_cxx) + magnitude(x) * kRelativeMargin, f.width);
  s.rows = reach(y, half_side(root_bound, root_cyy) + magnitude(y) * kRelativeMargin, f.height);
  const V zero = splat(0), quat_max = splat(R(kQuatMax)), quat_min = splat(R(1 / kQuatMax));
  M ok = both(less(splat(kReachMargin * R(0.5)), bound), both(less(zero, s.l11), less(zero, s.l22)));
  ok = both(ok, finite(s.l11 + magnitude(s.l12) + s.l22 + s.inv_l11 + magnitude(s.y_extreme)));
  ok = both(ok, finite(b.log_scale[0] + b.log_scale[1] + b.log_scale[2]));
  ok = both(ok, both(both(less(p.inv_norm, quat_max), less(quat_min, p.inv_norm)), both(less(magnitude(x), far), less(magnitude(y), far))));
  ok = both(ok, both(less(splat(R(kNear)), s.depth), less(s.depth, splat(R(kFar)))));
  s.visible = both(ok, both(less(s.columns.begin, s.columns.end), less(s.rows.begin, s.rows.end)));
  return s;
}

constexpr int kPending = 3 * kStretch + 2 * W + kFetched;  // room, so that those that wait are moved seldom

// Gaussians of a range on their way: those that may be seen, in columns, and where the visible ones go, one after the other.
struct Projection {
  alignas(64) R numbers[kNumbers][kPending], masks[kPending];  // as far as they wait
  uint32_t ids[kPending] = {};
  int first = 0, last = 0;  // of those that wait, and behind them
  int64_t place;            // of the next visible one
  int64_t rows = 0;         // Found::rows so far
  uint32_t *visible, *depth_keys;
};

// A splat's values in columns, in the order of Splat.
inline void splat_columns(const Screen& s, const V rgb[3], V mask, V* columns) {
  constexpr int words = sizeof(double) / sizeof(R);  // of a centre's coordinate
  columns_of<words>(reinterpret_cast<const R*>(&s.x), columns), columns_of<words>(reinterpret_cast<const R*>(&s.y), columns + words);
  const V rest[] = {s.l11, s.l12, s.l22, s.log2_opacity, rgb[0], rgb[1], rgb[2], s.depth, s.inv_l11, s.y_extreme, mask, s.slope};
  std::copy_n(rest, 12, columns + 2 * words);
  std::fill(columns + 2 * words + 12, columns + kRow, splat(0));
}

// Projects the n <= W Gaussians that wait from `first` on and adds the visible ones.
[[gnu::always_inline]] inline void project_batch(const Frame& f, const Eye& e, int first, int n, Projection& out) {
  V rgb[3], columns[kRow], numbers[kNumbers];
  for (int k = 0; k < kNumbers; ++k) numbers[k] = load(out.numbers[k] + first);
  const Batch b = batch_of(f, numbers);
  const Screen s = to_screen(f, e, b);
  const uint32_t* ids = out.ids + first;
  uint32_t visible = bits(s.visible) & ((1u << n) - 1);
  colours(f, direction(e, b.mean).d, ids, rgb);
  visible &= bits(both(sane(rgb[0]), both(sane(rgb[1]), sane(rgb[2]))));
  for (V& channel : rgb) channel = max(channel, splat(0));
  splat_columns(s, rgb, f.masks ? load(out.masks + first) : splat(1), columns);
  alignas(64) R rows[W * kRow];
  rows_of(columns, rows);
  const TileRange down = tile_range(s.rows), across = tile_range(s.columns);
  const U rows_word = down.begin | (down.end - down.begin) << 16, columns_word = across.begin | across.end << 16;
  int64_t place = out.place;
  for (uint32_t left = visible; left; left &= left - 1, ++place) {
    const int i = __builtin_ctz(left);
    stream_row(rows + kRow * i, static_cast<Splat<R>*>(f.splats) + place);
    TileRect& t = f.rects[place];
    const uint32_t words[] = {static_cast<uint32_t>(rows_word[i]), static_cast<uint32_t>(columns_word[i])};
    __builtin_memcpy(&t.row, words, sizeof words);  // row, rows, columns
    out.rows += span_rows(t);
    const float depth = static_cast<float>(s.depth[i]);
    __builtin_memcpy(out.depth_keys + place, &depth, 4);  // positive floats order as their bits
    out.visible[place] = ids[i];
  }
  out.place = place;
}

// 1 or 0 of each; those behind the scene's end are 0.
inline V load_masks(const Frame& f, int64_t first, int n) {
  int8_t __attribute__((vector_size(W))) bytes = {};
  if (n == W)
    __builtin_memcpy(&bytes, f.masks + first, W);  // a load, not a call
  else
    __builtin_memcpy(&bytes, f.masks + first, static_cast<size_t>(n));
  return -__builtin_convertvector(__builtin_convertvector(bytes != 0, I), V);  // by way of I: else lane by lane
}

// Adds those of the n <= W Gaussians from `first` on that may be seen to those that wait.
inline void enqueue(const Frame& f, const Eye& e, int64_t first, int n, Projection& p) {
  const int64_t coming = first + kInputsFetched;
  V numbers[kNumbers];
  V *means = numbers, *scales = numbers + 3;
  if (coming < f.count) fetch_rows<3>(f.means, coming), fetch_rows<3>(f.log_scales, coming), fetch_rows<1>(f.opacity_logits, coming);
  if (f.masks && coming < f.count) __builtin_prefetch(f.masks + coming);
  columns_from<3>(f.means, first, n, means);
  columns_from<3>(f.log_scales, first, n, scales);
  columns_from<1>(f.opacity_logits, first, n, numbers + 10);
  V offset[3];
  for (int k = 0; k < 3; ++k) offset[k] = means[k] - splat(e.position[k]) - splat(e.position_rest[k]);
  const uint32_t set = may_be_seen(f, e, offset, max(max(scales[0], scales[1]), scales[2]), numbers[10]) & ((1u << n) - 1);
  if (!set) return;
  if (coming < f.count) fetch_rows<4>(f.quats, coming);
  columns_from<4>(f.quats, first, n, numbers + 6);
  const int at = p.last;
  for (int k = 0; k < kNumbers; ++k) pack(set, numbers[k], p.numbers[k] + at);
  if (f.masks) pack(set, load_masks(f, first, n), p.masks + at);
  pack_lanes(set, static_cast<uint32_t>(first), p.ids + at);
  p.last = at + __builtin_popcount(set);
}

// Projects those that wait, as long as `enough` do, and makes room for the next stretch.
inline void project_waiting(const Frame& f, const Eye& e, int enough, Projection& p) {
  for (; p.last - p.first >= enough; p.first += W) project_batch(f, e, p.first, std::min(W, p.last - p.first), p);
  if (p.last + kStretch + W <= kPending) return;
  for (int i = 0; i < W + kFetched; i += W) {
    for (R* numbers : p.numbers) store(numbers + i, load(numbers + i + p.first));
    if (f.masks) store(p.masks + i, load(p.masks + i + p.first));
  }
  std::copy_n(p.ids + p.first, W + kFetched, p.ids);
  p.last -= p.first, p.first = 0;
}

// Gaussians [begin, end): the visible ones' splats, ids and depth keys, from place `begin` on. Their pairs are not counted yet.
Found project_range(const Frame& f, int64_t begin, int64_t end, uint32_t* visible, uint32_t* depth_keys) {
  const Eye e(f);
  Projection p;
  p.place = begin, p.visible = visible, p.depth_keys = depth_keys;
  for (int64_t from = begin; from < end; from += kStretch) {
    const int64_t until = std::min(from + kStretch, end);
    for (int64_t first = from; first < until; first += W) enqueue(f, e, first, static_cast<int>(std::min<int64_t>(W, until - first)), p);
    for (R* numbers : p.numbers) store(numbers + p.last, splat(0));  // the very last batch may hold fewer than W
    store(p.masks + p.last, splat(0));
    project_waiting(f, e, until < end ? W + kFetched : 1, p);
  }
  end_of_stream();
  return {p.place - begin, p.rows};
}

// Stage 2: the exact tiles of one visible Gaussian of several tile rows, W rows at a time; returns how many.
uint32_t fill_spans(const Frame& f, uint32_t place, Span* spans) {
  const Splat<R>& s = static_cast<const Splat<R>*>(f.splats)[place];
  const TileRect& t = f.rects[place];
  if (f.without & SVRGS_EXACT_TILES) {
    std::fill_n(spans, t.rows, t.columns);
    return static_cast<uint32_t>(t.rows) * (t.columns.end - t.columns.begin);
  }
  const V bound = splat(reach2(f, s.log2_opacity)), margin = splat(kBorderMargin), x = splat(static_cast<R>(s.x));
  const V bottom = splat(static_cast<R>(f.height - 0.5 - s.y));
  uint32_t tiles = 0;
  for (int r = 0; r < t.rows; r += W) {
    const V low = splat(static_cast<R>((t.row + r) * kTile + 0.5 - s.y)) + iota() * R(kTile), high = min(low + R(kTile - 1), bottom);
    const Extent e = ellipse_extent(bound, splat(s.l22), splat(s.inv_l11), splat(s.slope), splat(s.y_extreme), low - margin, high + margin);
    const V centre = x + (e.left + e.right) * R(0.5), half = (e.right - e.left) * R(0.5) + margin + magnitude(centre) * kRelativeMargin;
    const Reach columns = reach(centre, half, f.width);
    const M crosses = both(at_least(e.depth, splat(0)), less(columns.begin, columns.end));
    const TileRange across = tile_range(columns);
    const U words = (U)keep(crosses, (V)(across.begin | across.end << 16)), counts = (U)keep(crosses, (V)(across.end - across.begin));
    for (int i = 0; i < std::min(W, t.rows - r); ++i) {
      const uint32_t word = static_cast<uint32_t>(words[i]);
      __builtin_memcpy(spans + r + i, &word, sizeof word);
      tiles += static_cast<uint32_t>(counts[i]);
    }
  }
  return tiles;
}

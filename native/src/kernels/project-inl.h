// Stage 1c: projects the Gaussians that may be visible and writes those that are. No other place decides what is visible. NaN fails every
// comparison here.

inline M finite(V x) { return at_least(broadcast(std::numeric_limits<R>::max()), magnitude(x)); }
inline M sane(V colour) { return at_least(broadcast(R(kColourMax)), magnitude(colour)); }

// W Gaussians on the screen: the values of ProjectedGaussian and TileRect, except colours.
struct ScreenGaussians {
  D x, y;
  V l11, l12, l22, log2_opacity, depth, inv_l11, y_extreme, slope;
  PixelRange columns, rows;
  M visible;
};

[[gnu::always_inline]] inline ScreenGaussians to_screen(const Frame& f, const CameraParams& camera, const Batch& b) {
  const Projection p = project(camera, b);
  const Whitening l = whitening(p);
  ScreenGaussians s;
  const double* m = f.viewmat;
  const auto along = [&](int row) { return m[4 * row] * b.offset[0] + m[4 * row + 1] * b.offset[1] + m[4 * row + 2] * b.offset[2]; };
  const D z = along(2), inv = f.orthographic ? D{} + 1.0 : 1.0 / z;
  s.x = f.fx * along(0) * inv + f.cx, s.y = f.fy * along(1) * inv + f.cy;
  s.l11 = l.l11, s.l12 = l.l12, s.l22 = l.l22, s.log2_opacity = log2(p.opacity * p.compensation);
  s.depth = narrow(z);  // from double, so that all levels sort alike
  s.inv_l11 = l.inv_l11, s.slope = l.ratio;
  const V bound = ellipse_bound(f, s.log2_opacity), root_bound = sqrt(bound), root_cxx = sqrt(p.cxx), root_cyy = sqrt(p.cyy);
  const V x = narrow(s.x), y = narrow(s.y), far = broadcast(R(1e9));
  s.y_extreme = p.cxy * root_bound * kWhiten * reciprocal(root_cxx);
  s.columns = pixel_range(x, half_extent(root_bound, root_cxx) + magnitude(x) * kRelativeMargin, f.window.left, f.window.right);
  s.rows = pixel_range(y, half_extent(root_bound, root_cyy) + magnitude(y) * kRelativeMargin, f.window.top, f.window.bottom);
  const V zero = broadcast(0), quat_max = broadcast(R(kQuatMax)), quat_min = broadcast(R(1 / kQuatMax));
  M ok = both(less(broadcast(kBoundMargin * R(0.5)), bound), both(less(zero, s.l11), less(zero, s.l22)));
  ok = both(ok, finite(s.l11 + magnitude(s.l12) + s.l22 + s.inv_l11 + magnitude(s.y_extreme)));
  ok = both(ok, finite(b.log_scale[0] + b.log_scale[1] + b.log_scale[2]));
  ok = both(ok, both(both(less(p.inv_norm, quat_max), less(quat_min, p.inv_norm)), both(less(magnitude(x), far), less(magnitude(y), far))));
  ok = both(ok, both(less(broadcast(R(f.near_depth)), s.depth), less(s.depth, broadcast(R(kFar)))));
  s.visible = both(ok, both(less(s.columns.begin, s.columns.end), less(s.rows.begin, s.rows.end)));
  return s;
}

constexpr int kCulledAtOnce = 128;  // Gaussians looked at before those of them that may be seen are projected

constexpr int kQueueRoom = 3 * kCulledAtOnce + 2 * W + kShRowsAhead;  // room, so that those that wait are moved seldom

// Gaussians of a range that may be visible and wait to be projected, in columns; and where the next visible one is written.
struct ProjectionQueue {
  alignas(64) R numbers[kNarrowParameters][kQueueRoom], masks[kQueueRoom];  // as far as they wait
  uint32_t ids[kQueueRoom] = {};
  int first = 0, last = 0;  // of those that wait, and behind them
  int64_t place;            // of the next visible one
  int64_t rows = 0;         // ProjectionCounts::rows so far
  uint32_t *visible, *depth_keys;
};

// Values of W projected Gaussians in columns, in the order of ProjectedGaussian.
inline void record_columns(const ScreenGaussians& s, const V rgb[3], V mask, V* columns) {
  constexpr int words = sizeof(double) / sizeof(R);  // of a centre's coordinate
  columns_of<words>(reinterpret_cast<const R*>(&s.x), columns), columns_of<words>(reinterpret_cast<const R*>(&s.y), columns + words);
  const V rest[] = {s.l11, s.l12, s.l22, s.log2_opacity, rgb[0], rgb[1], rgb[2], s.depth, s.inv_l11, s.y_extreme, mask, s.slope};
  std::copy_n(rest, 12, columns + 2 * words);
  std::fill(columns + 2 * words + 12, columns + kPaddedRow, broadcast(0));
}

// Projects n <= W waiting Gaussians, from `first` on, and writes the visible ones.
[[gnu::always_inline]] inline void project_batch(const Frame& f, const CameraParams& camera, int first, int n, ProjectionQueue& out) {
  V rgb[3], columns[kPaddedRow], numbers[kNarrowParameters];
  for (int k = 0; k < kNarrowParameters; ++k) numbers[k] = load(out.numbers[k] + first);
  const Batch b = batch_of(f, numbers);
  const ScreenGaussians s = to_screen(f, camera, b);
  const uint32_t* ids = out.ids + first;
  uint32_t visible = bits(s.visible) & ((1u << n) - 1);
  colours(f, direction(camera, b.mean).d, ids, rgb);
  visible &= bits(both(sane(rgb[0]), both(sane(rgb[1]), sane(rgb[2]))));
  for (V& channel : rgb) channel = max(channel, broadcast(0));
  record_columns(s, rgb, f.masks ? load(out.masks + first) : broadcast(1), columns);
  alignas(64) R rows[W * kPaddedRow];
  rows_of(columns, rows);
  const TileRange down = tile_range(s.rows), across = tile_range(s.columns);
  const U rows_word = down.begin | (down.end - down.begin) << 16, columns_word = across.begin | across.end << 16;
  int64_t place = out.place;
  for (uint32_t left = visible; left; left &= left - 1, ++place) {
    const int i = __builtin_ctz(left);
    stream_row(rows + kPaddedRow * i, static_cast<ProjectedGaussian<R>*>(f.gaussians) + place);
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

// The masks of n <= W Gaussians, 0 or 1; lanes from n on are 0.
inline V load_masks(const Frame& f, int64_t first, int n) {
  int8_t __attribute__((vector_size(W))) bytes = {};
  if (n == W)
    __builtin_memcpy(&bytes, f.masks + first, W);  // a load, not a call
  else
    __builtin_memcpy(&bytes, f.masks + first, static_cast<size_t>(n));
  const I words = __builtin_convertvector(bytes, I);  // compared as I: bytes compare to a vector of char, which has no sign on arm64
  return __builtin_convertvector((words != 0) & 1, V);
}

// Of the n <= W Gaussians from `first` on, adds those that may be visible to the queue.
inline void enqueue(const Frame& f, const CameraParams& camera, int64_t first, int n, ProjectionQueue& p) {
  const int64_t coming = first + kParametersAhead;
  V numbers[kNarrowParameters];
  V *means = numbers, *scales = numbers + 3;
  if (coming < f.count) fetch_rows<3>(f.means, coming), fetch_rows<3>(f.log_scales, coming), fetch_rows<1>(f.opacity_logits, coming);
  if (f.masks && coming < f.count) __builtin_prefetch(f.masks + coming);
  columns_from<3>(f.means, first, n, means);
  columns_from<3>(f.log_scales, first, n, scales);
  columns_from<1>(f.opacity_logits, first, n, numbers + 10);
  V offset[3];
  for (int k = 0; k < 3; ++k) offset[k] = means[k] - broadcast(camera.position[k]) - broadcast(camera.position_rest[k]);
  const uint32_t set = may_be_seen(f, camera, offset, max(max(scales[0], scales[1]), scales[2]), numbers[10]) & ((1u << n) - 1);
  if (!set) return;
  if (coming < f.count) fetch_rows<4>(f.quats, coming);
  columns_from<4>(f.quats, first, n, numbers + 6);
  const int at = p.last;
  for (int k = 0; k < kNarrowParameters; ++k) pack(set, numbers[k], p.numbers[k] + at);
  if (f.masks) pack(set, load_masks(f, first, n), p.masks + at);
  pack_lanes(set, static_cast<uint32_t>(first), p.ids + at);
  p.last = at + lane_count(set);
}

// Projects waiting Gaussians while at least `enough` wait, then makes room for the next kCulledAtOnce.
inline void project_waiting(const Frame& f, const CameraParams& camera, int enough, ProjectionQueue& p) {
  for (; p.last - p.first >= enough; p.first += W) project_batch(f, camera, p.first, std::min(W, p.last - p.first), p);
  if (p.last + kCulledAtOnce + W <= kQueueRoom) return;
  const int waiting = std::max(p.last - p.first, 0);  // no more than that is read: the queue may end there
  for (int i = 0; i < waiting; i += W) {
    for (R* numbers : p.numbers) store(numbers + i, load(numbers + i + p.first));
    if (f.masks) store(p.masks + i, load(p.masks + i + p.first));
  }
  std::copy_n(p.ids + p.first, waiting, p.ids);
  p.last = waiting, p.first = 0;
}

// Gaussians [begin, end): writes the visible ones, their ids and depth keys, from place `begin` on. Their
// (Gaussian, tile) pairs are not counted yet.
ProjectionCounts project_range(const Frame& f, int64_t begin, int64_t end, uint32_t* visible, uint32_t* depth_keys) {
  const CameraParams camera(f);
  ProjectionQueue p;
  p.place = begin, p.visible = visible, p.depth_keys = depth_keys;
  for (int64_t from = begin; from < end; from += kCulledAtOnce) {
    const int64_t until = std::min(from + kCulledAtOnce, end);
    for (int64_t first = from; first < until; first += W) enqueue(f, camera, first, static_cast<int>(std::min<int64_t>(W, until - first)), p);
    for (R* numbers : p.numbers) store(numbers + p.last, broadcast(0));  // the very last batch may hold fewer than W
    store(p.masks + p.last, broadcast(0));
    project_waiting(f, camera, until < end ? W + kShRowsAhead : 1, p);
  }
  end_of_stream();
  return {p.place - begin, p.rows};
}

// Stage 1a: which Gaussians may be seen. A quick test on means, scales and opacities; the visible ones are found by project-inl.h.

constexpr int kParametersAhead = 128;  // how many ahead what is looked at is fetched

// Prefetches so many bytes. The hardware does not predict these accesses: only some Gaussians are visible, and their rows are far apart.
// Always inline: GCC drops calls of a function that only prefetches.
template <int bytes>
[[gnu::always_inline]] inline void fetch(const void* p) {
  for (int k = 0; k < bytes; k += 64) __builtin_prefetch(static_cast<const char*>(p) + k);
}

// Prefetches W rows of `width` values.
template <int width>
[[gnu::always_inline]] inline void fetch_rows(const void* array, int64_t first) {
  fetch<W * width * sizeof(R)>(static_cast<const R*>(array) + first * width);
}

// n <= W rows of `width` values as columns; lanes from n on are 0.
template <int width>
inline void columns_from(const void* array, int64_t first, int n, V* columns) {
  const R* at = static_cast<const R*>(array) + first * width;
  if (n >= W) return columns_of<width>(at, columns);
  R spare[W * width] = {};
  std::copy_n(at, n * width, spare);
  columns_of<width>(spare, columns);
}

// Which of W Gaussians may be visible, a bit each: in front of the camera, not too faint, and near enough to the window. The test is
// conservative: the ellipse is bounded by that of an opaque ball with the largest scale, and `doubt` bounds the rounding errors.
inline uint32_t may_be_seen(const Frame& f, const CameraParams& camera, const V offset[3], V largest_scale, V opacity_logit) {
  const V x = camera.along(0, offset), y = camera.along(1, offset), z = camera.along(2, offset);
  const V depth = max(z, broadcast(R(f.near_depth))), slack = (magnitude(x) + magnitude(y) + depth) * R(1e-5);
  const V inv = camera.inverse_depth(depth), rx = x * inv, ry = y * inv, doubt = fma(slack, inv, broadcast(R(1e-3)));
  V stretch = broadcast(1);  // of what a slanting ray meets
  if (!camera.orthographic) {
    const V tx = min(magnitude(rx), broadcast(std::max(-camera.low_x, camera.high_x))),
            ty = min(magnitude(ry), broadcast(std::max(-camera.low_y, camera.high_y)));
    stretch = broadcast(1) + tx * tx + ty * ty;
  }
  const V size = exp(largest_scale) * broadcast(std::max(camera.fx, camera.fy)) * inv;  // across the view, pixels
  const V radius = broadcast(kLargestDistance) * sqrt(fma(size * size, stretch, broadcast(R(kBlur))));
  const V px = fma(rx, broadcast(camera.fx), broadcast(R(f.cx))), py = fma(ry, broadcast(camera.fy), broadcast(R(f.cy)));
  const V spread_x = fma(radius + magnitude(px), doubt, radius + R(1)), spread_y = fma(radius + magnitude(py), doubt, radius + R(1));
  const M outside = either(either(less(px + spread_x, broadcast(R(f.window.left))), less(broadcast(R(f.window.right)), px - spread_x)),
                           either(less(py + spread_y, broadcast(R(f.window.top))), less(broadcast(R(f.window.bottom)), py - spread_y)));
  const M off = and_not(less(broadcast(R(0.1)), doubt), outside);
  return bits(both(and_not(off, less(broadcast(R(f.near_depth)), z + slack)), at_least(opacity_logit, broadcast(R(kLogitCut)))));
}

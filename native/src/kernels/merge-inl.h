// Merging of two Gaussians into one, and how much that changes the pictures, W pairs at a time (svrgs_decimate in svrgs.h).
//
// A Gaussian adds amplitude G(x) (colour - colour behind) to a picture. The change is the integral of |a + b - m|^2 over the screen, mean of
// the views along the three axes; it is a sum of integrals of products of two Gaussians, which are known:
//   integral of G_a G_b = 2 pi sqrt(|A| |B| / |A + B|) exp(-d^T (A + B)^-1 d / 2)

struct MergeVectors {  // W rows
  V mean[3], cov[6], amplitude, transmittance, blur, area, colour[3];
  V density, contribution, sh_square, error;
};
constexpr int kMergeMore = 4;  // values of the second cache line of a row that are needed

inline MergeVectors merge_vectors(const MergeRow* rows, const uint32_t* ids, int64_t count) {
  alignas(64) R first[W * kPaddedRow], second[W * kPaddedRow];
  for (int i = 0; i < W; ++i) {
    float numbers[2 * kPaddedRow];
    __builtin_memcpy(numbers, rows + ids[std::min<int64_t>(i, count - 1)], sizeof numbers);
    for (int k = 0; k < kPaddedRow; ++k) first[kPaddedRow * i + k] = R(numbers[k]);
    for (int k = 0; k < kPaddedRow; ++k) second[kPaddedRow * i + k] = k < kMergeMore ? R(numbers[kPaddedRow + k]) : R(0);
  }
  V a[kPaddedRow], b[kPaddedRow];
  columns_of_rows(first, a), columns_of_rows<kMergeMore>(second, b);
  return {{a[0], a[1], a[2]}, {a[3], a[4], a[5], a[6], a[7], a[8]}, a[9], a[10], a[11], a[12], {a[13], a[14], a[15]}, b[0], b[1], b[2], b[3]};
}

// The covariance on the screen of a view along an axis: entries of `cov`, the first two of which get the blur; and where the offset lies.
constexpr int kViews[3][3] = {{3, 5, 4}, {0, 5, 2}, {0, 3, 1}}, kAcross[3] = {1, 0, 0}, kDown[3] = {2, 2, 1};
struct ScreenCov {
  V xx, yy, xy;
  V det() const { return max(fnma(xy, xy, xx * yy), broadcast(R(1e-30))); }
};
inline ScreenCov screen_cov(const V cov[6], V blur, int view) { return {cov[kViews[view][0]] + blur, cov[kViews[view][1]] + blur, cov[kViews[view][2]]}; }

inline V area_of(const V cov[6], V blur) {
  V sum = broadcast(0);
  for (int view = 0; view < 3; ++view) sum += sqrt(screen_cov(cov, blur, view).det());
  return sum * broadcast(R(2.0943951023931953));  // 2 pi / 3
}

inline V quotient(V a, V b) { return a / max(b, broadcast(R(1e-30))); }

// share: that of a in the colours. The mass, amplitude times area, is that of both.
inline MergeVectors merged(const MergeVectors& a, const MergeVectors& b, V& share) {
  MergeVectors m;
  const V one = broadcast(1), both = a.contribution + b.contribution;
  share = select(less(broadcast(0), both), quotient(a.contribution, both), broadcast(R(0.5)));
  const V rest = one - share;
  const auto mix = [&](V x, V y) { return fma(share, x, rest * y); };
  V d[3];
  for (int k = 0; k < 3; ++k) m.mean[k] = mix(a.mean[k], b.mean[k]), d[k] = a.mean[k] - b.mean[k];
  const V spread = share * rest;
  constexpr int row[6] = {0, 0, 0, 1, 1, 2}, column[6] = {0, 1, 2, 1, 2, 2};
  for (int k = 0; k < 6; ++k) m.cov[k] = fma(spread * d[row[k]], d[column[k]], mix(a.cov[k], b.cov[k]));
  for (int k = 0; k < 3; ++k) m.colour[k] = mix(a.colour[k], b.colour[k]);
  m.blur = mix(a.blur, b.blur), m.area = area_of(m.cov, m.blur), m.density = mix(a.density, b.density);
  m.transmittance = max(a.transmittance, b.transmittance);
  m.amplitude = min(broadcast(R(kAlphaMax)) * m.transmittance, quotient(fma(a.amplitude, a.area, b.amplitude * b.area), m.area));
  m.contribution = both;
  return m;
}

inline V dot(const V a[3], const V b[3]) { return fma(a[0], b[0], fma(a[1], b[1], a[2] * b[2])); }

// Integral of the product of two Gaussians with covariances a and b on the screen, an offset apart.
inline V overlap(const ScreenCov& a, V root_a, const ScreenCov& b, V root_b, V dx, V dy) {
  const ScreenCov both = {a.xx + b.xx, a.yy + b.yy, a.xy + b.xy};
  const V inv = reciprocal(both.det()), distance = fma(both.yy * dx, dx, fma(both.xx * dy, dy, broadcast(-2) * both.xy * dx * dy)) * inv;
  return broadcast(R(6.283185307179586)) * root_a * root_b * sqrt(inv) * exp(broadcast(R(-0.5)) * distance);
}

// sh: mean over all directions of the product of the view-dependent parts of both colours.
inline V merge_cost(const MergeVectors& a, const MergeVectors& b, V sh) {
  V share;
  const MergeVectors m = merged(a, b, share);
  const V rest = broadcast(1) - share;
  const V aa = dot(a.colour, a.colour) + a.sh_square, bb = dot(b.colour, b.colour) + b.sh_square, ab = dot(a.colour, b.colour) + sh;
  const V am = fma(share, aa, rest * ab), bm = fma(share, ab, rest * bb), mm = fma(share, am, rest * bm);
  V cross = broadcast(0), alone = broadcast(0), offset[3];
  for (int k = 0; k < 3; ++k) offset[k] = a.mean[k] - b.mean[k];
  for (int view = 0; view < 3; ++view) {
    const ScreenCov sa = screen_cov(a.cov, a.blur, view), sb = screen_cov(b.cov, b.blur, view), sm = screen_cov(m.cov, m.blur, view);
    const V ra = sqrt(sa.det()), rb = sqrt(sb.det()), rm = sqrt(sm.det()), x = offset[kAcross[view]], y = offset[kDown[view]];
    alone = fma(aa * a.amplitude * a.amplitude, ra, fma(bb * b.amplitude * b.amplitude, rb, fma(mm * m.amplitude * m.amplitude, rm, alone)));
    cross = fma(ab * a.amplitude * b.amplitude, overlap(sa, ra, sb, rb, x, y), cross);
    cross = fnma(am * a.amplitude * m.amplitude, overlap(sa, ra, sm, rm, rest * x, rest * y), cross);
    cross = fnma(bm * b.amplitude * m.amplitude, overlap(sb, rb, sm, rm, share * x, share * y), cross);
  }
  const V change = fma(alone, broadcast(R(3.141592653589793)), cross + cross) * broadcast(R(1.0 / 3));
  return fma(broadcast(R(kErrorShare)), a.error + b.error, max(change, broadcast(0)) * m.density);
}

template <class T>
inline V converted(const T* p) {  // W values
  if constexpr (std::is_same_v<T, R>) return load(p);
  V v;
  for (int i = 0; i < W; ++i) v[i] = static_cast<R>(p[i]);
  return v;
}

inline R sh_product(const MergeScene& s, uint32_t a, uint32_t b) {
  const float *const x = s.sh_row(s.rows[a].row), *const y = s.sh_row(s.rows[b].row);
  const int width = 3 * s.sh_coefficients;
  V products = broadcast(0);
  int k = 3;
  for (; k + W <= width; k += W) products = fma(converted(x + k), converted(y + k), products);
  R total = sum(products);
  for (; k < width; ++k) total += static_cast<R>(x[k]) * static_cast<R>(y[k]);
  return static_cast<R>(kShMean) * total;
}

// Writes the cost of merging a[i] and b[i], places in s.rows.
void merge_costs(const MergeScene& s, const uint32_t* a, const uint32_t* b, int64_t count, float* costs) {
  for (int64_t at = 0; at < count; at += W) {
    const int64_t here = std::min<int64_t>(W, count - at);
    V sh = broadcast(0);
    for (int i = 0; i < here && s.sh_coefficients > 1; ++i) sh[i] = sh_product(s, a[at + i], b[at + i]);
    const V cost = merge_cost(merge_vectors(s.rows, a + at, here), merge_vectors(s.rows, b + at, here), sh);
    for (int i = 0; i < here; ++i) costs[at + i] = static_cast<float>(cost[i]);
  }
}

// Writes the Gaussian that each pair becomes; its SH, sh_square, removal and row are the caller's.
void merge_rows(const MergeScene& s, const uint32_t* a, const uint32_t* b, int64_t count, MergeRow* out) {
  for (int64_t at = 0; at < count; at += W) {
    const int64_t here = std::min<int64_t>(W, count - at);
    V share;
    const MergeVectors m = merged(merge_vectors(s.rows, a + at, here), merge_vectors(s.rows, b + at, here), share);
    for (int i = 0; i < here; ++i) {
      MergeRow& row = out[at + i];
      const auto lane = [i](V v) { return static_cast<float>(v[i]); };
      for (int k = 0; k < 3; ++k) row.mean[k] = lane(m.mean[k]), row.colour[k] = lane(m.colour[k]);
      for (int k = 0; k < 6; ++k) row.cov[k] = lane(m.cov[k]);
      row.amplitude = lane(m.amplitude), row.transmittance = lane(m.transmittance), row.blur = lane(m.blur), row.area = lane(m.area);
      row.density = lane(m.density), row.contribution = lane(m.contribution);
    }
  }
}

// Sets the areas of rows [begin, end), and with them the densities.
void merge_areas(MergeRow* rows, int64_t begin, int64_t end) {
  uint32_t ids[W];
  for (int64_t at = begin; at < end; at += W) {
    const int64_t here = std::min<int64_t>(W, end - at);
    for (int i = 0; i < here; ++i) ids[i] = static_cast<uint32_t>(at + i);
    const MergeVectors g = merge_vectors(rows, ids, here);
    const V area = area_of(g.cov, g.blur), density = quotient(g.contribution, g.amplitude * area);
    for (int i = 0; i < here; ++i) rows[at + i].area = static_cast<float>(area[i]), rows[at + i].density = static_cast<float>(density[i]);
  }
}

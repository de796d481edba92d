// Where a Gaussian can reach alpha >= 1/255: the ellipse u^2 + v^2 <= t, t = log2(255 opacity). One rule for tile rows and
// for the 4-pixel bands of a tile. It only ever skips what the alpha test would reject: t and the borders carry a margin.

constexpr R kReachMargin = R(1e-3);   // on t; float rounding of the exponent stays below 1e-4
constexpr R kBorderMargin = R(4e-3);  // pixels
constexpr R kRelativeMargin = R(1e-6);  // of lengths

struct Extent {
  V left, right;  // dx of the ellipse's ends within the band
  V depth;        // negative: the band misses the ellipse
};

// The ellipse between dy = low and dy = high (low <= high). slope = -l12 / l11.
inline Extent ellipse_extent(V t, V l22, V inv_l11, V slope, V y_extreme, V low, V high) {
  const V yr = clamp(y_extreme, low, high), yl = clamp(-y_extreme, low, high);
  const V vr = l22 * yr, vl = l22 * yl;
  const V right2 = t - vr * vr, left2 = t - vl * vl;
  Extent e;
  e.right = slope * yr + sqrt(max(right2, splat(0))) * inv_l11;
  e.left = slope * yl - sqrt(max(left2, splat(0))) * inv_l11;
  e.depth = right2;
  return e;
}

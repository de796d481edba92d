// Where a Gaussian can reach alpha >= 1/255: the ellipse u^2 + v^2 <= t, t = log2(255 opacity). One rule for tile rows and
// for the 4-pixel bands of a tile. It only ever skips what the alpha test would reject: t and the borders carry a margin.
// Works on scalars and on vectors alike.

constexpr R kReachMargin = R(1e-3);   // on t; float rounding of the exponent stays below 1e-4
constexpr R kBorderMargin = R(4e-3);  // pixels
constexpr R kRelativeMargin = R(1e-6);  // of lengths

template <class T>
struct Extent {
  T left, right;  // dx of the ellipse's ends within the band
  T depth;        // negative: the band misses the ellipse
};

inline R root(R x) { return std::sqrt(x); }
inline V root(V x) { return sqrt(x); }
inline R clamp_to(R x, R low, R high) { return x < low ? low : x > high ? high : x; }
inline V clamp_to(V x, V low, V high) { return clamp(x, low, high); }
inline R floor0(R x) { return x > 0 ? x : 0; }
inline V floor0(V x) { return max(x, splat(0)); }

// The ellipse between dy = low and dy = high (low <= high). slope = -l12 / l11.
template <class T>
inline Extent<T> ellipse_extent(T t, T l22, T inv_l11, T slope, T y_extreme, T low, T high) {
  const T yr = clamp_to(y_extreme, low, high), yl = clamp_to(-y_extreme, low, high);
  const T vr = l22 * yr, vl = l22 * yl;
  const T right2 = t - vr * vr, left2 = t - vl * vl;
  Extent<T> e;
  e.right = slope * yr + root(floor0(right2)) * inv_l11;
  e.left = slope * yl - root(floor0(left2)) * inv_l11;
  e.depth = right2;
  return e;
}

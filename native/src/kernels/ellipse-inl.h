// A Gaussian reaches alpha >= 1/255 inside the ellipse u^2 + v^2 <= t, t = log2(255 opacity). The same rule finds the tiles of a row of
// tiles and the blocks of a row of blocks. t and the borders have a margin, so that only pixels are skipped that the alpha test rejects.

constexpr R kBoundMargin = R(1e-3);     // on t; float rounding of the exponent stays below 1e-4
constexpr R kBorderMargin = R(4e-3);    // pixels
constexpr R kRelativeMargin = R(1e-6);  // of lengths

struct Extent {
  V left, right;  // dx of the ellipse's ends within the band
  V depth;        // negative: the band misses the ellipse
};

// Extent of the ellipse between dy = low and dy = high (low <= high). slope = -l12 / l11.
inline Extent ellipse_extent(V t, V l22, V inv_l11, V slope, V y_extreme, V low, V high) {
  const V yr = clamp(y_extreme, low, high), yl = clamp(-y_extreme, low, high);
  const V vr = l22 * yr, vl = l22 * yl;
  const V right2 = t - vr * vr, left2 = t - vl * vl;
  Extent e;
  e.right = slope * yr + sqrt(max(right2, broadcast(0))) * inv_l11;
  e.left = slope * yl - sqrt(max(left2, broadcast(0))) * inv_l11;
  e.depth = right2;
  return e;
}

const R kLargestDistance = kWhiten * std::sqrt(kBoundMargin - R(kLog2Cut));  // of an opaque Gaussian, in standard deviations
// The bound t of the ellipse, for one Gaussian (R) or W of them (V).
template <class T>
inline T ellipse_bound(const Frame& f, T log2_opacity) {
  return (f.disabled_skips & SVRGS_OPACITY_BOUNDS ? T{} : log2_opacity) + (kBoundMargin - R(kLog2Cut));
}

// Pixels of [first, last) in a row or column that centre +- half covers, as [begin, end); none if begin >= end. `half` includes a margin for
// the rounding of the centre.
struct PixelRange {
  V begin, end;
};

inline PixelRange pixel_range(V centre, V half, int first, int last) {
  const V from = broadcast(static_cast<R>(first)), until = broadcast(static_cast<R>(last));
  const V low = clamp(centre - half - R(0.5), from, until), high = clamp(centre + half - R(0.5), from - R(1), until);
  return {ceil(low), min(floor(high) + R(1), until)};
}

// Half the width or height of the ellipse u^2 + v^2 <= bound, given the variance along that axis, with a margin for rounding.
inline V half_extent(V root_bound, V root_variance) { return root_bound * root_variance * (kWhiten * (1 + kRelativeMargin)) + kBorderMargin; }

// Tiles [begin, end) that contain the pixels of a range that is not empty.
struct TileRange {
  U begin, end;
};
inline TileRange tile_range(const PixelRange& r) {
  const auto tile = [](V pixel) {
    const I whole = __builtin_convertvector(pixel, I);
    return (U)whole / kTile;
  };
  return {tile(r.begin), tile(r.end - R(1)) + 1};
}

// FLIP of the pixels of a tile: how much the colours differ, and more where edges and points differ. A tile also computes the pixels around it that
// its filters need; pixels outside the image are those at its border. Images become planes of opponent colours, these are filtered along y, then x.

constexpr int kFlipPlanes = 3;

struct Colour {
  V x, y, z;  // or red, green, blue
};

// Linear sRGB to XYZ divided by the XYZ of white, and back.
inline Colour white_xyz(Colour c) {
  const auto row = [&](double r, double g, double b) { return fma(broadcast(R(r)), c.x, fma(broadcast(R(g)), c.y, broadcast(R(b)) * c.z)); };
  return {row(0.4338873455660398, 0.3762240091374987, 0.1898886452964614), row(0.2126390058715103, 0.715168678767756, 0.0721923153607337),
          row(0.0177500400709732, 0.1094476208552385, 0.8728023390737883)};
}
inline Colour linear_rgb(Colour c) {
  const auto row = [&](double x, double y, double z) { return fma(broadcast(R(x)), c.x, fma(broadcast(R(y)), c.y, broadcast(R(z)) * c.z)); };
  return {row(3.0803990906794643, -1.537383177570093, -0.5430159131093709), row(-0.9212233588602766, 1.8759675015077202, 0.0452558573525562),
          row(0.0528739389703645, -0.2039769588889765, 1.1511030199186119)};
}

struct FlipTile {
  const FlipArguments& a;
  int64_t y, x, rows, columns, stride;  // its first pixel, its size, values in a row
  R tap[kFlipFilters][kFlipRadius + 1];
  R* planes;                // of one image: kFlipPlanes times rows + 2 margin rows
  R *filtered, *reference;  // of the image and the target: kFlipFilters times rows rows, filtered along y

  int radius(FlipFilter f) const { return a.filters[f].radius; }
};

// The opponent colours YCxCz of the tile and its margin, without scale and offset: (Y, X - Y, Y - Z). The filters have sum 1 and the way back is
// the exact inverse, so 116 Y - 16, 500 Cx and 200 Cz would cancel.
void flip_opponents(const FlipTile& t, const R* image) {
  const int64_t margin = t.a.margin, rows = t.rows + 2 * margin, plane = rows * t.stride;
  for (int64_t r = 0; r < rows; ++r) {
    const R* row = image + 3 * t.a.width * std::clamp<int64_t>(t.y - margin + r, 0, t.a.height - 1);
    R* out = t.planes + r * t.stride;
    for (int64_t i = 0; i < t.stride; ++i) {
      const R* pixel = row + 3 * std::clamp<int64_t>(t.x - margin + i, 0, t.a.width - 1);
      out[i] = pixel[0], out[plane + i] = pixel[1], out[2 * plane + i] = pixel[2];
    }
    for (int64_t i = 0; i < t.stride; i += W) {
      const Colour c = white_xyz({linear(load(out + i)), linear(load(out + plane + i)), linear(load(out + 2 * plane + i))});
      store(out + i, c.y), store(out + plane + i, c.x - c.y), store(out + 2 * plane + i, c.y - c.z);
    }
  }
}

// Filters at p, of values that are `step` apart. The centre is subtracted from the even filters with sum 0: so a constant image gives exactly 0.
inline V flip_even(const FlipTile& t, FlipFilter f, const R* p, int64_t step) {
  V s = broadcast(t.tap[f][0]) * load(p);
  for (int k = 1; k <= t.radius(f); ++k) s = fma(broadcast(t.tap[f][k]), load(p - k * step) + load(p + k * step), s);
  return s;
}
inline V flip_edge(const FlipTile& t, const R* p, int64_t step) {
  V s = broadcast(0);
  for (int k = 1; k <= t.radius(kFlipEdge); ++k) s = fma(broadcast(t.tap[kFlipEdge][k]), load(p + k * step) - load(p - k * step), s);
  return s;
}
inline V flip_point(const FlipTile& t, const R* p, int64_t step) {
  const V centre = load(p), both = centre + centre;
  V s = broadcast(0);
  for (int k = 1; k <= t.radius(kFlipPoint); ++k) s = fma(broadcast(t.tap[kFlipPoint][k]), load(p - k * step) + load(p + k * step) - both, s);
  return s;
}

void flip_along_y(const FlipTile& t, R* filtered) {
  const int64_t plane = (t.rows + 2 * t.a.margin) * t.stride, size = t.rows * t.stride;
  for (int64_t y = 0; y < t.rows; ++y)
    for (int64_t i = 0; i < t.stride; i += W) {
      const R *Y = t.planes + (y + t.a.margin) * t.stride + i, *Cx = Y + plane, *Cz = Cx + plane;
      R* out = filtered + y * t.stride + i;
      store(out + kFlipY * size, flip_even(t, kFlipY, Y, t.stride));
      store(out + kFlipCx * size, flip_even(t, kFlipCx, Cx, t.stride));
      store(out + kFlipCz * size, flip_even(t, kFlipCz, Cz, t.stride));
      store(out + kFlipCzNarrow * size, flip_even(t, kFlipCzNarrow, Cz, t.stride));
      store(out + kFlipSmooth * size, flip_even(t, kFlipSmooth, Y, t.stride));
      store(out + kFlipEdge * size, flip_edge(t, Y, t.stride));
      store(out + kFlipPoint * size, flip_point(t, Y, t.stride));
    }
}

struct Seen {
  V lightness, a, b;  // CIELAB, a and b times L / 100, the Hunt effect: chroma counts less in dark colours (section 4.1.2)
  V edge, point;      // strengths: norms of the first and of the second Gaussian derivatives (section 4.2)
};

inline V lab_curve(V t) {
  const V root = power(t, broadcast(R(1.0 / 3)));
  return select(less(broadcast(R(216.0 / 24389)), t), root, fma(t, broadcast(R(841.0 / 108)), broadcast(R(4.0 / 29))));
}
inline V norm(V a, V b) { return sqrt(fma(a, a, b * b)); }
inline V unit(V v) { return clamp(v, broadcast(0), broadcast(1)); }

// What is seen at W pixels of an image; `at` is the first of them in the planes filtered along y.
inline Seen flip_seen(const FlipTile& t, const R* at) {
  const int64_t size = t.rows * t.stride;
  const V Y = flip_even(t, kFlipY, at + kFlipY * size, 1), Cx = flip_even(t, kFlipCx, at + kFlipCx * size, 1);
  const V Cz = fma(broadcast(R(t.a.cz_share[0])), flip_even(t, kFlipCz, at + kFlipCz * size, 1),
                   broadcast(R(t.a.cz_share[1])) * flip_even(t, kFlipCzNarrow, at + kFlipCzNarrow * size, 1));
  const Colour rgb = linear_rgb({Y + Cx, Y, Y - Cz}), xyz = white_xyz({unit(rgb.x), unit(rgb.y), unit(rgb.z)});
  const V x = lab_curve(xyz.x), y = lab_curve(xyz.y), z = lab_curve(xyz.z), lightness = fma(y, broadcast(116), broadcast(-16)), hunt = lightness * R(0.01);
  const R *smooth = at + kFlipSmooth * size, *edge = at + kFlipEdge * size, *point = at + kFlipPoint * size;
  return {lightness, R(500) * (x - y) * hunt, R(200) * (y - z) * hunt, norm(flip_edge(t, smooth, 1), flip_even(t, kFlipSmooth, edge, 1)),
          norm(flip_point(t, smooth, 1), flip_even(t, kFlipSmooth, point, 1))};
}

// HyAB distance to the power q_c, mapped piecewise linearly: p_c of the largest one, between green and blue, becomes p_t (sections 4.1.2, 4.1.3).
inline V flip_colour_difference(const Seen& p, const Seen& q) {
  constexpr double kLargest = 41.27657043967204, kSplit = 0.4 * kLargest, kSplitValue = 0.95;
  const V distance = magnitude(p.lightness - q.lightness) + norm(p.a - q.a, p.b - q.b), error = power(distance, broadcast(R(0.7)));
  const V high = fma(error - broadcast(R(kSplit)), broadcast(R((1 - kSplitValue) / (kLargest - kSplit))), broadcast(R(kSplitValue)));
  return keep(less(broadcast(0), distance), select(less(error, broadcast(R(kSplit))), error * broadcast(R(kSplitValue / kSplit)), high));
}
// The larger one of the edge and the point difference (equation 12).
inline V flip_feature_difference(const Seen& p, const Seen& q) {
  const V strongest = max(magnitude(p.edge - q.edge), magnitude(p.point - q.point)) * broadcast(R(0.7071067811865476));
  return sqrt(min(strongest, broadcast(1)));
}
// Equation 13.
inline V flip_difference(const Seen& p, const Seen& q) {
  const V colour = flip_colour_difference(p, q), feature = flip_feature_difference(p, q);
  return keep(either(less(broadcast(0), colour), at_least(feature, broadcast(1))), power(colour, broadcast(1) - feature));
}

void flip_tile(const FlipArguments& a, int64_t tile, void* scratch) {
  FlipTile t = {a, tile / a.tiles_across * kFlipTileRows, tile % a.tiles_across * kFlipTileColumns, 0, 0, a.stride(), {}, static_cast<R*>(scratch), {}, {}};
  t.rows = std::min<int64_t>(kFlipTileRows, a.height - t.y), t.columns = std::min<int64_t>(kFlipTileColumns, a.width - t.x);
  t.filtered = t.planes + kFlipPlanes * (t.rows + 2 * a.margin) * t.stride, t.reference = t.filtered + kFlipFilters * t.rows * t.stride;
  for (int f = 0; f < kFlipFilters; ++f)
    for (int k = 0; k <= a.filters[f].radius; ++k) t.tap[f][k] = static_cast<R>(a.filters[f].tap[k]);
  flip_opponents(t, static_cast<const R*>(a.image)), flip_along_y(t, t.filtered);
  flip_opponents(t, static_cast<const R*>(a.target)), flip_along_y(t, t.reference);
  for (int64_t y = 0; y < t.rows; ++y)
    for (int64_t i = 0; i < t.columns; i += W) {
      const int64_t at = y * t.stride + a.margin + i;
      const V error = flip_difference(flip_seen(t, t.filtered + at), flip_seen(t, t.reference + at));
      R* const out = static_cast<R*>(a.errors) + (t.y + y) * a.width + t.x + i;
      if (i + W <= t.columns)
        store(out, error);
      else
        for (int k = 0; i + k < t.columns; ++k) out[k] = error[k];
    }
}

// Stage 2: finds the exact tiles of visible Gaussians that cover several rows of tiles. The rows of consecutive Gaussians fill the lanes.

constexpr int64_t kPlacesAhead = 16;  // visible Gaussians fetched before they are needed

struct TileRows {  // waiting rows of tiles: values of their Gaussians; dy of the row's first line of pixels, and of the window's last one; TileRect::columns
  static constexpr int kRoom = 64;
  R bound[kRoom], l22[kRoom], inv_l11[kRoom], slope[kRoom], y_extreme[kRoom], x[kRoom], low[kRoom], bottom[kRoom];
  IntR begin_end[kRoom];
};

// Writes the spans of n <= W waiting rows, from `first` on; adds their tiles to `tiles`.
inline void find_spans(const Frame& f, const TileRows& rows, int first, int n, Span* spans, U& tiles) {
  const auto value = [first](const R* values) { return load(values + first); };
  const V margin = broadcast(kBorderMargin), low = value(rows.low), high = min(low + R(kTile - 1), value(rows.bottom));
  const Extent e =
      ellipse_extent(value(rows.bound), value(rows.l22), value(rows.inv_l11), value(rows.slope), value(rows.y_extreme), low - margin, high + margin);
  const V centre = value(rows.x) + (e.left + e.right) * R(0.5), half = (e.right - e.left) * R(0.5) + margin + magnitude(centre) * kRelativeMargin;
  const PixelRange columns = pixel_range(centre, half, f.window.left, f.window.right);
  const M crosses = both(at_least(e.depth, broadcast(0)), less(columns.begin, columns.end));
  const TileRange across = tile_range(columns);
  U all;  // columns of the Gaussian: rounding can make a row wider
  __builtin_memcpy(&all, rows.begin_end + first, sizeof all);
  const auto larger = [](U a, U b) { return a > b ? a : b; };
  const auto smaller = [](U a, U b) { return a < b ? a : b; };
  const U begin = larger(across.begin, all & 0xffff), end = larger(smaller(across.end, all >> 16), begin);
  const U words = (U)keep(crosses, (V)(begin | end << 16)), counts = (U)keep(crosses, (V)(end - begin));
  if (n == W && sizeof words == W * sizeof(Span)) {
    __builtin_memcpy(spans, &words, sizeof words);
    tiles += counts;
  } else {
    for (int i = 0; i < n; ++i) {
      const uint32_t word = static_cast<uint32_t>(words[i]);
      __builtin_memcpy(spans + i, &word, sizeof word);
      tiles[i] += counts[i];
    }
  }
}

// Fills the spans of the visible Gaussians at places [begin, end) that cover several rows. Returns how many tiles all Gaussians at these places touch.
int64_t fill_spans(const Frame& f, int64_t begin, int64_t end, Span* spans) {
  const auto* const gaussians = static_cast<const ProjectedGaussian<R>*>(f.gaussians);
  const bool exact = !(f.disabled_skips & SVRGS_EXACT_TILES);
  TileRows rows = {};
  U tiles = {};
  int waiting = 0;
  int64_t sum = 0;
  for (int64_t place = begin; place < end; ++place) {
    const TileRect& t = f.rects[place];
    __builtin_prefetch(gaussians + place + kPlacesAhead);
    const int64_t across = t.columns.end - t.columns.begin;
    if (t.rows == 1 || !exact) {
      sum += across * t.rows;
      if (t.rows > 1) spans = std::fill_n(spans, t.rows, t.columns);
      continue;
    }
    const ProjectedGaussian<R>& s = gaussians[place];
    for (int r = 0; r < t.rows; ++r) {
      rows.bound[waiting] = ellipse_bound(f, s.shape.log2_opacity), rows.l22[waiting] = s.shape.l22, rows.inv_l11[waiting] = s.shape.inv_l11;
      rows.slope[waiting] = s.shape.slope, rows.y_extreme[waiting] = s.shape.y_extreme, rows.x[waiting] = static_cast<R>(s.x);
      rows.begin_end[waiting] = t.columns.begin | t.columns.end << 16;
      rows.low[waiting] = static_cast<R>((t.row + r) * kTile + 0.5 - s.y), rows.bottom[waiting] = static_cast<R>(f.window.bottom - 0.5 - s.y);
      if (++waiting < TileRows::kRoom) continue;
      for (int first = 0; first < waiting; first += W, spans += W) find_spans(f, rows, first, W, spans, tiles);
      waiting = 0;
    }
  }
  for (int first = 0; first < waiting; first += W, spans += W) find_spans(f, rows, first, std::min(W, waiting - first), spans, tiles);
  for (int i = 0; i < W; ++i) sum += static_cast<int64_t>(tiles[i]);
  return sum;
}

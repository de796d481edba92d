// Stage 2: finds the exact tiles of a visible Gaussian that covers several rows of tiles, W rows at a time. Returns how many tiles.
uint32_t fill_spans(const Frame& f, uint32_t place, Span* spans) {
  const ProjectedGaussian<R>& s = static_cast<const ProjectedGaussian<R>*>(f.gaussians)[place];
  const TileRect& t = f.rects[place];
  if (f.disabled_skips & SVRGS_EXACT_TILES) {
    std::fill_n(spans, t.rows, t.columns);
    return static_cast<uint32_t>(t.rows) * (t.columns.end - t.columns.begin);
  }
  const V bound = broadcast(ellipse_bound(f, s.shape.log2_opacity)), margin = broadcast(kBorderMargin), x = broadcast(static_cast<R>(s.x));
  const V bottom = broadcast(static_cast<R>(f.height - 0.5 - s.y));
  uint32_t tiles = 0;
  for (int r = 0; r < t.rows; r += W) {
    const V low = broadcast(static_cast<R>((t.row + r) * kTile + 0.5 - s.y)) + iota() * R(kTile), high = min(low + R(kTile - 1), bottom);
    const Extent e = ellipse_extent(bound, broadcast(s.shape.l22), broadcast(s.shape.inv_l11), broadcast(s.shape.slope), broadcast(s.shape.y_extreme),
                                    low - margin, high + margin);
    const V centre = x + (e.left + e.right) * R(0.5), half = (e.right - e.left) * R(0.5) + margin + magnitude(centre) * kRelativeMargin;
    const PixelRange columns = pixel_range(centre, half, f.width);
    const M crosses = both(at_least(e.depth, broadcast(0)), less(columns.begin, columns.end));
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

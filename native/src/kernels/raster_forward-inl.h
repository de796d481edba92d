// Stage 4b: blends one tile front to back. The tile's list is taken in chunks. Each chunk is sorted into the 4x4 blocks that its Gaussians
// reach, and each block walks its own list with its 16 pixels in registers. Colours stop at the first hit that would take the
// transmittance T below 1e-4. F walks on to the end of the ray if Frame::full is set.

// Known at compile time: which values are computed besides colours, whether pixels have depth limits, and whether rays end at f.stop (early), not at kStop.
struct WalkOptions {
  bool count, full, scenario, limited, early;
};

// Running values of W pixels; between chunks they are stored in Frame::state.
struct PixelState {
  V T, final_T, red, green, blue, depth, count, dropped, sums[4];
  M open() const { return at_least(T, broadcast(R(kStop))); }  // T has not fallen below the stop
};

// Per-pixel sums behind scenarios A and B (paper Eq. 12-16), over counted hits:
// A: sum w, sum M w, sum alpha T w^2, sum M alpha T w^2 with w = 1 / (alpha T + eps).  B: sum M (1 - T), sum M T.
inline void add_scenario(const Frame& f, PixelState& p, V alpha, V T, R mask, M counted) {
  if (f.mask_kind == SVRGS_MASK_A) {
    const V weight = alpha * T, w = broadcast(1) / (weight + broadcast(static_cast<R>(f.eps_a))), slope = weight * w * w;
    p.sums[0] = add_if(counted, p.sums[0], w);
    p.sums[2] = add_if(counted, p.sums[2], slope);
    if (mask == 0) return;
    p.sums[1] = add_if(counted, p.sums[1], w);
    p.sums[3] = add_if(counted, p.sums[3], slope);
  } else if (mask != 0) {
    p.sums[0] = add_if(counted, p.sums[0], broadcast(1) - T);
    p.sums[1] = add_if(counted, p.sums[1], T);
  }
}

template <WalkOptions walk>
inline void count_hit(const Frame& f, PixelState& p, V alpha, V T, const LocalGaussian& l, M counted) {
  if constexpr (walk.count) p.count = add_if(counted, p.count, broadcast(1));
  if (walk.count && !drawn(l)) p.dropped = add_if(counted, p.dropped, broadcast(1));
  if constexpr (walk.scenario) add_scenario(f, p, alpha, T, l.mask, counted);
}

// The pixels of a block: their offsets and their depth limits.
struct BlockPixels {
  const Lanes& lanes;
  V limit[kVectorsPerBlock];
};

// Evaluates a Gaussian at a block; it hits only pixels whose depth limit is behind it.
template <WalkOptions walk>
[[gnu::always_inline]] inline BlockHits evaluate_before(const BlockPixels& pixels, const LocalGaussian& l) {
  BlockHits hits = evaluate_block(l, pixels.lanes);
  if constexpr (walk.limited)
    for (int h = 0; h < kVectorsPerBlock; ++h)
      hits.part[h].exponent = select(less(broadcast(l.depth), pixels.limit[h]), hits.part[h].exponent, broadcast(R(kLog2Cut) - 1));
  return hits;
}

// Blends one Gaussian into W pixels; returns whether it hits one.
template <WalkOptions walk>
[[gnu::always_inline]] inline bool blend(const Frame& f, const LocalGaussian& l, const Hit& e, PixelState& p) {
  const V alpha = clamped(e.alpha), T = p.T;
  const M goes_on = walk.full ? e.hit() : p.open();
  const bool hit = any_of_both(e.hit(), goes_on);
  M counted = both(e.hit(), goes_on);
  if (drawn(l)) {
    const V weight = keep(e.hit(), alpha * T), next = T - weight;
    const M live = at_least(next, broadcast(R(kStop)));
    p.red = fma_if(live, weight, broadcast(l.rgb[0]), p.red);
    p.green = fma_if(live, weight, broadcast(l.rgb[1]), p.green);
    p.blue = fma_if(live, weight, broadcast(l.rgb[2]), p.blue);
    p.final_T = select(live, next, p.final_T);
    if (!walk.full) counted = both(e.hit(), live);
    p.T = next;
    if (f.want_depth) p.depth = fma_if(live, weight, broadcast(l.depth), p.depth);
  }
  count_hit<walk>(f, p, alpha, T, l, counted);
  return hit;
}

// The same after the stop of the colours, where only F goes on.
template <WalkOptions walk>
[[gnu::always_inline]] inline bool count_behind(const Frame& f, const LocalGaussian& l, const Hit& e, PixelState& p) {
  const V alpha = clamped(e.alpha), T = p.T;
  if (drawn(l)) p.T = T - keep(e.hit(), alpha * T);
  count_hit<walk>(f, p, alpha, T, l, e.hit());
  return any(e.hit());
}

[[gnu::always_inline]] inline bool any_reaches(V stop, const PixelState* p) {
  M open = at_least(p[0].T, stop);
  for (int h = 1; h < kVectorsPerBlock; ++h) open = either(open, at_least(p[h].T, stop));
  return any(open);
}

// Blends a block's list into its pixels until all of them have stopped. Returns whether a pixel goes on. A Gaussian's values are loaded
// once for all vectors of the block.
template <WalkOptions walk>
[[gnu::always_inline]] inline bool blend_list(const Frame& f, Chunk& c, int listed, int block, const BlockPixels& pixels, PixelState* p) {
  const uint8_t *at = c.list, *const end = at + listed;
  const bool to_end = f.disabled_skips & SVRGS_TERMINATION;
  const V stop = broadcast(walk.early ? static_cast<R>(f.stop) : R(kStop));
  Entry* next = &c.entry[*at];
  BlockHits next_hits = evaluate_before<walk>(pixels, next->local);
  const auto walk_on = [&](auto&& on, auto&& take) __attribute__((always_inline)) {
    for (; at < end && on(); ++at) {
      Entry& entry = *next;
      const BlockHits hits = next_hits;
      next = &c.entry[at[1]];
      next_hits = evaluate_before<walk>(pixels, next->local);  // early: its long chain runs beside what follows
      bool hit = false;
      for (int h = 0; h < kVectorsPerBlock; ++h) hit |= take(entry.local, hits.part[h], p[h]);
      entry.visit |= block_bit(block, hit);
    }
  };
  walk_on([&] { return any_reaches(stop, p) || to_end; }, [&](const LocalGaussian& l, const Hit& e, PixelState& some) { return blend<walk>(f, l, e, some); });
  const bool goes_on = any_reaches(stop, p);
  if constexpr (walk.full)
    walk_on([] { return true; }, [&](const LocalGaussian& l, const Hit& e, PixelState& some) { return count_behind<walk>(f, l, e, some); });
  return goes_on;
}

inline R* tile_state(const Frame& f, int64_t tile) { return static_cast<R*>(f.state) + (f.picture_only ? 0 : tile) * kTileState; }

inline R* block_state(R* tile, int block, int h) { return tile + block * (kFields * kBlockPixels) + h * W; }

template <WalkOptions walk>
inline PixelState load_pixels(const Frame& f, const R* at) {
  const auto field = [&](Field k) { return load(at + k * kBlockPixels); };
  PixelState p = {};
  p.T = field(kFullT), p.final_T = field(kFinalT), p.red = field(kRed), p.green = field(kGreen), p.blue = field(kBlue);
  if (f.want_depth) p.depth = field(kDepth);
  if constexpr (walk.count) p.count = field(kCount), p.dropped = field(kDropped);
  if constexpr (walk.scenario)
    for (int k = 0; k < 4; ++k) p.sums[k] = field(Field(kSum0 + k));
  return p;
}

template <WalkOptions walk>
inline void store_pixels(const Frame& f, R* at, const PixelState& p) {
  const auto field = [&](Field k, V v) { store(at + k * kBlockPixels, v); };
  field(kFullT, p.T), field(kFinalT, p.final_T), field(kRed, p.red), field(kGreen, p.green), field(kBlue, p.blue);
  if (f.want_depth) field(kDepth, p.depth);
  if constexpr (walk.count) field(kCount, p.count), field(kDropped, p.dropped);
  if constexpr (walk.scenario)
    for (int k = 0; k < 4; ++k) field(Field(kSum0 + k), p.sums[k]);
}

// Clears a tile. Returns the blocks that have a pixel in the image. Pixels outside start with T = 0, so they are never open.
template <WalkOptions walk>
inline BlockMask start_tile(const Frame& f, TileOrigin o, R* state) {
  BlockMask inside = 0;
  for (int b = 0; b < kBlocks; ++b)
    for (int h = 0; h < kVectorsPerBlock; ++h) {
      const M in = in_image(f, o, all_lanes().block[b], h);
      PixelState p = {};
      p.T = p.final_T = keep(in, broadcast(1));
      store_pixels<walk>(f, block_state(state, b, h), p);
      inside |= block_bit(b, any(in));
    }
  return inside;
}

// If F stops with the colours, the transmittance behind the last hit is that of the colours.
inline void end_with_colours(R* state) {
  for (int b = 0; b < kBlocks; ++b) {
    R* const block = block_state(state, b, 0);
    std::copy_n(block + kFinalT * kBlockPixels, kBlockPixels, block + kFullT * kBlockPixels);
  }
}

// F walks to the end of the list also where nothing is shown.
template <WalkOptions walk>
inline void clear_invalid(const Frame& f, TileOrigin o, R* state) {
  for (int b = 0; b < kBlocks; ++b)
    for (int h = 0; h < kVectorsPerBlock; ++h) {
      const M in = in_image(f, o, all_lanes().block[b], h);
      PixelState p = load_pixels<walk>(f, block_state(state, b, h));
      p.count = keep(in, p.count), p.dropped = keep(in, p.dropped);
      for (V& sum : p.sums) sum = keep(in, sum);
      store_pixels<walk>(f, block_state(state, b, h), p);
    }
}

template <WalkOptions walk>
void forward_tile_as(const Frame& f, int64_t tile) {
  const TileOrigin o = f.tile_origin(tile);
  R* const state = tile_state(f, tile);
  BlockMask inside = start_tile<walk>(f, o, state), open = inside;
  const TileEntry *entry = f.entries + f.tile_begin[tile], *const end = f.entries + f.tile_begin[tile + 1];
  Chunk c;
  DepthLimits limits;
  if constexpr (walk.limited) read_limits(f, o, limits);
  while (entry < end && (walk.full || open || f.disabled_skips & SVRGS_TERMINATION)) {
    if constexpr (walk.limited) {
      const BlockMask nearer = within(limits, gaussian_of(f, *entry).shape.depth);
      inside &= nearer, open &= nearer;
      if (!inside) break;
    }
    const int n = static_cast<int>(std::min<int64_t>(kChunkEntries, end - entry));
    const BlockMask active = walk.full || f.disabled_skips & SVRGS_TERMINATION ? inside : open;
    gather_chunk(f, o, entry, end, n, active, c);
    for (BlockMask left = active; left; left &= left - 1) {
      const int b = __builtin_ctzll(left);
      int listed = list_block(c, b, n);
      if constexpr (walk.limited) listed = trimmed(c, listed, limits.block[b]);
      if (!listed) continue;
      BlockPixels pixels = {all_lanes().block[b], {}};
      PixelState p[kVectorsPerBlock];
      for (int h = 0; h < kVectorsPerBlock; ++h) {
        p[h] = load_pixels<walk>(f, block_state(state, b, h));
        if constexpr (walk.limited) pixels.limit[h] = load(limits.pixel[b] + h * W);
      }
      const bool goes_on = blend_list<walk>(f, c, listed, b, pixels, p);
      for (int h = 0; h < kVectorsPerBlock; ++h) store_pixels<walk>(f, block_state(state, b, h), p[h]);
      if (!goes_on) open &= static_cast<BlockMask>(~block_bit(b, true));
    }
    for (int k = 0; f.hits && k < n; ++k) f.hits[entry[k].slot] = c.entry[k].visit;
    entry += n;
  }
  for (; f.hits && entry < end; ++entry) f.hits[entry->slot] = 0;
  if constexpr (!walk.full) end_with_colours(state);
  if (walk.full && f.valid) clear_invalid<walk>(f, o, state);
}

template <bool limited>
void forward_tile_with(const Frame& f, int64_t tile) {
  const bool scenario = f.mask_kind == SVRGS_MASK_A || f.mask_kind == SVRGS_MASK_B;
  if (f.mask_kind == SVRGS_MASK_NONE && f.stop > kStop)
    forward_tile_as<WalkOptions{false, false, false, limited, true}>(f, tile);
  else if (f.mask_kind == SVRGS_MASK_NONE)
    forward_tile_as<WalkOptions{false, false, false, limited, false}>(f, tile);
  else if (scenario)
    f.full ? forward_tile_as<WalkOptions{true, true, true, limited, false}>(f, tile) : forward_tile_as<WalkOptions{true, false, true, limited, false}>(f, tile);
  else
    f.full ? forward_tile_as<WalkOptions{true, true, false, limited, false}>(f, tile)
           : forward_tile_as<WalkOptions{true, false, false, limited, false}>(f, tile);
}

void forward_tile(const Frame& f, int64_t tile) { f.depth_limit ? forward_tile_with<true>(f, tile) : forward_tile_with<false>(f, tile); }

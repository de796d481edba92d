// Stage 4: blends one tile front to back. The list is taken in chunks; each chunk is sorted into the 4x4 blocks its Gaussians
// reach, and each block walks its own list with its 16 pixels in registers. A lane carries the running transmittance T of
// every hit; colours stop at the first T below 1e-4 (T never rises again), F goes on where Frame::full asks for it.

// A Gaussian as seen from one tile: (x, y) from its centre to the tile's corner pixel, the rest as in Splat.
struct Local {
  R x, y, l11, l12, l22, log2_opacity, rgb[3], depth, mask;
};

struct TileOrigin {
  int x, y;  // tile coordinates
};

inline TileOrigin tile_origin(const Frame& f, int64_t tile) {
  return {static_cast<int>(tile % f.tiles_x), static_cast<int>(tile / f.tiles_x)};
}

inline const Splat<R>& splat_of(const Frame& f, TileEntry e) { return static_cast<const Splat<R>*>(f.splats)[e.place]; }

inline Local localise(const Splat<R>& s, TileOrigin o) {
  return {static_cast<R>(o.x * kTile + 0.5 - s.x), static_cast<R>(o.y * kTile + 0.5 - s.y), s.l11, s.l12, s.l22, s.log2_opacity,
          {s.rgb[0], s.rgb[1], s.rgb[2]}, s.depth, s.mask};
}

constexpr int kAhead = 16;  // list entries fetched before they are needed: the list is in order, the splats are not

inline void prefetch_splat(const Frame& f, const TileEntry* entry, const TileEntry* end) {
  if (entry < end) __builtin_prefetch(&splat_of(f, *entry));
}

// Pixel offsets of the lanes of a block from the tile's corner pixel.
struct Lanes {
  V x[kSub], y[kSub];
};

inline Lanes block_lanes(int block) {
  Lanes l;
  for (int i = 0; i < kBlockPixels; ++i) {
    l.x[i / W][i % W] = static_cast<R>(kBlockWidth * (block % kBlockColumns) + i % kBlockWidth);
    l.y[i / W][i % W] = static_cast<R>(kBlockHeight * (block / kBlockColumns) + i / kBlockWidth);
  }
  return l;
}

struct AllLanes {  // of a tile's blocks; the same for every tile
  Lanes block[kBlocks];
  AllLanes() {
    for (int b = 0; b < kBlocks; ++b) block[b] = block_lanes(b);
  }
};

inline const AllLanes& all_lanes() {
  static const AllLanes lanes;
  return lanes;
}

// Which of W lanes of a block lie in the image.
inline M in_image(const Frame& f, TileOrigin o, const Lanes& lanes, int h) {
  return both(less(lanes.x[h], splat(static_cast<R>(f.width - o.x * kTile))), less(lanes.y[h], splat(static_cast<R>(f.height - o.y * kTile))));
}

struct Hit {
  V alpha, u, v;  // u, v: as in Splat
  M hit;          // alpha >= 1/255
};

// alpha of one Gaussian at W pixels, not yet clamped. Forward, backward and scores call this and nothing else. What it says
// where `hit` is not set means nothing. Always inline: as a call it costs the backward pass 5 %.
[[gnu::always_inline]] inline Hit evaluate(const Local& l, V x, V y) {
  Hit r;
  const V dx = splat(l.x) + x, dy = splat(l.y) + y;
  r.u = fma(splat(l.l11), dx, splat(l.l12) * dy);
  r.v = splat(l.l22) * dy;
  const V exponent = fnma(r.u, r.u, fnma(r.v, r.v, splat(l.log2_opacity)));
  r.hit = at_least(exponent, splat(R(kLog2Cut)));
  r.alpha = exp2(exponent);
  return r;
}

struct BlockHits {
  Hit part[kSub];
};

[[gnu::always_inline]] inline BlockHits evaluate_block(const Local& l, const Lanes& lanes) {
  BlockHits hits;
  for (int h = 0; h < kSub; ++h) hits.part[h] = evaluate(l, lanes.x[h], lanes.y[h]);
  return hits;
}

inline V clamped(V alpha) { return min(alpha, splat(R(kAlphaMax))); }

// Up to kChunk entries of a tile's list, and for each block those that reach it.
constexpr int kChunk = 256;
static_assert(kChunk <= 256 && kChunk % 16 == 0);

struct Entry {
  Local local;
  BlockMask visit;  // blocks the backward pass must visit
};

struct Chunk {
  Entry entry[kChunk];
  R reach[kChunk], l22[kChunk], inv_l11[kChunk], slope[kChunk], y_extreme[kChunk], x[kChunk], y[kChunk];
  uint8_t list[kBlocks][kChunk + 16];  // append_lanes writes 16 at a time
  int listed[kBlocks];
};

// Adds entries [first, first + W) to the lists of the blocks their ellipses reach.
inline void list_blocks(const Frame& f, Chunk& c, int first, int count, BlockMask active) {
  const V reach = load(c.reach + first), l22 = load(c.l22 + first), inv = load(c.inv_l11 + first), slope = load(c.slope + first);
  const V ye = load(c.y_extreme + first), x = load(c.x + first), y = load(c.y + first), margin = splat(kBorderMargin);
  constexpr BlockMask row = (BlockMask(1) << kBlockColumns) - 1;
  for (int b = 0; b < kBlocks; b += kBlockColumns) {
    if (!(active & row << b)) continue;
    const V low = y + splat(R(b / kBlockColumns * kBlockHeight)), high = low + splat(R(kBlockHeight - 1));
    const Extent e = ellipse_extent(reach, l22, inv, slope, ye, low - margin, high + margin);
    const M crosses = at_least(e.depth, splat(0));
    const V right = e.right + margin, left = e.left - margin;
    for (int column = 0; column < kBlockColumns; ++column) {
      const int block = b + column;
      if (!(active >> block & 1)) continue;
      const V from = x + splat(R(column * kBlockWidth)), to = from + splat(R(kBlockWidth - 1));
      uint32_t hit = bits(both(crosses, both(at_least(right, from), at_least(to, left))));
      if (f.without & SVRGS_BLOCK_TESTS) hit = (1u << W) - 1;
      if (count < W) hit &= (1u << count) - 1;
      c.listed[block] = append_lanes(c.list[block], c.listed[block], first, hit);
    }
  }
}

inline void gather_chunk(const Frame& f, TileOrigin o, const TileEntry* entries, const TileEntry* end, int n, BlockMask active, Chunk& c) {
  for (int k = 0; k < n; ++k) {
    prefetch_splat(f, entries + k + kAhead, end);
    const Splat<R>& s = splat_of(f, entries[k]);
    const Local& l = (c.entry[k] = {localise(s, o), 0}).local;
    c.reach[k] = reach2(f, s.log2_opacity), c.l22[k] = s.l22, c.inv_l11[k] = s.inv_l11, c.slope[k] = s.slope, c.y_extreme[k] = s.y_extreme;
    c.x[k] = l.x, c.y[k] = l.y;
  }
  std::fill_n(c.listed, kBlocks, 0);
  for (int k = 0; k < n; k += W) list_blocks(f, c, k, n - k, active);
  for (int b = 0; b < kBlocks; ++b) c.list[b][c.listed[b]] = 0;  // blending looks one entry ahead
}

// Depths at which a tile's pixels end; 0 outside the image and where the limit is no number.
struct Limits {
  R pixel[kBlocks][kBlockPixels], block[kBlocks];  // block: the largest of its pixels'
};

inline void read_limits(const Frame& f, TileOrigin o, Limits& limits) {
  const R* const image = static_cast<const R*>(f.depth_limit);
  for (int b = 0; b < kBlocks; ++b) {
    R largest = 0;
    for (int i = 0; i < kBlockPixels; ++i) {
      const int x = o.x * kTile + b % kBlockColumns * kBlockWidth + i % kBlockWidth, y = o.y * kTile + b / kBlockColumns * kBlockHeight + i / kBlockWidth;
      const R z = x < f.width && y < f.height ? image[static_cast<int64_t>(y) * f.width + x] : R(0);
      limits.pixel[b][i] = z > 0 ? z : R(0);
      largest = std::max(largest, limits.pixel[b][i]);
    }
    limits.block[b] = largest;
  }
}

// Blocks that take something at this depth or behind. The margin: lists are in the order of depths as floats.
inline BlockMask within(const Limits& limits, R depth) {
  BlockMask blocks = 0;
  for (int b = 0; b < kBlocks; ++b) blocks |= static_cast<BlockMask>(depth * R(1 - 1e-6) < limits.block[b]) << b;
  return blocks;
}

// Cuts off what a block's list holds behind all of its limits.
inline void trim(Chunk& c, int block, R limit) {
  int& n = c.listed[block];
  while (n && !(c.entry[c.list[block][n - 1]].local.depth < limit)) --n;
}

// What is counted beside the colours, and whether pixels have depth limits; fixed when compiling.
struct Walk {
  bool count, full, scenario, limited;
};

// Running values of W pixels; their home is Frame::state.
struct Pixels {
  V T, final_T, red, green, blue, depth, count, dropped, sums[4];
  M open;  // T has not fallen below the stop
};

// Per-pixel sums behind scenarios A and B (paper Eq. 12-16), over counted hits:
// A: sum w, sum M w, sum alpha T w^2, sum M alpha T w^2 with w = 1 / (alpha T + eps).  B: sum M (1 - T), sum M T.
inline void add_scenario(const Frame& f, Pixels& p, V alpha, V T, R mask, M counted) {
  if (f.mask_kind == kMaskA) {
    const V weight = alpha * T, w = splat(1) / (weight + splat(static_cast<R>(f.eps_a))), slope = weight * w * w;
    p.sums[0] = add_if(counted, p.sums[0], w);
    p.sums[2] = add_if(counted, p.sums[2], slope);
    if (mask == 0) return;
    p.sums[1] = add_if(counted, p.sums[1], w);
    p.sums[3] = add_if(counted, p.sums[3], slope);
  } else if (mask != 0) {
    p.sums[0] = add_if(counted, p.sums[0], splat(1) - T);
    p.sums[1] = add_if(counted, p.sums[1], T);
  }
}

template <Walk walk>
inline void count_hit(const Frame& f, Pixels& p, V alpha, V T, R mask, M counted) {
  if constexpr (walk.count) p.count = add_if(counted, p.count, splat(1));
  if (walk.count && mask == 0) p.dropped = add_if(counted, p.dropped, splat(1));
  if constexpr (walk.scenario) add_scenario(f, p, alpha, T, mask, counted);
}

// Pixels of a block: where they are, and the depths at which they end.
struct BlockPixels {
  const Lanes& lanes;
  V limit[kSub];
};

// A Gaussian hits pixels only where it lies before their depth limit.
template <Walk walk>
[[gnu::always_inline]] inline BlockHits evaluate_before(const BlockPixels& pixels, const Local& l) {
  BlockHits hits = evaluate_block(l, pixels.lanes);
  if constexpr (walk.limited)
    for (int h = 0; h < kSub; ++h) hits.part[h].hit = both(hits.part[h].hit, less(splat(l.depth), pixels.limit[h]));
  return hits;
}

// Blends one Gaussian into W pixels; returns whether it hits one.
template <Walk walk>
[[gnu::always_inline]] inline bool blend(const Frame& f, const Local& l, const Hit& e, Pixels& p) {
  const V alpha = clamped(e.alpha), T = p.T;
  const M hit = walk.full ? e.hit : both(e.hit, p.open);
  M counted = hit;
  if (l.mask != 0) {
    const V weight = keep(e.hit, alpha * T), next = T - weight;
    const M live = at_least(next, splat(R(kStop)));
    const V w = keep(live, weight);
    p.red = fma(w, splat(l.rgb[0]), p.red);
    p.green = fma(w, splat(l.rgb[1]), p.green);
    p.blue = fma(w, splat(l.rgb[2]), p.blue);
    if (f.want_depth) p.depth = fma(w, splat(l.depth), p.depth);
    p.final_T = select(live, next, p.final_T);
    if (!walk.full) counted = both(hit, live);
    p.T = next, p.open = live;
  }
  count_hit<walk>(f, p, alpha, T, l.mask, counted);
  return any(hit);
}

// The same behind the stop, where only F is left.
template <Walk walk>
[[gnu::always_inline]] inline bool count_behind(const Frame& f, const Local& l, const Hit& e, Pixels& p) {
  const V alpha = clamped(e.alpha), T = p.T;
  if (l.mask != 0) p.T = T - keep(e.hit, alpha * T);
  count_hit<walk>(f, p, alpha, T, l.mask, e.hit);
  return any(e.hit);
}

[[gnu::always_inline]] inline bool any_open(const Pixels* p) {
  M open = p[0].open;
  for (int h = 1; h < kSub; ++h) open = either(open, p[h].open);
  return any(open);
}

// Blends a block's list into its pixels until all have stopped; returns whether one goes on. All pixels side by side, also where
// they are several vectors: what a Gaussian brings is fetched once for them.
template <Walk walk>
[[gnu::always_inline]] inline bool blend_list(const Frame& f, Chunk& c, int block, const BlockPixels& pixels, Pixels* p) {
  const uint8_t *at = c.list[block], *const end = at + c.listed[block];
  const bool to_end = f.without & SVRGS_TERMINATION;
  Entry* next = &c.entry[*at];
  BlockHits next_hits = evaluate_before<walk>(pixels, next->local);
  const auto walk_on = [&](auto&& on, auto&& take) __attribute__((always_inline)) {
    for (; at < end && on(); ++at) {
      Entry& entry = *next;
      const BlockHits hits = next_hits;
      next = &c.entry[at[1]];
      next_hits = evaluate_before<walk>(pixels, next->local);  // early: its long chain runs beside what follows
      bool hit = false;
      for (int h = 0; h < kSub; ++h) hit |= take(entry.local, hits.part[h], p[h]);
      entry.visit |= static_cast<BlockMask>(hit) << block;
    }
  };
  walk_on([&] { return any_open(p) || to_end; }, [&](const Local& l, const Hit& e, Pixels& some) { return blend<walk>(f, l, e, some); });
  const bool goes_on = any_open(p);
  if constexpr (walk.full)
    walk_on([] { return true; }, [&](const Local& l, const Hit& e, Pixels& some) { return count_behind<walk>(f, l, e, some); });
  return goes_on;
}

inline R* tile_state(const Frame& f, int64_t tile) {
  return static_cast<R*>(f.state) + tile * (kBlocks * kFields * kBlockPixels);
}

inline R* block_state(R* tile, int block, int h) { return tile + block * (kFields * kBlockPixels) + h * W; }

template <Walk walk>
inline Pixels load_pixels(const Frame& f, const R* at) {
  const auto field = [&](Field k) { return load(at + k * kBlockPixels); };
  Pixels p = {};
  p.T = field(kFullT), p.open = at_least(p.T, splat(R(kStop))), p.final_T = field(kFinalT), p.red = field(kRed), p.green = field(kGreen), p.blue = field(kBlue);
  if (f.want_depth) p.depth = field(kDepth);
  if constexpr (walk.count) p.count = field(kCount), p.dropped = field(kDropped);
  if constexpr (walk.scenario)
    for (int k = 0; k < 4; ++k) p.sums[k] = field(Field(kSum0 + k));
  return p;
}

template <Walk walk>
inline void store_pixels(const Frame& f, R* at, const Pixels& p) {
  const auto field = [&](Field k, V v) { store(at + k * kBlockPixels, v); };
  field(kFullT, p.T), field(kFinalT, p.final_T), field(kRed, p.red), field(kGreen, p.green), field(kBlue, p.blue);
  if (f.want_depth) field(kDepth, p.depth);
  if constexpr (walk.count) field(kCount, p.count), field(kDropped, p.dropped);
  if constexpr (walk.scenario)
    for (int k = 0; k < 4; ++k) field(Field(kSum0 + k), p.sums[k]);
}

// Clears a tile; returns its blocks with a pixel in the image. Pixels outside start with T = 0 and so never count as open.
template <Walk walk>
inline BlockMask start_tile(const Frame& f, TileOrigin o, R* state) {
  BlockMask inside = 0;
  for (int b = 0; b < kBlocks; ++b)
    for (int h = 0; h < kSub; ++h) {
      const M in = in_image(f, o, all_lanes().block[b], h);
      Pixels p = {};
      p.T = p.final_T = keep(in, splat(1));
      store_pixels<walk>(f, block_state(state, b, h), p);
      inside |= static_cast<BlockMask>(any(in)) << b;
    }
  return inside;
}

// Where F stops with the colours, the transmittance behind the last hit is theirs.
inline void end_with_colours(R* state) {
  for (int b = 0; b < kBlocks; ++b) {
    R* const block = block_state(state, b, 0);
    std::copy_n(block + kFinalT * kBlockPixels, kBlockPixels, block + kFullT * kBlockPixels);
  }
}

template <Walk walk>
void forward_tile_as(const Frame& f, int64_t tile) {
  const TileOrigin o = tile_origin(f, tile);
  R* const state = tile_state(f, tile);
  BlockMask inside = start_tile<walk>(f, o, state), open = inside;
  const TileEntry *entry = f.entries + f.tile_begin[tile], *const end = f.entries + f.tile_begin[tile + 1];
  Chunk c;
  Limits limits;
  if constexpr (walk.limited) read_limits(f, o, limits);
  while (entry < end && (walk.full || open || f.without & SVRGS_TERMINATION)) {
    if constexpr (walk.limited) {
      const BlockMask nearer = within(limits, splat_of(f, *entry).depth);
      inside &= nearer, open &= nearer;
      if (!inside) break;
    }
    const int n = static_cast<int>(std::min<int64_t>(kChunk, end - entry));
    const BlockMask active = walk.full || f.without & SVRGS_TERMINATION ? inside : open;
    gather_chunk(f, o, entry, end, n, active, c);
    for (BlockMask left = active; left; left &= left - 1) {
      const int b = __builtin_ctzll(left);
      if constexpr (walk.limited) trim(c, b, limits.block[b]);
      if (!c.listed[b]) continue;
      BlockPixels pixels = {all_lanes().block[b], {}};
      Pixels p[kSub];
      for (int h = 0; h < kSub; ++h) {
        p[h] = load_pixels<walk>(f, block_state(state, b, h));
        if constexpr (walk.limited) pixels.limit[h] = load(limits.pixel[b] + h * W);
      }
      const bool goes_on = blend_list<walk>(f, c, b, pixels, p);
      for (int h = 0; h < kSub; ++h) store_pixels<walk>(f, block_state(state, b, h), p[h]);
      if (!goes_on) open &= ~(BlockMask(1) << b);
    }
    for (int k = 0; k < n; ++k) f.hits[entry[k].slot] = c.entry[k].visit;
    entry += n;
  }
  for (; entry < end; ++entry) f.hits[entry->slot] = 0;
  if constexpr (!walk.full) end_with_colours(state);
}

template <bool limited>
void forward_tile_with(const Frame& f, int64_t tile) {
  const bool scenario = f.mask_kind == kMaskA || f.mask_kind == kMaskB;
  if (f.mask_kind == kMaskNone)
    forward_tile_as<Walk{false, false, false, limited}>(f, tile);
  else if (scenario)
    f.full ? forward_tile_as<Walk{true, true, true, limited}>(f, tile) : forward_tile_as<Walk{true, false, true, limited}>(f, tile);
  else
    f.full ? forward_tile_as<Walk{true, true, false, limited}>(f, tile) : forward_tile_as<Walk{true, false, false, limited}>(f, tile);
}

void forward_tile(const Frame& f, int64_t tile) { f.depth_limit ? forward_tile_with<true>(f, tile) : forward_tile_with<false>(f, tile); }

// Stage 4: blends one 16x16 tile front to back, in 4x4 blocks of 16 lanes. Per lane it carries the running transmittance T
// of every hit; colours stop at the first T below 1e-4 (T never rises again), F goes on where Frame::full asks for it.

struct Lanes {
  V x[kSub], y[kSub];
};

inline Lanes block_lanes() {
  Lanes l;
  for (int i = 0; i < kBlockPixels; ++i) {
    l.x[i / W][i % W] = static_cast<R>(i % kBlock);
    l.y[i / W][i % W] = static_cast<R>(i / kBlock);
  }
  return l;
}

// A Gaussian as seen from one tile: offsets of the tile's first pixel centre from the splat's centre.
struct Local {
  const Splat<R>* s;
  R x, y;
};

inline Local localise(const Frame& f, uint32_t id, int tile_x, int tile_y) {
  const Splat<R>& s = static_cast<const Splat<R>*>(f.splats)[id];
  return {&s, static_cast<R>(tile_x * kTile + 0.5 - s.x), static_cast<R>(tile_y * kTile + 0.5 - s.y)};
}

// Blocks of the tile the 1/255 ellipse can reach, one bit each.
inline uint32_t reached_blocks(const Local& l, const Lanes& blocks) {
  const Splat<R>& s = *l.s;
  const V t = splat(threshold(s)), l22 = splat(s.l22), inv = splat(s.inv_l11), slope = splat(-s.l12 * s.inv_l11), ye = splat(s.y_extreme);
  const V size = splat(R(kBlock - 1) + kBorderMargin), margin = splat(kBorderMargin);
  uint32_t mask = 0;
  for (int h = 0; h < kSub; ++h) {
    const V low = splat(l.y) + R(kBlock) * blocks.y[h], first = splat(l.x) + R(kBlock) * blocks.x[h];
    const Extent<V> e = ellipse_extent<V>(t, l22, inv, slope, ye, low - margin, low + size);
    const M hit = both(both(at_least(e.depth, splat(0)), at_least(e.right, first - margin)), at_least(first + size, e.left));
    mask |= bits(hit) << (h * W);
  }
  return mask;
}

struct Hit {
  V alpha, dx, dy;
  M hit, free;  // alpha >= 1/255; alpha below the clamp
};

// alpha of one Gaussian at the lanes of one (sub-)block. Forward, backward and scores call this and nothing else.
inline Hit evaluate(const Local& l, const Lanes& lanes, int block, int h) {
  const Splat<R>& s = *l.s;
  Hit r;
  r.dx = splat(l.x + R(kBlock * (block % kBlock))) + lanes.x[h];
  r.dy = splat(l.y + R(kBlock * (block / kBlock))) + lanes.y[h];
  const V u = fma(splat(s.l11), r.dx, splat(s.l12) * r.dy), v = splat(s.l22) * r.dy;
  const V alpha = exp2(fnma(u, u, fnma(v, v, splat(s.log2_opacity))));
  r.hit = at_least(alpha, splat(R(kAlphaCut)));
  r.free = less(alpha, splat(R(kAlphaMax)));
  r.alpha = min(alpha, splat(R(kAlphaMax)));
  return r;
}

constexpr int kAhead = 8;  // list entries fetched before they are needed: the list is in order, the splats are not

inline void prefetch_splat(const Frame& f, const TileEntry* entry, const TileEntry* end) {
  if (entry < end) __builtin_prefetch(static_cast<const Splat<R>*>(f.splats) + entry->splat);
}

struct TileOrigin {
  int x, y;  // tile coordinates
};

inline TileOrigin tile_origin(const Frame& f, int64_t tile) {
  return {static_cast<int>(tile % f.tiles_x), static_cast<int>(tile / f.tiles_x)};
}

inline R* tile_state(const Frame& f, int64_t tile) {
  return static_cast<R*>(f.state) + tile * (kBlocks * kFields * kBlockPixels);
}

// Running values of one tile, block-major; a lane outside the image starts with T = 0 and so never counts as open.
struct ForwardTile {
  V T[kBlocks][kSub], final_T[kBlocks][kSub], red[kBlocks][kSub], green[kBlocks][kSub], blue[kBlocks][kSub], depth[kBlocks][kSub];
  V count[kBlocks][kSub], dropped[kBlocks][kSub];  // N, and those among them with M = 0
  V sums[4][kBlocks][kSub];                        // scenarios: see add_scenario
  uint32_t open, inside;                           // blocks with a pixel whose colour goes on; with a pixel in the image
};

inline void start_tile(const Frame& f, TileOrigin o, const Lanes& lanes, ForwardTile& t) {
  __builtin_memset(&t, 0, sizeof t);
  const V right = splat(static_cast<R>(f.width - o.x * kTile)), bottom = splat(static_cast<R>(f.height - o.y * kTile));
  for (int b = 0; b < kBlocks; ++b)
    for (int h = 0; h < kSub; ++h) {
      const V x = splat(R(kBlock * (b % kBlock))) + lanes.x[h], y = splat(R(kBlock * (b / kBlock))) + lanes.y[h];
      const M in = both(less(x, right), less(y, bottom));
      t.T[b][h] = t.final_T[b][h] = keep(in, splat(1));
      t.inside |= static_cast<uint32_t>(any(in)) << b;
    }
  t.open = t.inside;
}

// Per-pixel sums behind scenarios A and B (paper Eq. 12-16), over counted hits:
// A: sum w, sum M w, sum alpha T w^2, sum M alpha T w^2 with w = 1 / (alpha T + eps).  B: sum M (1 - T), sum M T.
inline void add_scenario(const Frame& f, ForwardTile& t, int b, int h, V alpha, V T, R mask, M counted) {
  if (f.mask_kind == kMaskA) {
    const V weight = alpha * T, w = splat(1) / (weight + splat(static_cast<R>(f.eps_a))), slope = weight * w * w;
    t.sums[0][b][h] = add_if(counted, t.sums[0][b][h], w);
    t.sums[2][b][h] = add_if(counted, t.sums[2][b][h], slope);
    if (mask == 0) return;
    t.sums[1][b][h] = add_if(counted, t.sums[1][b][h], w);
    t.sums[3][b][h] = add_if(counted, t.sums[3][b][h], slope);
  } else if (mask != 0) {
    t.sums[0][b][h] = add_if(counted, t.sums[0][b][h], splat(1) - T);
    t.sums[1][b][h] = add_if(counted, t.sums[1][b][h], T);
  }
}

// One Gaussian over one block. Returns whether the backward pass must visit it here: it was counted in a lane, or ended one.
template <bool scenario>
inline bool blend_block(const Frame& f, ForwardTile& t, const Local& l, const Lanes& lanes, int b, bool open) {
  const Splat<R>& s = *l.s;
  const V stop = splat(R(kStop));
  bool matters = false, still_open = false;
  for (int h = 0; h < kSub; ++h) {
    const Hit e = evaluate(l, lanes, b, h);
    const V T = t.T[b][h];
    if (!any(e.hit)) {
      still_open |= open && any(at_least(T, stop));
      continue;
    }
    V next = T;
    M counted = e.hit;
    if (s.mask != 0) {
      const V weight = keep(e.hit, e.alpha * T);
      next = T - weight;
      const M live = at_least(next, stop);
      if (!f.full) counted = both(e.hit, live);
      if (open) {
        const V w = keep(live, weight);
        t.red[b][h] = fma(w, splat(s.rgb[0]), t.red[b][h]);
        t.green[b][h] = fma(w, splat(s.rgb[1]), t.green[b][h]);
        t.blue[b][h] = fma(w, splat(s.rgb[2]), t.blue[b][h]);
        if (f.want_depth) t.depth[b][h] = fma(w, splat(s.depth), t.depth[b][h]);
        t.final_T[b][h] = select(live, next, t.final_T[b][h]);
        still_open |= any(live);
      }
      t.T[b][h] = next;
    } else {
      const M live = at_least(T, stop);
      if (!f.full) counted = both(e.hit, live);
      still_open |= any(live);
      t.dropped[b][h] = add_if(counted, t.dropped[b][h], splat(1));
    }
    t.count[b][h] = add_if(counted, t.count[b][h], splat(1));
    matters |= f.full || any(both(e.hit, at_least(T, stop)));
    if constexpr (scenario) add_scenario(f, t, b, h, e.alpha, T, s.mask, counted);
  }
  if (open && !still_open) t.open &= ~(1u << b);
  return matters;
}

inline void finish_tile(const Frame& f, int64_t tile, const ForwardTile& t) {
  R* out = tile_state(f, tile);
  for (int b = 0; b < kBlocks; ++b)
    for (int h = 0; h < kSub; ++h) {
      R* lanes = out + b * kFields * kBlockPixels + h * W;
      const V* fields[kFields] = {&t.red[b][h], &t.green[b][h], &t.blue[b][h], &t.depth[b][h], &t.final_T[b][h],
                                  f.full ? &t.T[b][h] : &t.final_T[b][h], &t.count[b][h], &t.dropped[b][h],
                                  &t.sums[0][b][h], &t.sums[1][b][h], &t.sums[2][b][h], &t.sums[3][b][h]};
      for (int k = 0; k < kFields; ++k) store(lanes + k * kBlockPixels, *fields[k]);
    }
}

template <bool scenario>
void forward_tile_as(const Frame& f, int64_t tile) {
  const Lanes lanes = block_lanes();
  const TileOrigin o = tile_origin(f, tile);
  ForwardTile t;
  start_tile(f, o, lanes, t);
  const TileEntry* const end = f.entries + f.tile_begin[tile + 1];
  for (const TileEntry* e = f.entries + f.tile_begin[tile]; e < end; ++e) {
    const TileEntry entry = *e;
    uint32_t visit = 0;
    if (f.full || t.open) {
      prefetch_splat(f, e + kAhead, end);
      const Local l = localise(f, entry.splat, o.x, o.y);
      for (uint32_t blocks_left = reached_blocks(l, lanes) & (f.full ? t.inside : t.open); blocks_left; blocks_left &= blocks_left - 1) {
        const int b = __builtin_ctz(blocks_left);
        visit |= static_cast<uint32_t>(blend_block<scenario>(f, t, l, lanes, b, t.open >> b & 1)) << b;
      }
    }
    f.hits[entry.slot] = static_cast<uint16_t>(visit);
  }
  finish_tile(f, tile, t);
}

void forward_tile(const Frame& f, int64_t tile) {
  if (f.mask_kind == kMaskA || f.mask_kind == kMaskB)
    forward_tile_as<true>(f, tile);
  else
    forward_tile_as<false>(f, tile);
}

// Per-Gaussian statistics of the last view. They walk its tile lists again.

// Transmittance of a tile's pixels, block-major; starts at 1 inside the image and 0 outside.
struct Transmittance {
  V T[kBlocks][kVectorsPerBlock];
  Transmittance(const Frame& f, TileOrigin o) {
    for (int b = 0; b < kBlocks; ++b)
      for (int h = 0; h < kVectorsPerBlock; ++h) T[b][h] = keep(in_image(f, o, all_lanes().block[b], h), broadcast(1));
  }
  // The pixels that count.
  int64_t pixels() const {
    int64_t counting = 0;
    for (const auto& block : T)
      for (const V t : block) counting += __builtin_popcount(bits(less(broadcast(0), t)));
    return counting;
  }
};

// One Gaussian at W pixels of a block: its hits and its weights; T is updated.
struct Blended {
  M hit, live;
  V weight, transmittance;  // alpha T, T
};

inline Blended blend_again(const LocalGaussian& l, int block, int h, V& T) {
  const Lanes& lanes = all_lanes().block[block];
  const Hit e = evaluate(l, lanes.x[h], lanes.y[h]);
  const M open = at_least(T, broadcast(R(kStop)));
  if (l.mask == 0) return {e.hit(), both(e.hit(), open), broadcast(0), broadcast(0)};
  const V before = T, weight = keep(e.hit(), clamped(e.alpha) * T);
  T -= weight;
  const M live = both(e.hit(), at_least(T, broadcast(R(kStop))));
  return {e.hit(), live, keep(live, weight), keep(live, before)};
}

// Calls visit(entry, blocks, Gaussian in the tile's coordinates) for each entry of a tile's list that hits blocks and is drawn, from the nearest
// on, and fetches those behind it: the list is in order, the Gaussians it names are not. The slots of other entries are never read.
template <class F>
[[gnu::always_inline]] inline void for_hit_entries(const Frame& f, int64_t tile, TileOrigin o, F&& visit) {
  const TileEntry* const end = f.entries + f.tile_begin[tile + 1];
  for (const TileEntry* entry = f.entries + f.tile_begin[tile]; entry < end; ++entry) {
    if (entry + kEntriesAhead < end) {
      prefetch_gaussian(f, entry + kEntriesAhead, end);
      __builtin_prefetch(f.hits + entry[kEntriesAhead].slot);
    }
    const BlockMask blocks = f.hits[entry->slot];
    if (!blocks) continue;
    const LocalGaussian l = to_local(gaussian_of(f, *entry), o);
    if (l.mask != 0) visit(*entry, blocks, l);
  }
}

// Writes to the slot of each (Gaussian, tile) pair: the sum of alpha T, its maximum, the pixels blended, and the sum of T. known: the slots
// hold the scores of all pixels already.
void scores_tile(const Frame& f, int64_t tile, bool known, void* slots) {
  const TileOrigin o = f.tile_origin(tile);
  Transmittance t(f, o);
  const int64_t counting = t.pixels(), all = std::min<int64_t>(kTile, f.width - o.x * kTile) * std::min<int64_t>(kTile, f.height - o.y * kTile);
  if (known && counting == all) return;
  if (counting == 0) {
    for (int64_t e = f.tile_begin[tile]; e < f.tile_begin[tile + 1]; ++e)
      std::fill_n(static_cast<R*>(slots) + static_cast<int64_t>(f.entries[e].slot) * kScoreValues, kScoreValues, R(0));
    return;
  }
  for_hit_entries(f, tile, o, [&](const TileEntry& entry, BlockMask blocks, const LocalGaussian& l) {
    V total = broadcast(0), best = broadcast(0), pixels = broadcast(0), transmittance = broadcast(0);
    for (BlockMask left = blocks; left; left &= left - 1)
      for (int b = __builtin_ctzll(left), h = 0; h < kVectorsPerBlock; ++h) {
        const Blended w = blend_again(l, b, h, t.T[b][h]);
        total += w.weight;
        best = max(best, w.weight);
        pixels = add_if(w.live, pixels, broadcast(1));
        transmittance += w.transmittance;
      }
    R* slot = static_cast<R*>(slots) + static_cast<int64_t>(entry.slot) * kScoreValues;
    slot[0] = sum(total), slot[1] = largest(best), slot[2] = sum(pixels), slot[3] = sum(transmittance);
  });
}

void scores_range(const Frame& f, const void* slots, int64_t begin, int64_t end, const Scores& out) {
  for (int64_t i = begin; i < end; ++i) {
    const uint32_t id = f.visible[i];
    const GaussianTiles& t = f.tiles[f.places[i]];
    if (f.masks && !f.masks[id]) continue;
    for (uint32_t k = 0; k < t.tiles; ++k) {
      if (!f.hits[t.slot + k]) continue;
      if (out.reached) out.reached[id] = 1;
      if (!slots) break;
      const R* slot = static_cast<const R*>(slots) + static_cast<int64_t>(t.slot + k) * kScoreValues;
      if (out.sum) out.sum[id] += static_cast<double>(slot[0]);
      if (out.max) out.max[id] = std::max(out.max[id], static_cast<float>(slot[1]));
      if (out.hits) out.hits[id] += static_cast<int64_t>(slot[2]);
      if (out.transmittance) out.transmittance[id] += static_cast<double>(slot[3]);
    }
  }
}

// Running values of a tile's pixels: T, and the colour still to come, background included.
struct RemainingColour {
  V T[kBlocks][kVectorsPerBlock], rgb[kBlocks][kVectorsPerBlock][3];
  RemainingColour(const Frame& f, int64_t tile) {
    const TileOrigin o = f.tile_origin(tile);
    R* const state = tile_state(f, tile);
    for (int b = 0; b < kBlocks; ++b)
      for (int h = 0; h < kVectorsPerBlock; ++h) {
        const R* const at = block_state(state, b, h);
        const M inside = in_image(f, o, all_lanes().block[b], h);
        T[b][h] = keep(inside, broadcast(1));
        for (int c = 0; c < 3; ++c) rgb[b][h][c] = keep(inside, fma(kept(at, kFinalT), broadcast(static_cast<R>(f.background[c])), kept(at, Field(kRed + c))));
      }
  }
};

// A Gaussian's share of the colours of W pixels: d = alpha T (c - b), with b the colour behind it. Without the Gaussian the colours would be
// lower by d. If S is the colour still to come behind it, d = alpha (T c - S / (1 - alpha)). Updates `left` and T.
struct ColourShare {
  V rgb[3];
  M live;
};
inline ColourShare share(const LocalGaussian& l, const Hit& e, V& T, V left[3]) {
  const V alpha = clamped(e.alpha), weight = keep(e.hit(), alpha * T), before = T, inv = reciprocal(broadcast(1) - alpha);
  T -= weight;
  ColourShare s;
  s.live = both(e.hit(), at_least(T, broadcast(R(kStop))));
  for (int c = 0; c < 3; ++c) {
    left[c] -= keep(s.live, weight * broadcast(l.rgb[c]));
    s.rgb[c] = keep(s.live, alpha * (before * broadcast(l.rgb[c]) - left[c] * inv));
  }
  return s;
}

// w = sum over the channels of (alpha dC/dalpha)^2, 0 where alpha is clamped; alpha dC/dalpha is the share.
inline V sensitivity(const LocalGaussian& l, const Hit& e, V& T, V left[3]) {
  const ColourShare s = share(l, e, T, left);
  return keep(less(e.alpha, broadcast(R(kAlphaMax))), fma(s.rgb[0], s.rgb[0], fma(s.rgb[1], s.rgb[1], s.rgb[2] * s.rgb[2])));
}

// Writes to the slot of each pair the sums over pixels of alpha T, T, 1, |d|^2 and d.
void visibility_tile(const Frame& f, int64_t tile, void* slots) {
  const TileOrigin o = f.tile_origin(tile);
  RemainingColour t(f, tile);
  for_hit_entries(f, tile, o, [&](const TileEntry& entry, BlockMask blocks, const LocalGaussian& l) {
    V weights = broadcast(0), transmittance = broadcast(0), pixels = broadcast(0), squares = broadcast(0), d[3] = {};
    for (BlockMask left = blocks; left; left &= left - 1)
      for (int b = __builtin_ctzll(left), h = 0; h < kVectorsPerBlock; ++h) {
        const Lanes& lanes = all_lanes().block[b];
        const V before = t.T[b][h];
        const ColourShare s = share(l, evaluate(l, lanes.x[h], lanes.y[h]), t.T[b][h], t.rgb[b][h]);
        weights += keep(s.live, before - t.T[b][h]);
        transmittance += keep(s.live, before);
        pixels = add_if(s.live, pixels, broadcast(1));
        for (int c = 0; c < 3; ++c) d[c] += s.rgb[c], squares = fma(s.rgb[c], s.rgb[c], squares);
      }
    R* slot = static_cast<R*>(slots) + static_cast<int64_t>(entry.slot) * kSlotWidth;
    sum4(weights, transmittance, pixels, squares, slot);
    sum4(d[0], d[1], d[2], broadcast(0), slot + 4);
  });
}

// Adds the slots of each Gaussian among rows [begin, end) of the visible ones; if it is blended, also this view and its pixels per area.
void visibility_range(const Frame& f, const void* slots, int64_t begin, int64_t end, double* sums) {
  for (int64_t i = begin; i < end; ++i) {
    const uint32_t id = f.visible[i];
    const GaussianTiles& t = f.tiles[f.places[i]];
    if (f.masks && !f.masks[id]) continue;
    double* const row = sums + static_cast<int64_t>(id) * SVRGS_VISIBILITY;
    const double before = row[2];
    for (uint32_t k = 0; k < t.tiles; ++k) {
      if (!f.hits[t.slot + k]) continue;
      const R* slot = static_cast<const R*>(slots) + static_cast<int64_t>(t.slot + k) * kSlotWidth;
      for (int c = 0; c < 7; ++c) row[c] += static_cast<double>(slot[c]);
    }
    if (row[2] == before) continue;
    const double depth = f.orthographic ? 1.0 : static_cast<double>(static_cast<const ProjectedGaussian<R>*>(f.gaussians)[f.places[i]].shape.depth);
    row[7] += 1, row[8] += f.fx * f.fy / (depth * depth);
  }
}

// Writes to the slot of each pair by how much the sum of squared residuals (H, W, 3) would grow without the Gaussian: sum of d^2 - 2 r d.
void removal_tile(const Frame& f, int64_t tile, const void* residuals, void* slots) {
  const TileOrigin o = f.tile_origin(tile);
  RemainingColour t(f, tile);
  R residual[kBlocks][3][kBlockPixels] = {};
  for_blocks(f, tile, [&](int b, BlockPlace place) { read_block<3>(f, place, residuals, residual[b]); });
  for_hit_entries(f, tile, o, [&](const TileEntry& entry, BlockMask blocks, const LocalGaussian& l) {
    V cost = broadcast(0);
    for (BlockMask left = blocks; left; left &= left - 1)
      for (int b = __builtin_ctzll(left), h = 0; h < kVectorsPerBlock; ++h) {
        const Lanes& lanes = all_lanes().block[b];
        const ColourShare s = share(l, evaluate(l, lanes.x[h], lanes.y[h]), t.T[b][h], t.rgb[b][h]);
        for (int c = 0; c < 3; ++c) cost = fma(s.rgb[c], s.rgb[c] - R(2) * load(residual[b][c] + h * W), cost);
      }
    static_cast<R*>(slots)[entry.slot] = sum(cost);
  });
}

// Writes to the slot of each pair the sum over pixels of (sum over the channels of dC/dG)^2, G the value of the Gaussian, alpha = opacity G:
// dC/dG = opacity d / alpha. As published, the clamp of alpha is not differentiated.
void slopes_tile(const Frame& f, int64_t tile, void* slots) {
  const TileOrigin o = f.tile_origin(tile);
  RemainingColour t(f, tile);
  for_hit_entries(f, tile, o, [&](const TileEntry& entry, BlockMask blocks, const LocalGaussian& l) {
    V total = broadcast(0);
    for (BlockMask left = blocks; left; left &= left - 1)
      for (int b = __builtin_ctzll(left), h = 0; h < kVectorsPerBlock; ++h) {
        const Lanes& lanes = all_lanes().block[b];
        const Hit hit = evaluate(l, lanes.x[h], lanes.y[h]);
        const ColourShare s = share(l, hit, t.T[b][h], t.rgb[b][h]);
        const V slope = keep(s.live, (s.rgb[0] + s.rgb[1] + s.rgb[2]) / clamped(hit.alpha));
        total = fma(slope, slope, total);
      }
    static_cast<R*>(slots)[entry.slot] = sum(total) * std::exp2(2 * l.log2_opacity);
  });
}

// Writes to the slot of each pair the number of pixels in which the Gaussian has the largest alpha T of all; of equal ones the nearest.
void dominance_tile(const Frame& f, int64_t tile, void* slots) {
  const int64_t end = f.tile_begin[tile + 1];
  const TileOrigin o = f.tile_origin(tile);
  Transmittance t(f, o);
  V best[kBlocks][kVectorsPerBlock] = {};
  int64_t who[kBlocks][kBlockPixels];
  for (int b = 0; b < kBlocks; ++b) std::fill_n(who[b], kBlockPixels, end);
  for_hit_entries(f, tile, o, [&](const TileEntry& entry, BlockMask blocks, const LocalGaussian& l) {
    static_cast<R*>(slots)[entry.slot] = 0;
    for (BlockMask left = blocks; left; left &= left - 1)
      for (int b = __builtin_ctzll(left), h = 0; h < kVectorsPerBlock; ++h) {
        const V weight = blend_again(l, b, h, t.T[b][h]).weight;
        for (uint32_t more = bits(less(best[b][h], weight)); more; more &= more - 1) who[b][h * W + __builtin_ctz(more)] = &entry - f.entries;
        best[b][h] = max(best[b][h], weight);
      }
  });
  for (int b = 0; b < kBlocks; ++b)
    for (const int64_t e : who[b])
      if (e < end) static_cast<R*>(slots)[f.entries[e].slot] += 1;
}

// Adds the slots of each Gaussian among rows [begin, end) of the visible ones to out (N,).
void sums_range(const Frame& f, const void* slots, int64_t begin, int64_t end, double* out) {
  for (int64_t i = begin; i < end; ++i) {
    const uint32_t id = f.visible[i];
    const GaussianTiles& t = f.tiles[f.places[i]];
    if (f.masks && !f.masks[id]) continue;
    for (uint32_t k = 0; k < t.tiles; ++k)
      if (f.hits[t.slot + k]) out[id] += static_cast<double>(static_cast<const R*>(slots)[t.slot + k]);
  }
}

// Writes to the slot of each pair the moments of w in (u, v), in the order of svrgs_moments.
void moments_tile(const Frame& f, int64_t tile, void* slots) {
  const TileOrigin o = f.tile_origin(tile);
  RemainingColour t(f, tile);
  for_hit_entries(f, tile, o, [&](const TileEntry& entry, BlockMask blocks, const LocalGaussian& l) {
    V m[SVRGS_MOMENTS] = {};
    for (BlockMask left = blocks; left; left &= left - 1)
      for (int b = __builtin_ctzll(left), h = 0; h < kVectorsPerBlock; ++h) {
        const Lanes& lanes = all_lanes().block[b];
        const Hit hit = evaluate(l, lanes.x[h], lanes.y[h]);
        const V w = sensitivity(l, hit, t.T[b][h], t.rgb[b][h]), u = keep(hit.hit(), hit.u), v = keep(hit.hit(), hit.v), uu = u * u, uv = u * v, vv = v * v;
        const V wuu = w * uu, wuv = w * uv, wvv = w * vv;
        const V found[SVRGS_MOMENTS] = {wuu, wuv, wvv, wuu * u, wuu * v, wuv * v, wvv * v, wuu * uu, wuu * uv, wuu * vv, wuv * vv, wvv * vv};
        for (int k = 0; k < SVRGS_MOMENTS; ++k) m[k] += found[k];
      }
    R* slot = static_cast<R*>(slots) + static_cast<int64_t>(entry.slot) * SVRGS_MOMENTS;
    for (int k = 0; k < SVRGS_MOMENTS; ++k) slot[k] = sum(m[k]);
  });
}

// Rows [begin, end) of the visible Gaussians.
void moments_range(const Frame& f, const void* slots, int64_t begin, int64_t end, double* out) {
  for (int64_t i = begin; i < end; ++i) {
    const GaussianTiles& t = f.tiles[f.places[i]];
    double* row = out + i * SVRGS_MOMENTS;
    std::fill_n(row, SVRGS_MOMENTS, 0.0);
    if (f.masks && !f.masks[f.visible[i]]) continue;
    for (uint32_t k = 0; k < t.tiles; ++k) {
      if (!f.hits[t.slot + k]) continue;
      const R* slot = static_cast<const R*>(slots) + static_cast<int64_t>(t.slot + k) * SVRGS_MOMENTS;
      for (int m = 0; m < SVRGS_MOMENTS; ++m) row[m] += static_cast<double>(slot[m]);
    }
  }
}

// Per-Gaussian statistics of a view, and how much work it was: both walk the tile lists again, for what the last forward pass
// blended.

// Transmittance of a tile's pixels, block-major; starts at 1 inside the image and 0 outside.
struct Transmittance {
  V T[kBlocks][kSub];
  Transmittance(const Frame& f, TileOrigin o) {
    for (int b = 0; b < kBlocks; ++b)
      for (int h = 0; h < kSub; ++h) T[b][h] = keep(in_image(f, o, all_lanes().block[b], h), splat(1));
  }
};

// One Gaussian over one part of a block: its hits, what it blends where, and T moved on.
struct Blended {
  M hit, live;
  V weight;
};

inline Blended blend_again(const Local& l, int block, int h, V& T) {
  const Lanes& lanes = all_lanes().block[block];
  const Hit e = evaluate(l, lanes.x[h], lanes.y[h]);
  const M open = at_least(T, splat(R(kStop)));
  if (l.mask == 0) return {e.hit, both(e.hit, open), splat(0)};
  const V weight = keep(e.hit, clamped(e.alpha) * T);
  T -= weight;
  const M live = both(e.hit, at_least(T, splat(R(kStop))));
  return {e.hit, live, keep(live, weight)};
}

// Slot of each pair: sum of alpha T, its maximum, pixels blended.
void scores_tile(const Frame& f, int64_t tile, void* slots) {
  const TileOrigin o = tile_origin(f, tile);
  Transmittance t(f, o);
  for (int64_t e = f.tile_begin[tile]; e < f.tile_begin[tile + 1]; ++e) {
    const TileEntry entry = f.entries[e];
    const Local l = localise(splat_of(f, entry), o);
    if (l.mask == 0) continue;
    V total = splat(0), best = splat(0), pixels = splat(0);
    for (BlockMask left = f.hits[entry.slot]; left; left &= left - 1)
      for (int b = __builtin_ctzll(left), h = 0; h < kSub; ++h) {
        const Blended w = blend_again(l, b, h, t.T[b][h]);
        total += w.weight;
        best = max(best, w.weight);
        pixels = add_if(w.live, pixels, splat(1));
      }
    R* slot = static_cast<R*>(slots) + static_cast<int64_t>(entry.slot) * kSlotWidth;
    slot[0] = sum(total), slot[1] = largest(best), slot[2] = sum(pixels);
  }
}

void scores_range(const Frame& f, const void* slots, int64_t begin, int64_t end, double* sum_out, float* max_out, int64_t* hits_out) {
  for (int64_t i = begin; i < end; ++i) {
    const uint32_t id = f.visible[i];
    const SplatTiles& t = f.tiles[f.places[i]];
    if (f.masks && !f.masks[id]) continue;
    for (uint32_t k = 0; k < t.tiles; ++k) {
      if (!f.hits[t.slot + k]) continue;
      const R* slot = static_cast<const R*>(slots) + static_cast<int64_t>(t.slot + k) * kSlotWidth;
      if (sum_out) sum_out[id] += static_cast<double>(slot[0]);
      if (max_out) max_out[id] = std::max(max_out[id], static_cast<float>(slot[1]));
      if (hits_out) hits_out[id] += static_cast<int64_t>(slot[2]);
    }
  }
}

// Adds a tile's work. `blocks` are those whose alpha the forward pass computed.
void count_tile(const Frame& f, int64_t tile, svrgs_work& work) {
  const TileOrigin o = tile_origin(f, tile);
  Transmittance t(f, o);
  Chunk c;
  const TileEntry *entry = f.entries + f.tile_begin[tile], *const end = f.entries + f.tile_begin[tile + 1];
  while (entry < end) {
    const int n = static_cast<int>(std::min<int64_t>(kChunk, end - entry));
    gather_chunk(f, o, entry, end, n, static_cast<BlockMask>(~BlockMask(0)), c);
    for (int k = 0; k < n; ++k) work.used_pairs += f.hits[entry[k].slot] != 0;
    for (int b = 0; b < kBlocks; ++b)
      for (int i = 0; i < c.listed[b]; ++i) {
        int hit = 0;
        bool computed = false;
        for (int h = 0; h < kSub; ++h) {
          const bool open = any(at_least(t.T[b][h], splat(R(kStop))));
          if (!f.full && !open && !(f.without & SVRGS_TERMINATION)) continue;
          const M inside = less(splat(0), t.T[b][h]);  // it starts at 0 outside the image
          computed = true;
          const Blended w = blend_again(c.local[c.list[b][i]], b, h, t.T[b][h]);
          hit += __builtin_popcount(bits(both(w.hit, inside)));
          work.contributing += __builtin_popcount(bits(w.live));
        }
        work.blocks += computed, work.hit_blocks += hit > 0, work.hits += hit;
      }
    entry += n;
  }
}

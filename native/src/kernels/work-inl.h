// Counts the work of the last view by walking its tile lists again.

// Adds the work of one tile.
void count_tile(const Frame& f, int64_t tile, svrgs_work& work) {
  const TileOrigin o = f.tile_origin(tile);
  Transmittance t(f, o);
  Chunk c;
  const TileEntry *entry = f.entries + f.tile_begin[tile], *const end = f.entries + f.tile_begin[tile + 1];
  while (entry < end) {
    const int n = static_cast<int>(std::min<int64_t>(kChunkEntries, end - entry));
    gather_chunk(f, o, entry, end, n, static_cast<BlockMask>(~BlockMask(0)), c);
    for (int k = 0; k < n; ++k) work.used_pairs += f.hits[entry[k].slot] != 0;
    for (int b = 0; b < kBlocks; ++b) {
      const int listed = list_block(c, b, n);
      for (int i = 0; i < listed; ++i) {
        int hit = 0;
        bool computed = false;
        for (int h = 0; h < kVectorsPerBlock; ++h) {
          const bool open = any(at_least(t.T[b][h], broadcast(static_cast<R>(f.stop))));
          if (!f.full && !open && !(f.disabled_skips & SVRGS_TERMINATION)) continue;
          const M inside = less(broadcast(0), t.T[b][h]);  // it starts at 0 outside the image
          computed = true;
          const Blended w = blend_again(c.entry[c.list[i]].local, b, h, t.T[b][h]);
          hit += __builtin_popcount(bits(both(w.hit, inside)));
          work.contributing += __builtin_popcount(bits(w.live));
        }
        work.blocks += computed, work.hit_blocks += hit > 0, work.hits += hit;
      }
    }
    entry += n;
  }
}

// A Gaussian at the pixels of a tile: its alpha, and which pixels it hits. Forward, backward and statistics use this.

// A Gaussian relative to a tile: (x, y) from its centre to the tile's first pixel.
struct LocalGaussian : GaussianShape<R> {
  R x, y;
};

inline const ProjectedGaussian<R>& gaussian_of(const Frame& f, TileEntry e) { return static_cast<const ProjectedGaussian<R>*>(f.gaussians)[e.place]; }

inline LocalGaussian to_local(const ProjectedGaussian<R>& s, TileOrigin o) {
  const R x = static_cast<R>(o.x * kTile + 0.5 - s.x), y = static_cast<R>(o.y * kTile + 0.5 - s.y);
  return {s.shape, x, y};
}

// Whether the mask is 1. An integer comparison: the vector units have enough to do.
inline bool drawn(const LocalGaussian& l) { return __builtin_bit_cast(std::conditional_t<sizeof(R) == 8, uint64_t, uint32_t>, l.mask) != 0; }

constexpr int kEntriesAhead = 16;  // list entries fetched before they are needed: the list is in order, the Gaussians it names are not

inline void prefetch_gaussian(const Frame& f, const TileEntry* entry, const TileEntry* end) {
  if (entry < end) __builtin_prefetch(&gaussian_of(f, *entry));
}

// Offsets of a block's pixels from the tile's first pixel.
struct Lanes {
  V x[kVectorsPerBlock], y[kVectorsPerBlock];
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

// Bit `block` of a BlockMask if `set`, else none.
inline BlockMask block_bit(int block, bool set) { return static_cast<BlockMask>(static_cast<BlockMask>(set) << block); }

// Those of the lanes that are valid. Not inlined: few views have pixels that are not.
[[gnu::noinline]] M valid_lanes(const Frame& f, TileOrigin o, const Lanes& lanes, int h, M inside) {
  V valid = broadcast(0);
  for (uint32_t left = bits(inside); left; left &= left - 1) {
    const int k = __builtin_ctz(left);
    const int64_t x = o.x * kTile + static_cast<int>(lanes.x[h][k]), y = o.y * kTile + static_cast<int>(lanes.y[h][k]);
    valid[k] = R(f.valid[y * f.width + x] != 0);
  }
  return less(broadcast(0), valid);
}

// Which of W lanes of a block are in the image, and valid.
inline M in_image(const Frame& f, TileOrigin o, const Lanes& lanes, int h) {
  const M inside =
      both(less(lanes.x[h], broadcast(static_cast<R>(f.width - o.x * kTile))), less(lanes.y[h], broadcast(static_cast<R>(f.height - o.y * kTile))));
  return f.valid ? valid_lanes(f, o, lanes, h, inside) : inside;
}

struct Hit {
  V alpha, u, v;                                                        // u, v: as in ProjectedGaussian
  V exponent;                                                           // log2 of alpha
  M hit() const { return at_least(exponent, broadcast(R(kLog2Cut))); }  // alpha >= 1/255; computed where it is needed: GCC moves masks that it keeps
};

// alpha of one Gaussian at W pixels, not yet clamped; undefined where `hit` is not set. Every pass computes alpha with this function.
// Always inline: a call costs the backward pass 5 %.
[[gnu::always_inline]] inline Hit evaluate(const LocalGaussian& l, V x, V y) {
  Hit r;
  const V dx = broadcast(l.x) + x, dy = broadcast(l.y) + y;
  r.u = fma(broadcast(l.l11), dx, broadcast(l.l12) * dy);
  r.v = broadcast(l.l22) * dy;
  r.exponent = fnma(r.u, r.u, fnma(r.v, r.v, broadcast(l.log2_opacity)));
  r.alpha = exp2(r.exponent);
  return r;
}

struct BlockHits {
  Hit part[kVectorsPerBlock];
};

[[gnu::always_inline]] inline BlockHits evaluate_block(const LocalGaussian& l, const Lanes& lanes) {
  BlockHits hits;
  for (int h = 0; h < kVectorsPerBlock; ++h) hits.part[h] = evaluate(l, lanes.x[h], lanes.y[h]);
  return hits;
}

inline V clamped(V alpha) { return min(alpha, broadcast(R(kAlphaMax))); }

// Stage 4a: a chunk of a tile's list is sorted into the 4x4 blocks that its Gaussians reach; depth limits of a tile's pixels.

// Up to kChunkEntries entries of a tile's list, and for each block the list of the entries that reach it.
constexpr int kChunkEntries = 256;
static_assert(kChunkEntries <= 256 && kChunkEntries % 16 == 0);

struct Entry {
  LocalGaussian local;
  BlockMask visit;  // blocks the backward pass must visit
};

struct Chunk {
  Entry entry[kChunkEntries];
  R bound[kChunkEntries], l22[kChunkEntries], inv_l11[kChunkEntries], slope[kChunkEntries], y_extreme[kChunkEntries], x[kChunkEntries], y[kChunkEntries];
  uint8_t list[kBlocks][kChunkEntries + 16];  // append_lanes writes 16 at a time
  int listed[kBlocks];
};

// Adds entries [first, first + W) to the lists of the blocks their ellipses reach.
inline void list_blocks(const Frame& f, Chunk& c, int first, int count, BlockMask active) {
  const V bound = load(c.bound + first), l22 = load(c.l22 + first), inv = load(c.inv_l11 + first), slope = load(c.slope + first);
  const V ye = load(c.y_extreme + first), x = load(c.x + first), y = load(c.y + first), margin = broadcast(kBorderMargin);
  constexpr BlockMask row = (BlockMask(1) << kBlockColumns) - 1;
  for (int b = 0; b < kBlocks; b += kBlockColumns) {
    if (!(active & row << b)) continue;
    const V low = y + broadcast(R(b / kBlockColumns * kBlockHeight)), high = low + broadcast(R(kBlockHeight - 1));
    const Extent e = ellipse_extent(bound, l22, inv, slope, ye, low - margin, high + margin);
    const M crosses = at_least(e.depth, broadcast(0));
    const V right = e.right + margin, left = e.left - margin;
    for (int column = 0; column < kBlockColumns; ++column) {
      const int block = b + column;
      if (!(active >> block & 1)) continue;
      const V from = x + broadcast(R(column * kBlockWidth)), to = from + broadcast(R(kBlockWidth - 1));
      uint32_t hit = bits(both(crosses, both(at_least(right, from), at_least(to, left))));
      if (f.disabled_skips & SVRGS_BLOCK_TESTS) hit = (1u << W) - 1;
      if (count < W) hit &= (1u << count) - 1;
      c.listed[block] = append_lanes(c.list[block], c.listed[block], first, hit);
    }
  }
}

inline void gather_chunk(const Frame& f, TileOrigin o, const TileEntry* entries, const TileEntry* end, int n, BlockMask active, Chunk& c) {
  for (int k = 0; k < n; ++k) {
    prefetch_gaussian(f, entries + k + kEntriesAhead, end);
    const ProjectedGaussian<R>& s = gaussian_of(f, entries[k]);
    const LocalGaussian& l = (c.entry[k] = {to_local(s, o), 0}).local;
    c.bound[k] = ellipse_bound(f, s.log2_opacity), c.l22[k] = s.l22, c.inv_l11[k] = s.inv_l11, c.slope[k] = s.slope, c.y_extreme[k] = s.y_extreme;
    c.x[k] = l.x, c.y[k] = l.y;
  }
  std::fill_n(c.listed, kBlocks, 0);
  for (int k = 0; k < n; k += W) list_blocks(f, c, k, n - k, active);
  for (int b = 0; b < kBlocks; ++b) c.list[b][c.listed[b]] = 0;  // blending looks one entry ahead
}

// Depth limits of a tile's pixels; 0 outside the image and where the limit is NaN.
struct DepthLimits {
  R pixel[kBlocks][kBlockPixels], block[kBlocks];  // block: the largest of its pixels'
};

inline void read_limits(const Frame& f, TileOrigin o, DepthLimits& limits) {
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

// Blocks with a limit behind this depth. The margin is for rounding: lists are sorted by depth as float.
inline BlockMask within(const DepthLimits& limits, R depth) {
  BlockMask blocks = 0;
  for (int b = 0; b < kBlocks; ++b) blocks |= block_bit(b, depth * R(1 - 1e-6) < limits.block[b]);
  return blocks;
}

// Removes the entries of a block's list that are behind all of the block's limits.
inline void trim(Chunk& c, int block, R limit) {
  int& n = c.listed[block];
  while (n && !(c.entry[c.list[block][n - 1]].local.depth < limit)) --n;
}

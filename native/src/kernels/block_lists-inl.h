// Stage 4a: a chunk of a tile's list is sorted into the 4x4 blocks that its Gaussians reach; depth limits of a tile's pixels. First each entry
// gets a byte for each row of blocks, with a bit for each block. These bits are then turned into a set of entries for each block, and a set
// into a list when the block is blended.

constexpr int kChunkEntries = 256;  // of a tile's list, at most
constexpr int kBlockRows = kBlocks / kBlockColumns;
constexpr BlockMask kRowMask = (BlockMask(1) << kBlockColumns) - 1;  // the blocks of the first row
static_assert(kChunkEntries <= 256 && kChunkEntries % 64 == 0 && kBlockColumns <= 8);

struct Entry {
  LocalGaussian local;
  BlockMask visit;  // blocks the backward pass must visit
};

struct Chunk {  // the arrays of R repeat values of the entries, to be loaded as vectors
  Entry entry[kChunkEntries];
  R bound[kChunkEntries], l22[kChunkEntries], inv_l11[kChunkEntries], slope[kChunkEntries], y_extreme[kChunkEntries], x[kChunkEntries], y[kChunkEntries];
  uint8_t reached[kBlockRows][kChunkEntries];      // by row of blocks and entry: a bit for each block
  uint64_t reaching[kBlocks][kChunkEntries / 64];  // by block: a bit for each entry
  uint8_t list[kChunkEntries + 64];                // the entries that reach one block
};

// 2^n of whole numbers.
inline V power_of_two(I n) { return sizeof(R) == 8 ? (V)((U)(n + 1023) << 52) : (V)((U)(n + 127) << 23); }

// Which blocks of the active rows the ellipses of entries [first, first + W) reach.
inline void find_reached(Chunk& c, int first, BlockMask active) {
  const V bound = load(c.bound + first), l22 = load(c.l22 + first), inv = load(c.inv_l11 + first), slope = load(c.slope + first);
  const V ye = load(c.y_extreme + first), x = load(c.x + first), y = load(c.y + first), margin = broadcast(kBorderMargin);
  const V zero = broadcast(0), columns = broadcast(kBlockColumns);
  for (int row = 0; row < kBlockRows; ++row) {
    if (!(active >> row * kBlockColumns & kRowMask)) continue;
    const V low = y + broadcast(R(row * kBlockHeight)), high = low + broadcast(R(kBlockHeight - 1));
    const Extent e = ellipse_extent(bound, l22, inv, slope, ye, low - margin, high + margin);
    const M crosses = at_least(e.depth, zero);
    // A block is reached if its first pixel is not beyond the right end and its last one not before the left end.
    const V end = (e.right + margin - x) * R(1.0 / kBlockWidth) + R(1), rest = columns - (e.left - margin - x - R(kBlockWidth - 1)) * R(1.0 / kBlockWidth);
    const I to = __builtin_convertvector(clamp(end, zero, columns), I), from = kBlockColumns - __builtin_convertvector(clamp(rest, zero, columns), I);
    const V blocks = keep(crosses, max(power_of_two(to) - power_of_two(from), zero));
    store_bytes(c.reached[row] + first, __builtin_convertvector(blocks, I));
  }
}

inline void gather_chunk(const Frame& f, TileOrigin o, const TileEntry* entries, const TileEntry* end, int n, BlockMask active, Chunk& c) {
  for (int k = 0; k < n; ++k) {
    prefetch_gaussian(f, entries + k + kEntriesAhead, end);
    c.entry[k] = {to_local(gaussian_of(f, entries[k]), o), 0};
    const LocalGaussian& l = c.entry[k].local;
    c.bound[k] = ellipse_bound(f, l.log2_opacity), c.l22[k] = l.l22, c.inv_l11[k] = l.inv_l11, c.slope[k] = l.slope, c.y_extreme[k] = l.y_extreme;
    c.x[k] = l.x, c.y[k] = l.y;
  }
  for (int k = 0; k < n; k += W) find_reached(c, k, active);
  if (f.disabled_skips & SVRGS_BLOCK_TESTS) __builtin_memset(c.reached, 0xff, sizeof c.reached);
  const int sets = (n + 63) / 64;
  for (int row = 0; row < kBlockRows; ++row) {
    if (!(active >> row * kBlockColumns & kRowMask)) continue;
    __builtin_memset(c.reached[row] + n, 0, 64 * sets - n);
    for (int column = 0; column < kBlockColumns; ++column)
      for (int i = 0; i < sets; ++i) c.reaching[row * kBlockColumns + column][i] = bit_of_bytes(c.reached[row] + 64 * i, column);
  }
}

// Lists the entries of a chunk of n that reach an active block. Returns how many.
inline int list_block(Chunk& c, int block, int n) {
  const int listed = list_bits(c.reaching[block], (n + 63) / 64, c.list);
  c.list[listed] = 0;  // blending looks one entry ahead
  return listed;
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

// How many of the first `listed` entries of the chunk's list are not behind all limits of the block.
inline int trimmed(const Chunk& c, int listed, R limit) {
  while (listed && !(c.entry[c.list[listed - 1]].local.depth < limit)) --listed;
  return listed;
}

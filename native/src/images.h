// From a tile's kept state to output images, and from image gradients to lanes. Images are row-major, tiles are stored block
// by block.

constexpr int kLogTable = 1024;

// 1 / log(1 + n), n whole; 0 for n = 0, so that F := 0 with zero gradient where no Gaussian is on the ray.
inline R inverse_log(R n) {
  struct Table {
    R value[kLogTable];
    Table() {
      value[0] = 0;
      for (int i = 1; i < kLogTable; ++i) value[i] = static_cast<R>(1.0 / std::log1p(static_cast<double>(i)));
    }
  };
  static const Table table;
  const int i = static_cast<int>(n);
  return i < kLogTable ? table.value[i] : static_cast<R>(1.0 / std::log1p(static_cast<double>(n)));
}

inline V inverse_log(V n) {
  for (int i = 0; i < W; ++i) n[i] = inverse_log(R(n[i]));
  return n;
}

// One of a block's kept values, W lanes of it.
inline V kept(const R* state, Field k) { return load(state + k * kBlockPixels); }

// F of W pixels, paper Eq. 5 in closed form (design.md section 3), or of a scenario.
inline V spatial_mask(const Frame& f, const R* state) {
  if (f.mask_kind == kMaskNone) return splat(0);
  const V n = kept(state, kCount);
  if (f.mask_kind == kMaskA) return keep(less(splat(0), n), kept(state, kSum1) / kept(state, kSum0));
  if (f.mask_kind == kMaskB) return kept(state, kSum0) * inverse_log(n);
  return (n - kept(state, kDropped) - splat(1) + kept(state, kFullT)) * inverse_log(n);
}

struct BlockPlace {
  int64_t first;      // image index of the block's first pixel
  int rows, columns;  // of it inside the image
};

// Calls visit(block, place) for every block of the tile with a pixel inside the image.
template <class F>
inline void for_blocks(const Frame& f, int64_t tile, F&& visit) {
  const TileOrigin o = tile_origin(f, tile);
  for (int b = 0; b < kBlocks; ++b) {
    const int x = o.x * kTile + b % kBlockColumns * kBlockWidth, y = o.y * kTile + b / kBlockColumns * kBlockHeight;
    if (x >= f.width || y >= f.height) continue;
    visit(b, BlockPlace{static_cast<int64_t>(y) * f.width + x, std::min(kBlockHeight, f.height - y), std::min(kBlockWidth, f.width - x)});
  }
}

// Calls visit(image index, lane) for the block's pixels inside the image.
template <class F>
inline void for_pixels(const Frame& f, BlockPlace p, F&& visit) {
  for (int y = 0; y < p.rows; ++y)
    for (int x = 0; x < p.columns; ++x) visit(p.first + static_cast<int64_t>(y) * f.width + x, y * kBlockWidth + x);
}

// Writes one channel of a block's pixels; value(state of W lanes) gives W of them.
template <class T, class F>
inline void write_block(const Frame& f, BlockPlace place, const R* block, T* image, int channels, F&& value) {
  alignas(64) R lanes[kBlockPixels];
  for (int h = 0; h < kSub; ++h) store(lanes + h * W, value(block + h * W));
  for_pixels(f, place, [&](int64_t at, int lane) { image[channels * at] = static_cast<T>(lanes[lane]); });
}

void write_tile(const Frame& f, int64_t tile, const svrgs_images& out) {
  const R* const state = tile_state(f, tile);
  for_blocks(f, tile, [&](int b, BlockPlace p) {
    const R* const block = block_state(const_cast<R*>(state), b, 0);
    const auto write = [&](auto* image, int channels, auto&& value) { write_block(f, p, block, image, channels, value); };
    const auto real = [](void* image) { return static_cast<R*>(image); };
    for (int c = 0; c < 3 && out.rgb; ++c)
      write(real(out.rgb) + c, 3, [&](const R* s) { return fma(kept(s, kFinalT), splat(static_cast<R>(f.background[c])), kept(s, Field(kRed + c))); });
    if (out.depth) write(real(out.depth), 1, [](const R* s) { return kept(s, kDepth); });
    if (out.alpha) write(real(out.alpha), 1, [](const R* s) { return splat(1) - kept(s, kFinalT); });
    if (out.mask) write(real(out.mask), 1, [&](const R* s) { return spatial_mask(f, s); });
    if (out.transmittance) write(real(out.transmittance), 1, [](const R* s) { return kept(s, kFullT); });
    const auto count = [&](const R* s, Field k) { return f.mask_kind == kMaskNone ? splat(0) : kept(s, k); };
    if (out.hits) write(out.hits, 1, [&](const R* s) { return count(s, kCount); });
    if (out.kept) write(out.kept, 1, [&](const R* s) { return count(s, kCount) - count(s, kDropped); });
  });
}

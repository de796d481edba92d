// From a tile's stored state to the output images, and from image gradients to lanes. Images are row-major; tiles are stored block by
// block.

// 1 / log(1 + n) for whole numbers n; 0 for n = 0, so that F and its gradient are 0 where no Gaussian is on the ray.
inline V inverse_log(V n) { return keep(less(broadcast(0), n), broadcast(R(1.4426950408889634)) / log2(n + R(1))); }

// W lanes of a stored field.
inline V kept(const R* state, Field k) { return load(state + k * kBlockPixels); }

// F of W pixels, paper Eq. 5 in closed form (docs/methods.md), or of a scenario.
inline V spatial_mask(const Frame& f, const R* state) {
  if (f.mask_kind == SVRGS_MASK_NONE) return broadcast(0);
  const V n = kept(state, kCount);
  if (f.mask_kind == SVRGS_MASK_A) return keep(less(broadcast(0), n), kept(state, kSum1) / kept(state, kSum0));
  if (f.mask_kind == SVRGS_MASK_B) return kept(state, kSum0) * inverse_log(n);
  return (n - kept(state, kDropped) - broadcast(1) + kept(state, kFullT)) * inverse_log(n);
}

struct BlockPlace {
  int64_t first;      // image index of the block's first pixel
  int rows, columns;  // of it inside the image
};

// Calls visit(block, place) for every block of the tile with a pixel inside the image.
template <class F>
inline void for_blocks(const Frame& f, int64_t tile, F&& visit) {
  const TileOrigin o = f.tile_origin(tile);
  for (int b = 0; b < kBlocks; ++b) {
    const int x = o.x * kTile + b % kBlockColumns * kBlockWidth, y = o.y * kTile + b / kBlockColumns * kBlockHeight;
    if (x >= f.width || y >= f.height) continue;
    visit(b, BlockPlace{static_cast<int64_t>(y) * f.width + x, std::min(kBlockHeight, f.height - y), std::min(kBlockWidth, f.width - x)});
  }
}

// Calls visit(image index, lane) for the first pixel of each of the block's rows inside the image.
template <class F>
inline void for_rows(const Frame& f, BlockPlace p, F&& visit) {
  for (int y = 0; y < p.rows; ++y) visit(p.first + static_cast<int64_t>(y) * f.width, y * kBlockWidth);
}

inline bool is_whole(BlockPlace p) { return p.rows == kBlockHeight && p.columns == kBlockWidth; }

// A block of an image (H, W, channels): kBlockPixels values a channel, 0 outside the image.
template <int channels>
inline void read_block(const Frame& f, BlockPlace p, const void* image, R (*values)[kBlockPixels]) {
  const R* const from = static_cast<const R*>(image);
  R pixels[channels * kBlockPixels];
  if (is_whole(p)) {
    for_rows(f, p, [&](int64_t at, int lane) { std::copy_n(from + channels * at, channels * kBlockWidth, pixels + channels * lane); });
  } else {
    std::fill_n(pixels, channels * kBlockPixels, R(0));
    for_rows(f, p, [&](int64_t at, int lane) { std::copy_n(from + channels * at, channels * p.columns, pixels + channels * lane); });
  }
  for (int h = 0; h < kVectorsPerBlock; ++h) {
    V columns[channels];
    columns_of<channels>(pixels + channels * h * W, columns);
    for (int c = 0; c < channels; ++c) store(values[c] + h * W, columns[c]);
  }
}

// Writes a block of an image; value(state of W lanes, channel) returns W values. The image may have another type T.
template <int channels, class T, class F>
inline void write_block(const Frame& f, BlockPlace p, const R* block, T* image, F&& value) {
  R pixels[channels * kBlockPixels];
  for (int h = 0; h < kVectorsPerBlock; ++h) {
    V columns[channels];
    for (int c = 0; c < channels; ++c) columns[c] = value(block + h * W, c);
    interleave<channels>(columns, pixels + channels * h * W);
  }
  const int columns = is_whole(p) ? kBlockWidth : p.columns;  // known, for most blocks, when compiling
  for_rows(f, p, [&](int64_t at, int lane) { std::copy_n(pixels + channels * lane, channels * columns, image + channels * at); });
}

// Prefetches the rows of an image (H, W, channels) inside a tile. They are many short rows, which the hardware does not predict. write:
// they will be written. Always inline, as fetch is (cull-inl.h).
template <bool write>
[[gnu::always_inline]] inline void fetch_image(const Frame& f, int64_t tile, const void* image, int channels) {
  if (!image) return;
  const TileOrigin o = f.tile_origin(tile);
  const int left = o.x * kTile, columns = std::min(kTile, f.width - left), values = channels * columns;
  for (int y = o.y * kTile; y < std::min((o.y + 1) * kTile, f.height); ++y) {
    const R* const row = static_cast<const R*>(image) + (static_cast<int64_t>(y) * f.width + left) * channels;
    for (int k = 0; k < values; k += 64 / sizeof(R)) __builtin_prefetch(row + k, write);
    __builtin_prefetch(row + values - 1, write);
  }
}

void write_tile(const Frame& f, int64_t tile, const svrgs_images& out) {
  const R* const state = tile_state(f, tile);
  fetch_image<true>(f, tile, out.rgb, 3);
  fetch_image<true>(f, tile, out.mask, 1);
  for_blocks(f, tile, [&](int b, BlockPlace p) {
    const R* const block = block_state(const_cast<R*>(state), b, 0);
    const auto write = [&](auto* image, auto&& value) { write_block<1>(f, p, block, image, [&](const R* s, int) { return value(s); }); };
    const auto real = [](void* image) { return static_cast<R*>(image); };
    if (out.rgb)
      write_block<3>(f, p, block, real(out.rgb),
                     [&](const R* s, int c) { return fma(kept(s, kFinalT), broadcast(static_cast<R>(f.background[c])), kept(s, Field(kRed + c))); });
    if (out.depth) write(real(out.depth), [](const R* s) { return kept(s, kDepth); });
    if (out.alpha) write(real(out.alpha), [](const R* s) { return broadcast(1) - kept(s, kFinalT); });
    if (out.mask) write(real(out.mask), [&](const R* s) { return spatial_mask(f, s); });
    if (out.transmittance) write(real(out.transmittance), [](const R* s) { return kept(s, kFullT); });
    const auto count = [&](const R* s, Field k) { return f.mask_kind == SVRGS_MASK_NONE ? broadcast(0) : kept(s, k); };
    if (out.hits) write(out.hits, [&](const R* s) { return count(s, kCount); });
    if (out.kept) write(out.kept, [&](const R* s) { return count(s, kCount) - count(s, kDropped); });
  });
}

// From a tile's kept state to output images, and from image gradients to per-lane gradients.

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

// Kept state of one pixel; step kBlockPixels between fields.
inline R spatial_mask(const Frame& f, const R* pixel) {
  const R n = pixel[kCount * kBlockPixels], kept = n - pixel[kDropped * kBlockPixels];
  if (f.mask_kind == kMaskNone || n == 0) return 0;
  if (f.mask_kind == kMaskA) return pixel[kSum1 * kBlockPixels] / pixel[kSum0 * kBlockPixels];
  if (f.mask_kind == kMaskB) return pixel[kSum0 * kBlockPixels] * inverse_log(n);
  return (kept - 1 + pixel[kFullT * kBlockPixels]) * inverse_log(n);  // design.md closed form of paper Eq. 5
}

struct ImagePointers {
  R *rgb, *depth, *alpha, *mask, *transmittance;
  int32_t *hits, *kept;
};

inline void write_pixel(const Frame& f, const ImagePointers& out, int64_t at, const R* pixel) {
  const auto field = [&](Field k) { return pixel[k * kBlockPixels]; };
  if (out.rgb)
    for (int c = 0; c < 3; ++c) out.rgb[3 * at + c] = field(Field(kRed + c)) + field(kFinalT) * static_cast<R>(f.background[c]);
  if (out.depth) out.depth[at] = field(kDepth);
  if (out.alpha) out.alpha[at] = 1 - field(kFinalT);
  if (out.mask) out.mask[at] = spatial_mask(f, pixel);
  if (out.transmittance) out.transmittance[at] = field(kFullT);
  if (out.hits) out.hits[at] = static_cast<int32_t>(field(kCount));
  if (out.kept) out.kept[at] = static_cast<int32_t>(field(kCount) - field(kDropped));
}

// Calls visit(image index, block, lane) for every pixel of the tile inside the image.
template <class F>
inline void for_pixels(const Frame& f, int64_t tile, F&& visit) {
  const TileOrigin o = tile_origin(f, tile);
  const int height = std::min(kTile, f.height - o.y * kTile), width = std::min(kTile, f.width - o.x * kTile);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      visit(static_cast<int64_t>(o.y * kTile + y) * f.width + o.x * kTile + x, y / kBlock * kBlock + x / kBlock,
            y % kBlock * kBlock + x % kBlock);
}

void write_tile(const Frame& f, int64_t tile, const svrgs_images& images) {
  const ImagePointers out = {static_cast<R*>(images.rgb), static_cast<R*>(images.depth), static_cast<R*>(images.alpha),
                             static_cast<R*>(images.mask), static_cast<R*>(images.transmittance), images.hits, images.kept};
  const R* state = tile_state(f, tile);
  for_pixels(f, tile, [&](int64_t at, int block, int lane) {
    write_pixel(f, out, at, state + block * kFields * kBlockPixels + lane);
  });
}

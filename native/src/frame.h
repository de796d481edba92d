// The data of one view, shared by all stages: plain pointers into the context's buffers. Arrays of void have the level's real type.
#pragma once
#include <cstdint>

#include "constants.h"
#include "svrgs.h"

namespace svrgs {

// A projected Gaussian without its centre. alpha(dx, dy) = min(0.99, 2^(log2_opacity - u^2 - v^2)), u = l11 dx + l12 dy, v = l22 dy:
// the Cholesky factor of the conic, scaled by sqrt(log2(e) / 2), keeps the exponent <= 0 and free of cancellation.
template <class R>
struct GaussianShape {
  R l11, l12, l22, log2_opacity;
  R rgb[3], depth;
  R inv_l11, y_extreme;  // 1 / l11; dy of the rightmost point of the 1/255 ellipse (kernels/ellipse-inl.h)
  R mask;                // 0 or 1
  R slope;               // -l12 / l11
};

template <class R>
struct alignas(16 * sizeof(R)) ProjectedGaussian {
  double x, y;  // centre, pixels; double so that offsets from it are exact to float rounding
  GaussianShape<R> shape;
};

struct Span {  // tiles [begin, end) of one tile row
  uint16_t begin, end;
};

struct TileRect {      // tiles around a visible Gaussian
  uint16_t row, rows;  // of tiles; these and the columns are written as two words (kernels/project-inl.h)
  Span columns;        // of all its rows together
};

// How many entries of Frame::spans a Gaussian needs. A Gaussian in one row of tiles needs none: its columns are its only span.
inline int64_t span_rows(const TileRect& t) { return t.rows > 1 ? t.rows : 0; }

struct GaussianTiles {  // where the tiles it touches are
  uint32_t span;        // first of its rows in Frame::spans, if it has several
  uint32_t slot;        // first of its (Gaussian, tile) slots
  uint32_t tiles;       // how many
};

struct TileEntry {
  uint32_t place, slot;
};

struct PixelWindow {  // pixels [left, right) of the lines [top, bottom)
  int left, top, right, bottom;
};

struct TileOrigin {
  int x, y;  // tile coordinates
};

// Per-pixel results stored for the backward pass; axes: tile, block, field, 16 lanes.
enum Field { kRed, kGreen, kBlue, kDepth, kFinalT, kFullT, kCount, kDropped, kSum0, kSum1, kSum2, kSum3, kFields };

constexpr int64_t kTileState = kBlocks * kFields * kBlockPixels;  // reals of a tile

constexpr int kScoreValues = 4;  // reals per (Gaussian, tile) slot of the scores
constexpr int kSlotWidth = 12;   // reals per (Gaussian, tile) slot of the backward pass
// Sums over pixels: of g = alpha dL/dalpha and its moments in u, v (bounded within the ellipse, however thin it is), of
// dL/dcolour, of dL/dM from the colours, of dL/d(view depth), of dL/dM from F.
enum Slot { kG, kGu, kGv, kGuu, kGuv, kGvv, kSlotRed, kSlotGreen, kSlotBlue, kSlotMask, kSlotDepth, kSlotSpatial };

struct Frame {
  // Tiles are numbered bin after bin, and row after row within one: tiles that follow each other show the same Gaussians. Bins at the borders may have
  // tiles outside the image, which are empty.
  int64_t bin_count() const { return static_cast<int64_t>(bins_x) * bins_y; }
  int bin_tiles() const { return bin_side * bin_side; }
  int64_t tile_count() const { return bin_count() * bin_tiles(); }
  TileOrigin tile_origin(int64_t tile) const {
    const int number = static_cast<int>(tile), bin = number / kBinTiles, in_bin = number % kBinTiles;
    if (bin_side == 1) return {number % bins_x, number / bins_x};
    return {bin % bins_x * kBin + in_bin % kBin, bin / bins_x * kBin + in_bin / kBin};
  }
  bool in_image(TileOrigin o) const { return o.x * kTile < width && o.y * kTile < height; }

  // scene
  int64_t count;
  int sh_coefficients, sh_degree;
  const void *means, *log_scales, *quats, *opacity_logits, *sh;
  const uint8_t* masks;
  // camera
  double viewmat[16], position[3];
  double fx, fy, cx, cy, near_depth;
  bool orthographic;
  int width, height;
  double background[3];
  // options
  bool antialiased, full, want_depth, picture_only;
  int mask_kind, disabled_skips;
  double eps_a, stop;
  const void* depth_limit;  // R[height][width], optional
  const uint8_t* valid;     // [height][width], optional: 0 where a pixel shows nothing
  PixelWindow window;       // the smallest that holds all pixels that show something; what does not reach it is skipped
  // projection
  void* gaussians;       // ProjectedGaussian<R>[count]; a visible Gaussian's index in this array is its place
  TileRect* rects;       // [count], likewise
  GaussianTiles* tiles;  // [count], likewise
  Span* spans;
  const uint32_t* visible;  // [visible_count] ids, ascending
  const uint32_t* places;   // [visible_count]
  int64_t visible_count;
  // tile lists
  int bin_side, bins_x, bins_y;  // tiles per side of a bin: kBin or 1; bins
  const int64_t* tile_begin;     // [tiles + 1]
  const TileEntry* entries;
  BlockMask* hits;  // per slot: bit b set where the Gaussian hits a pixel of block b that counts; NULL if picture_only
  void* state;      // R[tiles][kBlocks][kFields][kBlockPixels]; of one tile if picture_only
};

}  // namespace svrgs

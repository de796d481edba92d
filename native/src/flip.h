// FLIP of two images (Andersson et al. 2020, doi 10.1145/3406183): its filters and its tiles. Sections, equations and tables are those of the paper.
// Independent of the number of threads.
#pragma once
#include <cstdint>

namespace svrgs {

struct Kernels;

// Separable filters in the order in which a kernel uses them: contrast sensitivity of Y, Cx and Cz (two Gaussians), then a Gaussian and its
// first and second derivative for features. The first derivative is odd, the others are even.
enum FlipFilter { kFlipY, kFlipCx, kFlipCz, kFlipCzNarrow, kFlipSmooth, kFlipEdge, kFlipPoint, kFlipFilters };

constexpr int kFlipRadius = 64;              // largest radius of a filter, pixels
constexpr double kMaxPixelsPerDegree = 400;  // its filters have smaller radii
constexpr int kFlipTileRows = 32, kFlipTileColumns = 128;

struct FlipTaps {
  int radius;
  double tap[kFlipRadius + 1];  // by distance from the centre
};

struct FlipArguments {
  const void *image, *target;  // (height, width, 3), of the kernels' real type
  void* errors;                // (height, width)
  int64_t height, width, tiles_across;
  int64_t margin;  // pixels around a tile that the filters need
  FlipTaps filters[kFlipFilters];
  double cz_share[2];  // of the two Gaussians of Cz

  int64_t stride() const { return kFlipTileColumns + (2 * margin + 15) / 16 * 16; }                                     // values in a row of a tile
  int64_t scratch() const { return stride() * (3 * (kFlipTileRows + 2 * margin) + 2 * kFlipFilters * kFlipTileRows); }  // reals a thread needs
};

void flip(const Kernels&, const void* image, const void* target, int64_t height, int64_t width, double pixels_per_degree, void* errors);  // svrgs_flip

}  // namespace svrgs

// Gaussians as decimation sees them, and the kernels that merge two of them (kernels/merge-inl.h).
#pragma once
#include <cstddef>
#include <cstdint>

namespace svrgs {

// Lengths are in units of about a pixel, so that products of variances stay within float.
struct alignas(64) MergeRow {
  float mean[3], cov[6];  // xx, xy, xz, yy, yz, zz
  float amplitude;        // opacity times transmittance: what a picture shows of it
  float transmittance;    // mean T of the pixels in which it is blended
  float blur;             // added to both variances on the screen
  float area;             // 2 pi times the root of the determinant on the screen, mean of three views
  float colour[3];        // mean colour less the mean colour behind it
  float density;          // pixels of all views per unit of area
  float contribution;     // sum of alpha T
  float sh_square;        // mean over all directions of the square of the colour's view-dependent part
  float error;            // squared error of the merges it came from
  float removal;          // growth of the squared error of the pictures without it
  uint32_t row;           // of the scene, or count + merge
};
static_assert(sizeof(MergeRow) == 128 && offsetof(MergeRow, density) == 64);

struct MergeScene {
  const MergeRow* rows;
  int64_t count;  // Gaussians of the scene
  int sh_coefficients;
  const float *sh, *merged_sh;  // rows of the scene, and of merges
  const float* sh_row(uint32_t row) const {
    const int64_t width = 3 * sh_coefficients;
    return row < count ? sh + row * width : merged_sh + (row - count) * width;
  }
};

constexpr double kErrorShare = 0.3;     // of the error that both have already, in the cost of merging them
constexpr float kShMean = 0.07957747f;  // 1 / 4 pi: mean over all directions of the square of an SH basis function

}  // namespace svrgs

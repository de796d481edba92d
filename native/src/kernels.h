// The kernels of one SIMD level, as a table. Every entry is typed by the level's real type behind void*.
#pragma once
#include "flip.h"
#include "frame.h"
#include "merge.h"
#include "svrgs.h"

namespace svrgs {

struct ProjectionCounts {  // what became of a range of Gaussians: how many are visible, their entries of Frame::spans and their (Gaussian, tile) pairs
  int64_t visible = 0, rows = 0, pairs = 0;
};

struct Scores {  // each (N,) and optional
  double* sum;
  float* max;
  int64_t* hits;
  double* transmittance;
  uint8_t* reached;
  bool sums() const { return sum || max || hits || transmittance; }
};

struct Kernels {
  int real_size, gaussian_size;
  ProjectionCounts (*project_range)(const Frame&, int64_t begin, int64_t end, uint32_t* ids, uint32_t* depth_keys);
  int64_t (*fill_spans)(const Frame&, int64_t begin, int64_t end, Span* spans);  // of the places [begin, end); returns how many tiles they touch
  void (*forward_tile)(const Frame&, int64_t tile);
  void (*write_tile)(const Frame&, int64_t tile, const svrgs_images&);
  void (*backward_tile)(const Frame&, const svrgs_image_grads&, const svrgs_grads&, const svrgs_update*, int64_t tile, void* slots);
  int64_t (*gradients_range)(const Frame&, const svrgs_image_grads&, const svrgs_grads&, const svrgs_update*, const void* slots, int64_t begin, int64_t end);
  void (*scores_tile)(const Frame&, int64_t tile, bool known, void* slots);
  void (*scores_range)(const Frame&, const void* slots, int64_t begin, int64_t end, const Scores&);
  void (*moments_tile)(const Frame&, int64_t tile, void* slots);
  void (*moments_range)(const Frame&, const void* slots, int64_t begin, int64_t end, double* rows);
  void (*removal_tile)(const Frame&, int64_t tile, const void* residuals, void* slots);
  void (*slopes_tile)(const Frame&, int64_t tile, void* slots);
  void (*dominance_tile)(const Frame&, int64_t tile, void* slots);
  void (*sums_range)(const Frame&, const void* slots, int64_t begin, int64_t end, double* out);
  void (*visibility_tile)(const Frame&, int64_t tile, void* slots);
  void (*visibility_range)(const Frame&, const void* slots, int64_t begin, int64_t end, double* sums);
  void (*merge_areas)(MergeRow* rows, int64_t begin, int64_t end);
  void (*merge_costs)(const MergeScene&, const uint32_t* a, const uint32_t* b, int64_t count, float* costs);
  void (*merge_rows)(const MergeScene&, const uint32_t* a, const uint32_t* b, int64_t count, MergeRow* out);
  void (*count_tile)(const Frame&, int64_t tile, svrgs_work&);
  int64_t loss_scratch;  // reals a thread needs
  void (*loss_tile)(const struct LossArguments&, int64_t tile, void* scratch);
  double (*mask_loss_range)(const void* mask, double scale, int64_t begin, int64_t end, void* grad);  // sum of F^2; grad = scale F
  void (*flip_tile)(const FlipArguments&, int64_t tile, void* scratch);
  void (*convolve_row)(const struct ConvolveArguments&, int64_t y, int64_t panel);
  void (*linear_range)(const struct LinearArguments&, int64_t begin, int64_t end);
  void (*expose_range)(const struct ExposureArguments&, int64_t begin, int64_t end);
  void (*expose_vjp_range)(const struct ExposureArguments&, int64_t begin, int64_t end, double d_matrix[12]);
  int64_t (*adam_rows)(const svrgs_adam_settings&, void* param, void* moments, const void* grad, const uint32_t* ids, int64_t begin, int64_t end, int width);
  double (*multiply_adds)(int64_t rounds);  // operations done
};

// Tiles of the loss have at most this many rows and values. They are large compared with the margin that each tile also computes, small
// enough to occupy many threads, and a block of their rows fits into a core's cache.
constexpr int kLossTileRows = 90, kLossTileValues = 480;

struct LossArguments {
  const void *image, *target;
  int64_t height, row;  // values per row
  int64_t tile_row, tiles_across;
  double l1_scale, ssim_scale;  // dL/d of each value's |difference|; of each value's SSIM
  void* grad;                   // optional
  double *tile_l1, *tile_ssim;
};

constexpr int kConvolvePanel = SVRGS_CONVOLVE_PANEL;

struct ConvolveArguments {  // of svrgs_convolve
  const void *image, *filters, *bias;
  int64_t height, width, inputs, outputs;
  void* out;
};

struct LinearArguments {  // of svrgs_linear_rgba
  const void *rgb, *alpha;
  const double* working_space;
  void* rgba;
};

struct ExposureArguments {  // of svrgs_expose and svrgs_expose_vjp
  const void *rgb, *d_seen;
  const uint8_t* valid;  // optional
  const double* matrix;
  void* out;  // seen, or d_rgb
};

extern const Kernels scalar_kernels, baseline_kernels, avx2_kernels, avx512_kernels, neon_kernels, double_kernels;

}  // namespace svrgs

// The kernels of one SIMD level, as a table. Every entry is typed by the level's real type behind void*.
#pragma once
#include "frame.h"
#include "svrgs.h"

namespace svrgs {

struct Kernels {
  int real_size, splat_size;
  int64_t (*project_range)(const Frame&, int64_t begin, int64_t end, uint32_t* ids, uint32_t* depth_keys);
  uint32_t (*fill_spans)(const Frame&, uint32_t place, Span* spans);  // of several tile rows
  void (*forward_tile)(const Frame&, int64_t tile);
  void (*write_tile)(const Frame&, int64_t tile, const svrgs_images&);
  void (*backward_tile)(const Frame&, const svrgs_image_grads&, const svrgs_grads&, const svrgs_update*, int64_t tile, void* slots);
  int64_t (*gradients_range)(const Frame&, const svrgs_image_grads&, const svrgs_grads&, const svrgs_update*, const void* slots,
                             int64_t begin, int64_t end);
  void (*scores_tile)(const Frame&, int64_t tile, void* slots);
  void (*scores_range)(const Frame&, const void* slots, int64_t begin, int64_t end, double* sum, float* max, int64_t* hits);
  void (*count_tile)(const Frame&, int64_t tile, svrgs_work&);
  int64_t (*loss_scratch)(int width);  // reals of scratch one row needs
  void (*loss_row)(const struct LossArguments&, int y, void* scratch, bool second_pass);
  int64_t (*adam_rows)(const svrgs_adam_settings&, void* param, void* m, void* v, const void* grad, const uint32_t* ids,
                       int64_t begin, int64_t end, int width);
  double (*multiply_adds)(int64_t rounds);  // operations done
};

struct LossArguments {
  const void *image, *target;
  int height, width;
  double l1_scale, ssim_scale;  // dL/d of each value's |difference|; of each value's SSIM
  void* maps;                   // reals [3][H * W * 3]
  void* grad;                   // optional
  double *row_l1, *row_ssim;
};

extern const Kernels scalar_kernels, baseline_kernels, avx2_kernels, avx512_kernels, double_kernels;

}  // namespace svrgs

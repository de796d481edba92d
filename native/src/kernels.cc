// Compiled once per SIMD level (native/CMakeLists.txt). SVRGS_LEVEL and SVRGS_TABLE_NAME name the level, SVRGS_LANES and SVRGS_REAL define its
// vectors, SVRGS_HAVE_AVX2, SVRGS_HAVE_AVX512 and SVRGS_HAVE_NEON its instructions. All kernels are in the level's own namespace. Do not use standard
// containers here: the linker could take a copy of their code that was compiled for another level.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <type_traits>
#include <utility>
#if defined(SVRGS_HAVE_AVX2)
#include <immintrin.h>
#elif defined(SVRGS_HAVE_NEON)
#include <arm_neon.h>
#endif

#include "kernels.h"
#include "processor.h"

namespace svrgs::SVRGS_LEVEL {
#include "kernels/lanes-inl.h"
#include "kernels/math-inl.h"
#include "kernels/transpose-inl.h"
#include "kernels/compact-inl.h"
#include "kernels/camera-inl.h"
#include "kernels/gaussian-inl.h"
#include "kernels/gaussian_vjp-inl.h"
#include "kernels/sh-inl.h"
#include "kernels/ellipse-inl.h"
#include "kernels/cull-inl.h"
#include "kernels/sh_colour-inl.h"
#include "kernels/project-inl.h"
#include "kernels/tile_spans-inl.h"
#include "kernels/evaluate-inl.h"
#include "kernels/block_lists-inl.h"
#include "kernels/raster_forward-inl.h"
#include "kernels/images-inl.h"
#include "kernels/raster_backward-inl.h"
#include "kernels/statistics-inl.h"
#include "kernels/work-inl.h"
#include "kernels/merge-inl.h"
#include "kernels/adam-inl.h"
#include "kernels/adam_sh-inl.h"
#include "kernels/gradients-inl.h"
#include "kernels/loss-inl.h"
#include "kernels/srgb-inl.h"
#include "kernels/exposure-inl.h"
#include "kernels/flip-inl.h"
#include "kernels/convolve-inl.h"
#include "kernels/multiply_adds-inl.h"

void loss_pass(const LossArguments& a, int64_t tile, void* scratch) {
  const int64_t y = tile / a.tiles_across * kLossTileRows, i = tile % a.tiles_across * a.tile_row;
  LossTile t = {};
  t.image = {static_cast<const R*>(a.image), a.height, a.row};
  t.target = {static_cast<const R*>(a.target), a.height, a.row};
  t.grad = static_cast<R*>(a.grad);
  t.y0 = y, t.y1 = std::min(y + kLossTileRows, a.height);
  t.i0 = i, t.i1 = std::min(i + a.tile_row, a.row);
  t.l1_scale = static_cast<R>(a.l1_scale), t.ssim_scale = static_cast<R>(a.ssim_scale);
  loss_tile(t, static_cast<R*>(scratch));
  a.tile_l1[tile] = t.l1, a.tile_ssim[tile] = t.ssim;
}

int64_t adam_pass(const svrgs_adam_settings& a, void* param, void* moments, const void* grad, const uint32_t* ids, int64_t begin, int64_t end, int width) {
  const AdamRates rates = adam_rates(a, a.lr, width);
  const R* const rows = static_cast<const R*>(grad);
  if (a.shared) {
    ShTensors t = {static_cast<R*>(param), static_cast<R*>(moments)};
    if (!ids) t = {t.param + begin * width, t.moments + begin * sh_moments(width)};
    return adam_sh_rows(rates, t, ids ? ids + begin : nullptr, end - begin, rows + begin * width, end - begin, end - begin, width);
  }
  const AdamTensors t = {static_cast<R*>(param), static_cast<Packed*>(moments)};
  const OwnedRows own = ids ? OwnedRows{ids[begin], ids[end - 1]} : OwnedRows{};
  return adam_rows(rates, t, rows, ids, begin, end, width, own);
}
}  // namespace svrgs::SVRGS_LEVEL

namespace svrgs {
namespace level = SVRGS_LEVEL;
const Kernels SVRGS_TABLE_NAME = {
    .real_size = sizeof(level::R),
    .gaussian_size = sizeof(ProjectedGaussian<level::R>),
    .project_range = level::project_range,
    .fill_spans = level::fill_spans,
    .forward_tile = level::forward_tile,
    .write_tile = level::write_tile,
    .backward_tile = level::backward_tile,
    .gradients_range = level::gradients_range,
    .scores_tile = level::scores_tile,
    .scores_range = level::scores_range,
    .moments_tile = level::moments_tile,
    .moments_range = level::moments_range,
    .removal_tile = level::removal_tile,
    .slopes_tile = level::slopes_tile,
    .dominance_tile = level::dominance_tile,
    .sums_range = level::sums_range,
    .visibility_tile = level::visibility_tile,
    .visibility_range = level::visibility_range,
    .merge_areas = level::merge_areas,
    .merge_costs = level::merge_costs,
    .merge_rows = level::merge_rows,
    .count_tile = level::count_tile,
    .loss_scratch = level::kLossScratch,
    .loss_tile = level::loss_pass,
    .mask_loss_range = level::mask_loss_range,
    .flip_tile = level::flip_tile,
    .convolve_row = level::convolve_row,
    .linear_range = level::linear_range,
    .expose_range = level::expose_range,
    .expose_vjp_range = level::expose_vjp_range,
    .adam_rows = level::adam_pass,
    .multiply_adds = level::multiply_adds,
};
}  // namespace svrgs

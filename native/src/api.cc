// The C interface: checks every argument, then hands over. No exception leaves this file.
#include <algorithm>
#include <atomic>
#include <iterator>
#include <new>

#include "context.h"
#include "decimate.h"
#include "depth_sort.h"
#include "flip.h"
#include "machine_speed.h"
#include "panorama.h"
#include "pool.h"
#include "processor.h"
#include "sample_masks.h"
#include "triangles.h"

struct svrgs_context {
  svrgs::Context context;
};

namespace {

using svrgs::Failure;

thread_local std::string last_error;

constexpr int64_t kMaxCount = 1LL << 31;  // Gaussians; ids are 32 bits
constexpr int64_t kPixelGrain = 4096;
constexpr int kMaxChannels = 4096;

void require(bool ok, const char* sentence) {
  if (!ok) throw Failure{SVRGS_INVALID, sentence};
}

template <class F>
int32_t guarded(F&& f) {
  try {
    f();
    return SVRGS_OK;
  } catch (const Failure& e) {
    last_error = e.sentence;
    return e.status;
  } catch (const std::bad_alloc&) {
    last_error = "out of memory";
    return SVRGS_NO_MEMORY;
  } catch (const std::exception& e) {
    last_error = e.what();
    return SVRGS_INVALID;
  }
}

// The kernels of a level; NULL if this build or processor does not have it.
const svrgs::Kernels* kernels_of(int32_t level) {
  switch (level) {
    case SVRGS_SCALAR: return &svrgs::scalar_kernels;
    case SVRGS_DOUBLE: return &svrgs::double_kernels;
#if defined(__aarch64__)
    case SVRGS_NEON: return &svrgs::neon_kernels;
#else
    case SVRGS_BASELINE: return &svrgs::baseline_kernels;
#endif
#if defined(SVRGS_WITH_AVX)
    case SVRGS_AVX2: return svrgs::has_avx2() ? &svrgs::avx2_kernels : nullptr;
    case SVRGS_AVX512: return svrgs::has_avx512() ? &svrgs::avx512_kernels : nullptr;
#endif
    default: return nullptr;
  }
}

const svrgs::Kernels& kernels(int32_t level) {
  const svrgs::Kernels* found = kernels_of(level);
  require(found, "this processor or build does not have the requested SIMD level");
  return *found;
}

void check(const svrgs_scene& s) {
  require(s.count >= 0 && s.count < kMaxCount, "the scene's count must be between 0 and 2^31 - 1");
  const int k = s.sh_coefficients;
  require(k == 1 || k == 4 || k == 9 || k == 16, "sh_coefficients must be 1, 4, 9 or 16");
  require(s.count == 0 || (s.means && s.log_scales && s.quats && s.opacity_logits && s.sh), "a scene array is missing");
}

void check(const svrgs_camera& c) {
  require(c.width > 0 && c.height > 0 && c.width <= svrgs::kMaxSide && c.height <= svrgs::kMaxSide, "image sides must be 1 to 32768 pixels");
  bool finite = std::isfinite(c.cx) && std::isfinite(c.cy);
  for (const double v : c.viewmat) finite = finite && std::isfinite(v);
  for (const double v : c.background) finite = finite && std::isfinite(v);
  require(finite, "the camera has a value that is not finite");
  require(c.fx > 0 && c.fy > 0 && c.fx < 1e9 && c.fy < 1e9, "focal lengths must be above 0 and below 1e9 pixels");
  require(c.orthographic == 0 || c.orthographic == 1, "orthographic must be 0 or 1");
  require(c.near_depth >= 0 && c.near_depth < svrgs::kFar, "near_depth must be 0 to 1e15");
}

void check(const svrgs_options& o, const svrgs_scene& s) {
  require(o.sh_degree >= 0 && o.sh_degree <= 3 && (o.sh_degree + 1) * (o.sh_degree + 1) <= s.sh_coefficients, "sh_degree is not stored in the scene");
  require(o.mask_kind >= 0 && o.mask_kind < SVRGS_MASK_KINDS, "mask_kind is unknown");
  require(o.mask_kind != SVRGS_MASK_A || o.eps_a > 0, "eps_a must be positive");
  require(o.stop >= 0 && o.stop <= 1, "stop must be between 0 and 1");
  require(o.stop <= svrgs::kStop || o.mask_kind == SVRGS_MASK_NONE, "stop needs mask_kind none");
}

void check(const svrgs_triangles& t) {
  require(t.count >= 0 && t.count < kMaxCount, "there are too many triangles");
  require(t.count == 0 || (t.corners && t.colors && t.light && t.holdout), "an array of triangles is missing");
  require(!t.textures || t.uvs, "textured triangles need texture coordinates");
  require(t.texture_count >= 0 && (t.texture_count == 0 || t.texture), "an array of textures is missing");
  for (int32_t k = 0; k < t.texture_count; ++k) {
    const svrgs_texture& texture = t.texture[k];
    require(texture.texels && texture.width > 0 && texture.height > 0 && texture.width <= svrgs::kMaxSide && texture.height <= svrgs::kMaxSide,
            "sides of textures must be 1 to 32768 texels");
  }
  for (int64_t i = 0; t.textures && i < t.count; ++i)
    require(t.textures[i] >= -1 && t.textures[i] < t.texture_count, "a triangle has a texture that is missing");
}

// For functions that walk a view's lists again: they do not apply depth limits.
void check_whole(const svrgs::Context& context) { require(!context.holds_limit(), "a view with a depth limit has no gradients and no statistics"); }

void check_view(const svrgs::Context& context, const svrgs_image_grads& in) {
  require(context.holds_view(), "there is no rendered view to differentiate: call svrgs_forward first");
  check_whole(context);
  require(!in.depth || context.holds_depth(), "a gradient of the depth image needs a forward pass that made one");
}

// In the order of the enums' values.
constexpr const char* kLevelNames[] = {"scalar", "baseline", "avx2", "avx512", "float64", "neon"};
constexpr const char* kMaskKindNames[] = {"none", "svr", "self", "a", "b", "even"};
constexpr const char* kSkipNames[] = {"exact_tiles", "block_tests", "opacity_bounds", "termination"};
constexpr const char* kStageNames[] = {"project", "tiles", "sort", "blend", "raster_grads", "parameter_grads", "loss", "adam"};
static_assert(std::size(kLevelNames) == SVRGS_LEVELS && std::size(kMaskKindNames) == SVRGS_MASK_KINDS);
static_assert((1 << std::size(kSkipNames)) - 1 == SVRGS_ALL_SKIPS && std::size(kStageNames) == SVRGS_STAGES);

template <size_t count>
const char* name_of(const char* const (&names)[count], int32_t index) {
  return index >= 0 && static_cast<size_t>(index) < count ? names[index] : nullptr;
}

}  // namespace

extern "C" {

int32_t svrgs_interface_version(void) { return SVRGS_INTERFACE_VERSION; }
const char* svrgs_last_error(void) { return last_error.c_str(); }

const char* svrgs_name(int32_t names, int32_t index) {
  switch (names) {
    case SVRGS_LEVEL_NAMES: return name_of(kLevelNames, index);
    case SVRGS_MASK_KIND_NAMES: return name_of(kMaskKindNames, index);
    case SVRGS_SKIP_NAMES: return name_of(kSkipNames, index);
    case SVRGS_STAGE_NAMES: return name_of(kStageNames, index);
    default: return nullptr;
  }
}

void svrgs_get_thresholds(svrgs_thresholds* out) {
  using namespace svrgs;
  if (out) *out = {kNear, kFar, kBlur, kFrustumMargin, kAlphaCut, kAlphaMax, kStop, kCompensationFloor, kTile, kBlockWidth, kBlockHeight};
}

int32_t svrgs_level_supported(int32_t level) { return kernels_of(level) != nullptr; }
void svrgs_set_threads(int32_t threads) { svrgs::set_threads(std::max(threads, 0)); }
int32_t svrgs_threads(void) { return svrgs::threads(); }
void svrgs_trace(int32_t on) { svrgs::trace(on != 0); }

void svrgs_traced(const double** seconds, int64_t* count) {
  *seconds = svrgs::traced().data();
  *count = static_cast<int64_t>(svrgs::traced().size());
}

int32_t svrgs_best_level(void) {
  for (const int32_t level : {SVRGS_AVX512, SVRGS_AVX2, SVRGS_NEON})
    if (kernels_of(level)) return level;
  return SVRGS_BASELINE;
}

int32_t svrgs_context_create(int32_t level, svrgs_context** out) {
  return guarded([&] { *out = new svrgs_context{svrgs::Context(kernels(level))}; });
}

void svrgs_context_destroy(svrgs_context* context) { delete context; }

int32_t svrgs_forward(svrgs_context* c, const svrgs_scene* scene, const svrgs_camera* camera, const svrgs_options* options, const svrgs_images* images) {
  return guarded([&] {
    require(c && scene && camera && options && images, "an argument is missing");
    check(*scene);
    check(*camera);
    check(*options, *scene);
    c->context.forward(*scene, *camera, *options, *images);
  });
}

int32_t svrgs_visible(svrgs_context* c, const uint32_t** ids, int64_t* count) {
  return guarded([&] {
    require(c && ids && count, "an argument is missing");
    *ids = c->context.visible();
    *count = c->context.visible_count();
  });
}

int32_t svrgs_count_work(svrgs_context* c, int32_t count_pixels, svrgs_work* work) {
  return guarded([&] {
    require(c && work, "an argument is missing");
    require(!count_pixels || c->context.holds_view(), "there is no rendered view to count: call svrgs_forward first");
    if (count_pixels) check_whole(c->context);
    *work = c->context.work(count_pixels);
  });
}

int32_t svrgs_stage_seconds(svrgs_context* c, double seconds[SVRGS_STAGES]) {
  return guarded([&] {
    require(c && seconds, "an argument is missing");
    std::copy_n(c->context.stage_seconds(), SVRGS_STAGES, seconds);
  });
}

int32_t svrgs_measure_machine(int32_t level, svrgs_machine* out) {
  return guarded([&] {
    require(out, "an argument is missing");
    *out = svrgs::measure_machine(kernels(level));
  });
}

int32_t svrgs_backward(svrgs_context* c, const svrgs_image_grads* in, const svrgs_grads* out) {
  return guarded([&] {
    require(c && in && out, "an argument is missing");
    check_view(c->context, *in);
    c->context.backward(*in, *out, nullptr);
  });
}

int32_t svrgs_backward_update(svrgs_context* c, const svrgs_image_grads* in, const svrgs_update* update, const svrgs_grads* others, int64_t* nonfinite) {
  return guarded([&] {
    require(c && in && update && others && nonfinite, "an argument is missing");
    const auto check_trained = [](const svrgs_trained& t, const real* gradient) {
      require(!t.param || (t.moments && t.lr), "an array to update is missing");
      require(!t.param || !gradient, "gradients of what is updated are not kept");
    };
    require(update->sh.param, "an array to update is missing");
    check_trained(update->means, others->means);
    check_trained(update->log_scales, others->log_scales);
    check_trained(update->quats, others->quats);
    check_trained(update->opacity_logits, others->opacity_logits);
    check_trained(update->sh, others->sh);
    check_trained(update->masks, others->masks);
    require(!update->masks.param || update->slope, "the slopes of the masks are missing");
    check_view(c->context, *in);
    *nonfinite = c->context.backward(*in, *others, update);
  });
}

int32_t svrgs_scores(svrgs_context* c, const uint8_t* valid, double* sum, float* max, int64_t* hits, double* transmittance, uint8_t* reached) {
  return guarded([&] {
    require(c, "an argument is missing");
    require(c->context.holds_view(), "there is no rendered view to score: call svrgs_forward first");
    check_whole(c->context);
    require(!valid || !c->context.holds_valid(), "the view has been rendered with other pixels that count");
    c->context.scores(valid, {sum, max, hits, transmittance, reached});
  });
}

int32_t svrgs_moments(svrgs_context* c, double* moments) {
  return guarded([&] {
    require(c && moments, "an argument is missing");
    require(c->context.holds_view(), "there is no rendered view to take moments of: call svrgs_forward first");
    check_whole(c->context);
    c->context.moments(moments);
  });
}

int32_t svrgs_removal(svrgs_context* c, const real* residuals, double* cost) {
  return guarded([&] {
    require(c && residuals && cost, "an argument is missing");
    require(c->context.holds_view(), "there is no rendered view to score: call svrgs_forward first");
    check_whole(c->context);
    c->context.removal(residuals, cost);
  });
}

int32_t svrgs_visibility(svrgs_context* c, double* sums) {
  return guarded([&] {
    require(c && sums, "an argument is missing");
    require(c->context.holds_view(), "there is no rendered view to score: call svrgs_forward first");
    check_whole(c->context);
    c->context.visibility(sums);
  });
}

int32_t svrgs_slopes(svrgs_context* c, double* sums) {
  return guarded([&] {
    require(c && sums, "an argument is missing");
    require(c->context.holds_view(), "there is no rendered view to score: call svrgs_forward first");
    check_whole(c->context);
    c->context.slopes(sums);
  });
}

int32_t svrgs_dominance(svrgs_context* c, double* pixels) {
  return guarded([&] {
    require(c && pixels, "an argument is missing");
    require(c->context.holds_view(), "there is no rendered view to score: call svrgs_forward first");
    check_whole(c->context);
    c->context.dominance(pixels);
  });
}

int32_t svrgs_loss(svrgs_context* c, const real* image, const real* target, int32_t height, int32_t width, double l1_weight, double ssim_weight, real* grad,
                   double values[2]) {
  return guarded([&] {
    require(c && image && target && values, "an argument is missing");
    require(height > 0 && width > 0 && height <= svrgs::kMaxSide && width <= svrgs::kMaxSide, "image sides must be 1 to 32768 pixels");
    c->context.loss(image, target, height, width, l1_weight, ssim_weight, grad, values);
  });
}

int32_t svrgs_mask_loss(svrgs_context* c, const real* mask, int64_t count, double weight, real* grad, double* value) {
  return guarded([&] {
    require(c && mask && grad && value, "an argument is missing");
    require(count > 0, "there must be pixels");
    *value = c->context.mask_loss(mask, count, weight, grad);
  });
}

int32_t svrgs_flip(int32_t level, const real* image, const real* target, int32_t height, int32_t width, double pixels_per_degree, real* errors) {
  return guarded([&] {
    require(image && target && errors, "an argument is missing");
    require(height > 0 && width > 0 && height <= svrgs::kMaxSide && width <= svrgs::kMaxSide, "image sides must be 1 to 32768 pixels");
    require(pixels_per_degree >= 1 && pixels_per_degree <= svrgs::kMaxPixelsPerDegree, "there must be 1 to 400 pixels per degree");
    svrgs::flip(kernels(level), image, target, height, width, pixels_per_degree, errors);
  });
}

int32_t svrgs_convolve(int32_t level, const real* image, int32_t height, int32_t width, int32_t inputs, const real* filters, const real* bias, int32_t outputs,
                       real* out) {
  return guarded([&] {
    require(image && filters && bias && out, "an argument is missing");
    require(height > 0 && width > 0 && height <= svrgs::kMaxSide && width <= svrgs::kMaxSide, "image sides must be 1 to 32768 pixels");
    require(inputs > 0 && inputs <= kMaxChannels && outputs > 0 && outputs <= kMaxChannels, "there must be 1 to 4096 channels");
    require(outputs % svrgs::kConvolvePanel == 0, "output channels must be a multiple of 32");
    const svrgs::Kernels& of_level = kernels(level);
    const svrgs::ConvolveArguments a = {image, filters, bias, height, width, inputs, outputs, out};
    svrgs::parallel_for(int64_t{height} * (outputs / svrgs::kConvolvePanel), [&](int64_t task) { of_level.convolve_row(a, task % height, task / height); });
  });
}

int32_t svrgs_linear_rgba(int32_t level, const real* rgb, const real* alpha, int64_t pixels, const double working_space[9], real* rgba) {
  return guarded([&] {
    require(working_space && (pixels == 0 || (rgb && alpha && rgba)), "an argument is missing");
    require(pixels >= 0 && pixels <= int64_t{svrgs::kMaxSide} * svrgs::kMaxSide, "there are too many pixels");
    const svrgs::Kernels& of_level = kernels(level);
    const svrgs::LinearArguments a = {rgb, alpha, working_space, rgba};
    svrgs::parallel_blocks(pixels, kPixelGrain, [&](int64_t begin, int64_t end) { of_level.linear_range(a, begin, end); });
  });
}

int32_t svrgs_expose(int32_t level, const real* rgb, const uint8_t* valid, int64_t pixels, const double matrix[12], real* seen) {
  return guarded([&] {
    require(matrix && (pixels == 0 || (rgb && seen)), "an argument is missing");
    require(pixels >= 0 && pixels <= int64_t{svrgs::kMaxSide} * svrgs::kMaxSide, "there are too many pixels");
    const svrgs::Kernels& of_level = kernels(level);
    const svrgs::ExposureArguments a = {rgb, nullptr, valid, matrix, seen};
    svrgs::parallel_blocks(pixels, kPixelGrain, [&](int64_t begin, int64_t end) { of_level.expose_range(a, begin, end); });
  });
}

int32_t svrgs_expose_vjp(int32_t level, const real* d_seen, const real* rgb, const uint8_t* valid, int64_t pixels, const double matrix[12], real* d_rgb,
                         double d_matrix[12]) {
  return guarded([&] {
    require(matrix && d_matrix && (pixels == 0 || (d_seen && rgb && d_rgb)), "an argument is missing");
    require(pixels >= 0 && pixels <= int64_t{svrgs::kMaxSide} * svrgs::kMaxSide, "there are too many pixels");
    const svrgs::Kernels& of_level = kernels(level);
    const svrgs::ExposureArguments a = {rgb, d_seen, valid, matrix, d_rgb};
    std::vector<double> sums(12 * ((pixels + kPixelGrain - 1) / kPixelGrain));  // of each block, so that threads do not matter
    svrgs::parallel_blocks(pixels, kPixelGrain,
                           [&](int64_t begin, int64_t end) { of_level.expose_vjp_range(a, begin, end, sums.data() + begin / kPixelGrain * 12); });
    std::fill_n(d_matrix, 12, 0.0);
    for (size_t i = 0; i < sums.size(); ++i) d_matrix[i % 12] += sums[i];
  });
}

int32_t svrgs_adam(svrgs_context* c, const svrgs_adam_settings* settings, real* param, void* moments, const real* grad, const uint32_t* ids, int64_t rows,
                   int32_t width, int64_t* nonfinite) {
  return guarded([&] {
    require(c && settings && settings->lr && nonfinite && (rows == 0 || (param && moments && grad)), "an argument is missing");
    require(rows >= 0 && width > 0 && width <= 64, "rows must not be negative, width must be 1 to 64");
    require(!settings->shared || width == 3 || width == 12 || width == 27 || width == 48, "rows of SH coefficients have a width of 3, 12, 27 or 48");
    *nonfinite = c->context.adam(*settings, param, moments, grad, ids, rows, width);
  });
}

int32_t svrgs_sample_masks(const float* logits, int64_t count, uint64_t seed, uint64_t step, uint8_t* masks, float* slope) {
  return guarded([&] {
    require(count == 0 || (logits && masks && slope), "an argument is missing");
    svrgs::sample_masks(logits, count, seed, step, masks, slope);
  });
}

int32_t svrgs_decimate(int32_t level, const svrgs_decimation* scene, const int32_t* cancel, const svrgs_merges* out, int64_t* steps, int64_t* merges) {
  return guarded([&] {
    require(scene && out && steps && merges, "an argument is missing");
    check({scene->count, scene->sh_coefficients, scene->means, scene->log_scales, scene->quats, scene->opacity_logits, scene->sh, nullptr});
    require(scene->visibility, "an argument is missing");
    require(scene->count > 0 && scene->least > 0 && scene->least <= scene->count, "least must be 1 to count");
    require(2 * scene->count < kMaxCount, "the scene's count must be below 2^30");
    require(std::isfinite(scene->unit) && scene->unit > 0, "unit must be a finite length above 0");
    for (const double x : scene->middle) require(std::isfinite(x), "middle must be finite");
    require(out->a && out->b && out->costs && out->means && out->log_scales && out->quats && out->opacity_logits && out->sh, "an output is missing");
    if (!svrgs::decimate(kernels(level), *scene, cancel, *out, *steps, *merges)) throw Failure{SVRGS_CANCELLED, "cancelled"};
  });
}

int32_t svrgs_draw_triangles(const svrgs_triangles* triangles, const svrgs_camera* camera, const svrgs_layers* layers) {
  return guarded([&] {
    require(triangles && camera && layers && layers->share && layers->depth && layers->rgba, "an argument is missing");
    check(*triangles);
    check(*camera);
    svrgs::draw_triangles(*triangles, *camera, *layers);
  });
}

int32_t svrgs_add_view(const svrgs_view* view, const svrgs_panorama* panorama) {
  return guarded([&] {
    require(view && panorama && view->image && panorama->sums, "an argument is missing");
    require(panorama->latitudes && panorama->row_weights && panorama->longitudes && panorama->column_weights, "an argument is missing");
    for (const int32_t side : {view->width, view->height, panorama->width, panorama->height})
      require(side > 0 && side <= svrgs::kMaxSide, "image sides must be 1 to 32768 pixels");
    require(view->channels > 0 && view->channels <= 64, "a view must have 1 to 64 channels");
    svrgs::add_view(*view, *panorama);
  });
}

}  // extern "C"

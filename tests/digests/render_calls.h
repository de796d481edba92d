// What is called on one view of a scene, in both precisions.
#pragma once
#include <string>
#include <vector>

#include "digest.h"
#include "inputs.h"

namespace digests {

template <class T>
class View {
 public:
  View(Lines& to, const std::string& called, int32_t level, int32_t coefficients) : lines(to), name(called), scene(coefficients) {
    lines.require(svrgs_context_create(level, &context) == SVRGS_OK, name);
    options.sh_degree = coefficients == 16 ? 3 : coefficients == 9 ? 2 : coefficients == 4 ? 1 : 0;
    options.full = 1, options.mask_kind = SVRGS_MASK_SVR, options.eps_a = 0.0078125;
    for (auto* image : {&depth, &alpha, &mask, &left}) image->resize(kPixels);
    rgb.resize(3 * kPixels), hits.resize(kPixels), kept.resize(kPixels);
  }
  ~View() { svrgs_context_destroy(context); }
  View(const View&) = delete;

  static constexpr bool kDouble = sizeof(T) == 8;  // there exp2 and log2 are those of the C library
  Digest digest() const { return Digest(kDouble ? kMillionths : kWhole); }
  void add(const std::string& call, const Digest& d) { lines.add(name + "_" + call, d); }

  int32_t forward() {
    const svrgs_scene s = scene.view();
    const svrgs_images images = {rgb.data(), depth.data(), alpha.data(), mask.data(), hits.data(), kept.data(), left.data()};
    return svrgs_forward(context, &s, &camera, &options, &images);
  }

  void draw() {
    require(forward(), "forward");
    add("images", digest().add(rgb).add(depth).add(alpha).add(mask).add(hits).add(kept).add(left));
    const uint32_t* ids;
    require(svrgs_visible(context, &ids, &rows), "visible");
    visible.assign(ids, ids + rows);
    svrgs_work work = {};
    require(svrgs_count_work(context, options.depth_limit == nullptr, &work), "count_work");
    add("visible", digest().add(visible).add(&work.visible, 7));
  }

  void differentiate() {
    require(svrgs_backward(context, &image_grads, reserved_grads()), "backward");
    add("backward", digest().add(means).add(log_scales).add(quats).add(logits).add(sh).add(masks).add(means2d));
  }

  void measure() {
    std::vector<double> sum(kCount), transmittance(kCount), cost(kCount), slopes(kCount), dominance(kCount), moments(SVRGS_MOMENTS * rows);
    std::vector<float> most(kCount);
    std::vector<int64_t> blended(kCount);
    std::vector<uint8_t> reached(kCount);
    require(svrgs_scores(context, nullptr, sum.data(), most.data(), blended.data(), transmittance.data(), reached.data()), "scores");
    add("scores", digest().add(sum).add(most).add(blended).add(transmittance).add(reached));
    require(svrgs_moments(context, moments.data()), "moments");
    add("moments", digest().add(moments));
    require(svrgs_removal(context, d_rgb.data(), cost.data()), "removal");
    add("removal", digest().add(cost));
    require(svrgs_slopes(context, slopes.data()), "slopes");
    add("slopes", Digest(kDouble ? kMillionths : kCoarse).add(slopes));  // exp2 of the C library in float, too
    require(svrgs_dominance(context, dominance.data()), "dominance");
    add("dominance", digest().add(dominance));
    std::vector<double> visibility(SVRGS_VISIBILITY * kCount);
    require(svrgs_visibility(context, visibility.data()), "visibility");
    add("visibility", digest().add(visibility));
  }

  // Gradients straight into an Adam step; what is not updated is asked for.
  void update() {
    const int32_t k = scene.coefficients;
    const std::vector<double> rates(3 * k, 0.0625);
    const size_t words = kDouble ? 3 * k + 1 : (3 * k + 1) / 2 + 1;
    std::vector<T> means_moments((kDouble ? 6 : 3) * kCount), sh_moments(words * kCount), mask_moments((kDouble ? 2 : 1) * kCount);
    std::vector<T> mask_logits(kCount), slope = digests::values<T>(34, kCount, 0, 1);
    svrgs_update u = {};
    u.adam = {nullptr, 0.9, 0.999, 1e-15, 3, 0};
    u.means = {scene.means.data(), means_moments.data(), rates.data()}, u.sh = {scene.sh.data(), sh_moments.data(), rates.data()};
    u.masks = {mask_logits.data(), mask_moments.data(), rates.data()}, u.slope = slope.data();
    svrgs_grads others = *reserved_grads();
    others.means = others.sh = others.masks = nullptr;
    int64_t nonfinite = 0;
    require(svrgs_backward_update(context, &image_grads, &u, &others, &nonfinite), "backward_update");
    scene.means[31] = 0;  // was NaN: its bits may differ
    add("backward_update", digest().add(scene.means).add(scene.sh).add(mask_logits).add(logits).add(&nonfinite, 1));
    add("backward_update_moments", kDouble ? digest().add(means_moments).add(sh_moments).add(mask_moments)
                                           : digest().add(bytes(means_moments)).add(bytes(sh_moments)).add(bytes(mask_moments)));
  }

  Lines& lines;
  std::string name;
  Scene<T> scene;
  svrgs_camera camera = digests::camera(0);
  svrgs_options options = {};
  svrgs_context* context = nullptr;

 private:
  void require(int32_t status, const char* call) { lines.require(status == SVRGS_OK, name + "_" + call); }
  static std::vector<uint8_t> bytes(const std::vector<T>& from) {
    const auto* begin = reinterpret_cast<const uint8_t*>(from.data());
    return {begin, begin + from.size() * sizeof(T)};
  }
  const svrgs_grads* reserved_grads() {
    means.assign(3 * rows, 0), log_scales.assign(3 * rows, 0), quats.assign(4 * rows, 0), logits.assign(rows, 0);
    sh.assign(3 * scene.coefficients * rows, 0), masks.assign(rows, 0), means2d.assign(2 * rows, 0);
    grads = {means.data(), log_scales.data(), quats.data(), logits.data(), sh.data(), masks.data(), means2d.data()};
    return &grads;
  }

  std::vector<T> rgb, depth, alpha, mask, left, means, log_scales, quats, logits, sh, masks, means2d;
  std::vector<T> d_rgb = values<T>(30, 3 * kPixels, -1, 1), d_depth = values<T>(31, kPixels, -1, 1), d_alpha = values<T>(32, kPixels, -1, 1),
                 d_mask = values<T>(33, kPixels, 0, 1);
  std::vector<int32_t> hits, kept;
  std::vector<uint32_t> visible;
  int64_t rows = 0;
  svrgs_image_grads image_grads = {d_rgb.data(), d_depth.data(), d_alpha.data(), d_mask.data()};
  svrgs_grads grads = {};
};

template <class T>
void masks_and_options(Lines& lines, int32_t level) {
  for (int32_t kind = 0; kind < SVRGS_MASK_KINDS; ++kind) {
    View<T> v(lines, std::string("mask_") + svrgs_name(SVRGS_MASK_KIND_NAMES, kind), level, 16);
    v.options.mask_kind = kind;
    v.draw(), v.differentiate();
    if (kind == SVRGS_MASK_SVR) v.measure(), v.update();
  }
  const auto with = [&](const char* name, auto change) {
    View<T> v(lines, name, level, 4);
    change(v);
    v.draw(), v.differentiate(), v.measure();
  };
  with("antialiased", [](View<T>& v) { v.options.antialiased = 1; });
  with("orthographic", [](View<T>& v) { v.camera = camera(1); });
  with("stopped_mask", [](View<T>& v) { v.options.full = 0; });
  with("no_skips", [](View<T>& v) { v.options.disabled_skips = SVRGS_ALL_SKIPS; });
  for (const int32_t coefficients : {1, 9}) {
    View<T> v(lines, "coefficients_" + std::to_string(coefficients), level, coefficients);
    v.draw(), v.differentiate(), v.update();
  }
  View<T> limited(lines, "depth_limit", level, 1);
  limited.options.depth_limit = limited.scene.depth_limit.data();
  limited.draw();
}

// Views that are refused, or stopped on the way.
template <class T>
void refusals(Lines& lines, int32_t level) {
  const auto refused = [&](const char* name, int32_t expected, auto change) {
    View<T> v(lines, name, level, 4);
    change(v);
    lines.refuse(v.name, v.forward(), expected);
  };
  static constexpr int32_t kSet = 1;
  refused("cancel", SVRGS_CANCELLED, [](View<T>& v) { v.options.cancel = &kSet; });
  refused("max_pairs", SVRGS_TOO_LARGE, [](View<T>& v) { v.options.max_pairs = 100; });
  refused("wide_image", SVRGS_INVALID, [](View<T>& v) { v.camera.width = 40000; });
  refused("no_focal_length", SVRGS_INVALID, [](View<T>& v) { v.camera.fx = 0; });
  refused("not_finite", SVRGS_INVALID, [](View<T>& v) { v.camera.cx = std::numeric_limits<double>::infinity(); });
  refused("projection", SVRGS_INVALID, [](View<T>& v) { v.camera.orthographic = 2; });
  refused("degree", SVRGS_INVALID, [](View<T>& v) { v.options.sh_degree = 2; });
  refused("mask_kind", SVRGS_INVALID, [](View<T>& v) { v.options.mask_kind = SVRGS_MASK_KINDS; });
  refused("eps_a", SVRGS_INVALID, [](View<T>& v) { v.options.mask_kind = SVRGS_MASK_A, v.options.eps_a = 0; });
  refused("coefficients", SVRGS_INVALID, [](View<T>& v) { v.scene.coefficients = 5; });
  View<T> v(lines, "no_view", level, 4);
  std::vector<double> sums(SVRGS_MOMENTS * kCount);
  lines.refuse("scores_without_view", svrgs_scores(v.context, nullptr, sums.data(), nullptr, nullptr, nullptr, nullptr), SVRGS_INVALID);
  lines.refuse("moments_without_view", svrgs_moments(v.context, sums.data()), SVRGS_INVALID);
  lines.refuse("visibility_without_view", svrgs_visibility(v.context, sums.data()), SVRGS_INVALID);
  const svrgs_image_grads none = {};
  const svrgs_grads out = {};
  lines.refuse("backward_without_view", svrgs_backward(v.context, &none, &out), SVRGS_INVALID);
  lines.refuse("forward_of_nothing", svrgs_forward(v.context, nullptr, nullptr, nullptr, nullptr), SVRGS_INVALID);
}

}  // namespace digests

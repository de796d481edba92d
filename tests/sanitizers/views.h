// Scenes, cameras and calls made from any bytes, for the fuzzer and the thread sanitizer: everything the C interface takes.
#pragma once
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "svrgs.h"

#ifndef VIEWERS  // pixels per degree for FLIP: near and far
#define VIEWERS 1.0, 67.0, 400.0
#endif

namespace views {

[[noreturn]] inline void broken(const char* promise) {
  std::fprintf(stderr, "broken: %s (%s)\n", promise, svrgs_last_error());
  std::abort();
}

inline void require(bool good, const char* promise) {
  if (!good) broken(promise);
}

// Bytes taken one value after the other; zeros once they are used up.
struct Bytes {
  const uint8_t* data;
  size_t left;

  template <class T>
  T take() {
    T value{};
    const size_t n = left < sizeof(T) ? left : sizeof(T);
    std::memcpy(&value, data, n);
    data += n, left -= n;
    return value;
  }
  int below(int limit) { return take<uint8_t>() % limit; }

  double focal() { return below(16) ? 5 + below(200) : value(20); }

  // A float of any bits one time in four, else one that scenes have: -8 .. 8 in steps of 1/4096.
  float value(float scale = 1) {
    const uint8_t kind = take<uint8_t>();
    return kind < 64 ? take<float>() : scale * (take<uint16_t>() / 4096.0f - 8);
  }
};

struct Case {
  int64_t count;
  int32_t k, width, height;
  std::vector<float> means, log_scales, quats, logits, sh;
  std::vector<uint8_t> masks;
  std::vector<float> depth_limit;
  svrgs_camera camera = {};
  svrgs_options options = {};

  explicit Case(Bytes& b) {
    static constexpr int kCoefficients[] = {1, 4, 9, 16};
    count = b.below(40), k = kCoefficients[b.below(4)], width = 1 + b.below(70), height = 1 + b.below(50);
    options.sh_degree = b.below(4), options.antialiased = b.below(2), options.full = b.below(2), options.mask_kind = b.below(SVRGS_MASK_KINDS);
    b.below(2);  // not used: keeps the meaning of the bytes in tests/fuzz/corpus
    options.disabled_skips = b.below(SVRGS_ALL_SKIPS + 1), options.eps_a = 1e-3;
    if ((options.sh_degree + 1) * (options.sh_degree + 1) > k) options.sh_degree = 0;
    const double angle = b.below(256) / 40.0, c = std::cos(angle), s = std::sin(angle);
    const double view[16] = {c, 0, s, b.value(), 0, 1, 0, b.value(), -s, 0, c, b.value(), 0, 0, 0, 1};
    std::memcpy(camera.viewmat, view, sizeof view);
    camera.fx = b.focal(), camera.fy = b.focal(), camera.cx = width / 2.0 + b.value(4), camera.cy = height / 2.0 + b.value(4);
    camera.width = width, camera.height = height, camera.orthographic = b.below(2);
    fill(b, means, 3, 0.5f), fill(b, log_scales, 3, 0.5f), fill(b, quats, 4, 1), fill(b, logits, 1, 2), fill(b, sh, 3 * k, 0.3f);
    masks.resize(count);
    for (auto& m : masks) m = b.below(4) > 0;
    depth_limit.resize(size_t(width) * height);
    for (auto& z : depth_limit) z = b.value();
  }

  svrgs_scene scene() const {
    svrgs_scene s = {};
    s.count = count, s.sh_coefficients = k, s.means = means.data(), s.log_scales = log_scales.data(), s.quats = quats.data();
    s.opacity_logits = logits.data(), s.sh = sh.data(), s.masks = masks.data();
    return s;
  }

 private:
  void fill(Bytes& b, std::vector<float>& values, int columns, float scale) {
    values.resize(count * columns);
    for (auto& v : values) v = b.value(scale);
  }
};

// Everything one view gives, in one list.
struct Results {
  bool drawn = false;
  std::vector<float> values;
};

inline void append(Results& r, const std::vector<float>& more) { r.values.insert(r.values.end(), more.begin(), more.end()); }

// The calls on one view of a case, in the order of run(); results are appended to `results`.
class View {
 public:
  View(const Case& from, svrgs_context* in) : c(from), context(in), scene(from.scene()), pixels(size_t(from.width) * from.height) {
    rgb.resize(3 * pixels), depth.resize(pixels), alpha.resize(pixels), mask.resize(pixels), left.resize(pixels);
    hits.resize(pixels), kept.resize(pixels);
    images = {rgb.data(), depth.data(), alpha.data(), mask.data(), hits.data(), kept.data(), left.data()};
  }

  bool drawn() {
    if (svrgs_forward(context, &scene, &c.camera, &c.options, &images) != SVRGS_OK) return false;
    results.drawn = true;
    for (size_t i = 0; i < pixels; ++i) require(0 <= kept[i] && kept[i] <= hits[i] && hits[i] <= c.count, "0 <= K <= N <= count");
    for (const float a : alpha) require(a >= 0 && a <= 1, "alpha within 0..1");
    return true;
  }

  void differentiate() {
    double losses[2];
    const std::vector<float> target(3 * pixels, 0.5f);
    d_rgb.resize(3 * pixels), ones.assign(pixels, 1e-2f);
    require(svrgs_loss(context, rgb.data(), target.data(), c.height, c.width, 0.8, 0.2, d_rgb.data(), losses) == SVRGS_OK, "a loss");
    require(svrgs_visible(context, &ids, &visible) == SVRGS_OK && visible <= c.count, "visible ids");
    for (int64_t i = 0; i < visible; ++i) require(ids[i] < c.count && (i == 0 || ids[i - 1] < ids[i]), "ids ascend");
    means.resize(3 * visible), scales.resize(3 * visible), quats.resize(4 * visible), logits.resize(visible);
    sh.resize(3 * c.k * visible), d_masks.resize(visible), means2d.resize(2 * visible);
    in = {d_rgb.data(), ones.data(), ones.data(), ones.data()};
    out = {means.data(), scales.data(), quats.data(), logits.data(), sh.data(), d_masks.data(), means2d.data()};
    require(svrgs_backward(context, &in, &out) == SVRGS_OK, "gradients");
  }

  // Against a grey image, by viewers near and far; and in linear colours.
  void compare(int32_t level) {
    std::vector<float> image(rgb), errors(pixels), linear(4 * pixels);
    const double space[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    require(svrgs_linear_rgba(level, rgb.data(), rgb.data(), pixels, space, linear.data()) == SVRGS_OK, "linear colours");
    append(results, linear);
    const double matrix[12] = {1, 0.1, 0, 0.1, 0, 1, 0, 0, 0, 0, 0.9, 0};
    std::vector<float> seen(3 * pixels), d_rgb(3 * pixels);
    double d_matrix[12];
    require(svrgs_expose(level, rgb.data(), nullptr, pixels, matrix, seen.data()) == SVRGS_OK, "exposure");
    require(svrgs_expose_vjp(level, seen.data(), rgb.data(), nullptr, pixels, matrix, d_rgb.data(), d_matrix) == SVRGS_OK, "gradients of exposure");
    append(results, seen), append(results, d_rgb);
    const std::vector<float> grey(3 * pixels, 0.5f);
    for (float& v : image) v = std::clamp(v, 0.0f, 1.0f);
    for (const double pixels_per_degree : {VIEWERS}) {
      require(svrgs_flip(level, image.data(), grey.data(), c.height, c.width, pixels_per_degree, errors.data()) == SVRGS_OK, "FLIP");
      for (const float e : errors) require(e >= 0 && e <= 1, "FLIP within 0..1");
      append(results, errors);
    }
  }

  void measure() {
    std::vector<double> sum(c.count), transmittance(c.count), moments(SVRGS_MOMENTS * visible + 1), cost(c.count + 1);
    std::vector<float> most(c.count);
    std::vector<int64_t> blended(c.count);
    std::vector<uint8_t> reached(c.count);
    require(svrgs_scores(context, nullptr, sum.data(), most.data(), blended.data(), transmittance.data(), reached.data()) == SVRGS_OK, "scores");
    require(svrgs_moments(context, moments.data()) == SVRGS_OK, "moments");
    require(svrgs_removal(context, d_rgb.data(), cost.data()) == SVRGS_OK, "costs of removal");
    require(svrgs_slopes(context, cost.data()) == SVRGS_OK && svrgs_dominance(context, cost.data()) == SVRGS_OK, "slopes and dominance");
    svrgs_work work;
    require(svrgs_count_work(context, 1, &work) == SVRGS_OK && work.contributing <= work.hits, "work");
    for (const auto& part : {rgb, depth, alpha, mask, left, d_rgb, means, scales, quats, logits, sh, d_masks, means2d}) append(results, part);
  }

  // The order of removals and merges down to one Gaussian: each operation is on Gaussians that are there.
  void decimate(int32_t level) {
    if (c.count < 2) return;
    std::vector<double> seen(SVRGS_VISIBILITY * c.count);
    require(svrgs_visibility(context, seen.data()) == SVRGS_OK, "visibility");
    for (size_t i = 0; i < seen.size(); ++i) require(seen[i] >= 0 || (i % SVRGS_VISIBILITY >= 4 && i % SVRGS_VISIBILITY < 7), "sums of at least 0");
    const int64_t n = c.count;
    std::vector<uint32_t> a(n), b(n);
    std::vector<float> costs(n), to_means(3 * n), to_scales(3 * n), to_quats(4 * n), to_logits(n), to_sh(3 * c.k * n);
    const svrgs_decimation from = {n,         c.k, 0, c.means.data(), c.log_scales.data(), c.quats.data(), c.logits.data(), c.sh.data(), seen.data(),
                                   {0, 0, 0}, 0.1, 1};
    const svrgs_merges to = {a.data(), b.data(), costs.data(), to_means.data(), to_scales.data(), to_quats.data(), to_logits.data(), to_sh.data()};
    int64_t steps = 0, merges = 0, made = 0;
    require(svrgs_decimate(level, &from, nullptr, &to, &steps, &merges) == SVRGS_OK && steps == n - 1, "an order down to one Gaussian");
    std::vector<uint8_t> there(n, 1);
    for (int64_t k = 0; k < steps; ++k) {
      require(a[k] < there.size() && there[a[k]], "a Gaussian that is there");
      there[a[k]] = 0;
      if (b[k] == UINT32_MAX) continue;
      require(b[k] < there.size() && there[b[k]], "a second one that is there");
      there[b[k]] = 0, there.push_back(1), ++made;
    }
    require(made == merges, "as many results as merges");
    costs.resize(steps), to_means.resize(3 * merges), to_scales.resize(3 * merges), to_quats.resize(4 * merges), to_logits.resize(merges);
    to_sh.resize(3 * c.k * merges);
    for (const auto& part : {costs, to_means, to_scales, to_quats, to_logits, to_sh}) append(results, part);
    results.values.insert(results.values.end(), a.begin(), a.begin() + steps);
  }

  void draw_with_depth_limits() {
    svrgs_options limited = c.options;
    limited.depth_limit = c.depth_limit.data();
    require(svrgs_forward(context, &scene, &c.camera, &limited, &images) == SVRGS_OK, "a view with depth limits");
    require(svrgs_backward(context, &in, &out) == SVRGS_INVALID, "no gradients of it");
    for (const auto& part : {rgb, depth, alpha, mask, left}) append(results, part);
  }

  void update() {
    int64_t bad = 0;
    const std::vector<double> rates(3 * c.k, 1e-3);
    svrgs_adam_settings adam = {rates.data(), 0.9, 0.999, 1e-15, 1, 0};
    std::vector<float> param(c.means), moved;
    std::vector<uint32_t> words(c.means.size());
    if (visible) require(svrgs_adam(context, &adam, param.data(), words.data(), means.data(), ids, visible, 3, &bad) == SVRGS_OK, "an Adam step");
    for (const uint32_t word : words) moved.insert(moved.end(), {std::bit_cast<float>(word & 0xfffff000u), std::bit_cast<float>(word << 20 >> 1)});
    adam.shared = 1;
    const size_t row = (3 * c.k + 1) / 2 + 1;
    param = c.sh, words.assign(c.count * row, 0);
    if (visible) require(svrgs_adam(context, &adam, param.data(), words.data(), sh.data(), ids, visible, 3 * c.k, &bad) == SVRGS_OK, "an Adam step on SH");
    for (size_t i = 0; i < words.size(); ++i)
      if (i % row == row - 1)
        moved.push_back(std::bit_cast<float>(words[i]));
      else
        moved.insert(moved.end(), {std::bit_cast<float>(words[i] << 16), std::bit_cast<float>(words[i] & 0xffff0000u)});
    append(results, moved);
  }

  Results results;

 private:
  const Case& c;
  svrgs_context* context;
  const svrgs_scene scene;
  const size_t pixels;
  std::vector<float> rgb, depth, alpha, mask, left, d_rgb, ones;
  std::vector<int32_t> hits, kept;
  svrgs_images images;
  const uint32_t* ids = nullptr;
  int64_t visible = 0;
  std::vector<float> means, scales, quats, logits, sh, d_masks, means2d;  // gradients
  svrgs_image_grads in;
  svrgs_grads out;
};

// Forward, loss, backward, FLIP, statistics, an order of removals and merges, and an Adam step of a case. level: that of the context.
inline Results run(const Case& c, svrgs_context* context, int32_t level) {
  View view(c, context);
  if (!view.drawn()) return view.results;
  view.differentiate();
  view.compare(level);
  view.measure();
  view.decimate(level);
  view.draw_with_depth_limits();
  view.update();
  return view.results;
}

inline bool finite(const Results& r) {
  for (const float v : r.values)
    if (!std::isfinite(v)) return false;
  return true;
}

}  // namespace views

// Calls the whole C interface on inputs made by integer arithmetic and prints a line per call: LEVEL CALL KIND DIGEST. Usage: digests LEVEL.
// Kinds: "exact" lines are the same on every system; "rounded" ones, up to the last digits of the C library's exp2 and log2; "says" is
// the sentence of a call that must be refused. All calls run with one thread and with three; both must give the same.
#include "digest.h"
#include "inputs.h"
#include "render_calls.h"
#include "svrgs.h"

namespace digests {
namespace {

constexpr size_t kRows = 300;

template <class T>
void loss(Lines& lines, svrgs_context* context) {
  const std::vector<T> image = values<T>(40, 3 * kPixels, 0, 1), target = values<T>(41, 3 * kPixels, 0, 1);
  std::vector<T> grad(3 * kPixels);
  double found[2];
  lines.require(svrgs_loss(context, image.data(), target.data(), kHeight, kWidth, 0.8, 0.2, grad.data(), found) == SVRGS_OK, "loss");
  lines.add("loss", Digest(sizeof(T) == 8 ? kMillionths : kWhole).add(grad).add(found, 2));
  std::vector<T> mask_grad(3 * kPixels);
  double mask_loss;
  lines.require(svrgs_mask_loss(context, image.data(), 3 * kPixels, 0.3, mask_grad.data(), &mask_loss) == SVRGS_OK, "mask_loss");
  lines.add("mask_loss", Digest(sizeof(T) == 8 ? kMillionths : kWhole).add(mask_grad).add(&mask_loss, 1));
  lines.refuse("mask_loss_size", svrgs_mask_loss(context, image.data(), 0, 0.3, mask_grad.data(), &mask_loss), SVRGS_INVALID);
  lines.refuse("loss_size", svrgs_loss(context, image.data(), target.data(), 0, kWidth, 0.8, 0.2, nullptr, found), SVRGS_INVALID);
}

template <class T>
void flip(Lines& lines, int32_t level) {
  const std::vector<T> image = values<T>(40, 3 * kPixels, 0, 1), target = values<T>(41, 3 * kPixels, 0, 1);
  std::vector<T> errors(kPixels);
  lines.require(svrgs_flip(level, image.data(), target.data(), kHeight, kWidth, 67, errors.data()) == SVRGS_OK, "flip");
  lines.add("flip", Digest(sizeof(T) == 8 ? kMillionths : kWhole).add(errors));
  lines.refuse("flip_viewer", svrgs_flip(level, image.data(), target.data(), kHeight, kWidth, 0, errors.data()), SVRGS_INVALID);
}

template <class T>
void linear_colours(Lines& lines, int32_t level) {
  const std::vector<T> rgb = values<T>(42, 3 * kPixels, 0, 1), alpha = values<T>(43, kPixels, -0.1, 1);
  const double space[9] = {0.6, 0.1, 0, 0.3, 0.9, 0.1, 0.1, 0, 0.9};
  std::vector<T> rgba(4 * kPixels);
  lines.require(svrgs_linear_rgba(level, rgb.data(), alpha.data(), kPixels, space, rgba.data()) == SVRGS_OK, "linear_rgba");
  lines.add("linear_rgba", Digest(sizeof(T) == 8 ? kMillionths : kWhole).add(rgba));
  lines.refuse("linear_rgba_level", svrgs_linear_rgba(99, rgb.data(), alpha.data(), kPixels, space, rgba.data()), SVRGS_INVALID);
  lines.refuse("linear_rgba_size", svrgs_linear_rgba(level, rgb.data(), alpha.data(), -1, space, rgba.data()), SVRGS_INVALID);
}

template <class T>
void exposure(Lines& lines, int32_t level) {
  const std::vector<T> rgb = values<T>(44, 3 * kPixels, 0, 1), d_seen = values<T>(45, 3 * kPixels, -1, 1);
  const double matrix[12] = {0.9, 0.1, 0, 0.02, 0.05, 1.1, 0, -0.01, 0, 0, 1, 0.1};
  std::vector<uint8_t> valid(kPixels);
  for (size_t i = 0; i < valid.size(); ++i) valid[i] = i % 5 != 0;
  std::vector<T> seen(3 * kPixels), d_rgb(3 * kPixels);
  double d_matrix[12];
  lines.require(svrgs_expose(level, rgb.data(), valid.data(), kPixels, matrix, seen.data()) == SVRGS_OK, "expose");
  lines.require(svrgs_expose_vjp(level, d_seen.data(), rgb.data(), valid.data(), kPixels, matrix, d_rgb.data(), d_matrix) == SVRGS_OK, "expose_vjp");
  lines.add("expose", Digest(sizeof(T) == 8 ? kMillionths : kWhole).add(seen).add(d_rgb).add(d_matrix, 12));
  lines.refuse("expose_size", svrgs_expose(level, rgb.data(), nullptr, -1, matrix, seen.data()), SVRGS_INVALID);
  lines.refuse("expose_vjp_size", svrgs_expose_vjp(level, d_seen.data(), rgb.data(), nullptr, -1, matrix, d_rgb.data(), d_matrix), SVRGS_INVALID);
}

// Three steps on rows of `width`; the gradient of one row is not finite.
template <class T>
void adam(Lines& lines, svrgs_context* context, int32_t width, int32_t shared) {
  constexpr bool kDouble = sizeof(T) == 8;
  const std::string name = std::string(shared ? "adam_shared_" : "adam_") + std::to_string(width);
  const std::vector<double> rates = values<double>(50, width, 0, 1);
  std::vector<T> param = values<T>(51, kRows * width, -1, 1);
  const size_t row = kDouble ? (shared ? width + 1 : 2 * width) : (shared ? (width + 1) / 2 + 1 : width);
  std::vector<T> moments(kRows * row);
  std::vector<uint32_t> ids;
  for (uint32_t i = 0; i < kRows; i += 2) ids.push_back(i);
  int64_t nonfinite = 0, sum = 0;
  for (int64_t step = 1; step <= 3; ++step) {
    std::vector<T> grad = values<T>(51 + step, kRows * width, -1, 1);
    grad[5 * width] = std::numeric_limits<T>::infinity();
    const svrgs_adam_settings settings = {rates.data(), 0.9, 0.999, 1e-15, step, shared};
    const bool some = step == 2;
    const int32_t status =
        svrgs_adam(context, &settings, param.data(), moments.data(), grad.data(), some ? ids.data() : nullptr, some ? ids.size() : kRows, width, &nonfinite);
    lines.require(status == SVRGS_OK, name), sum += nonfinite;
  }
  lines.add(name, Digest(kDouble ? kMillionths : kWhole).add(param).add(&sum, 1));
  const auto* bytes = reinterpret_cast<const uint8_t*>(moments.data());
  lines.add(name + "_moments", kDouble ? Digest(kMillionths).add(moments) : Digest(kWhole).add(bytes, moments.size() * sizeof(T)));
}

template <class T>
void optimiser(Lines& lines, int32_t level) {
  svrgs_context* context = nullptr;
  lines.require(svrgs_context_create(level, &context) == SVRGS_OK, "context_create");
  loss<T>(lines, context);
  for (const int32_t width : {1, 3, 4, 45}) adam<T>(lines, context, width, 0);
  for (const int32_t width : {3, 12, 27, 48}) adam<T>(lines, context, width, 1);
  int64_t nonfinite;
  const double rate = 1;
  const svrgs_adam_settings settings = {&rate, 0.9, 0.999, 1e-15, 1, 1};
  lines.refuse("adam_width", svrgs_adam(context, &settings, nullptr, nullptr, nullptr, nullptr, 0, 5, &nonfinite), SVRGS_INVALID);
  double seconds[SVRGS_STAGES];
  lines.require(svrgs_stage_seconds(context, seconds) == SVRGS_OK && seconds[SVRGS_LOSS] >= 0 && seconds[SVRGS_ADAM] >= 0, "stage_seconds");
  svrgs_context_destroy(context);
}

// What knows no level.
void without_level(Lines& lines) {
  const std::vector<float> logits = values<float>(60, kCount, -6, 6);
  std::vector<uint8_t> masks(kCount);
  std::vector<float> slope(kCount);
  lines.require(svrgs_sample_masks(logits.data(), kCount, 7, 3, masks.data(), slope.data()) == SVRGS_OK, "sample_masks");
  lines.add("sample_masks", Digest(kWhole).add(masks).add(slope));
  Panorama panorama;
  const svrgs_view view = panorama.view();
  const svrgs_panorama picture = panorama.picture();
  lines.require(svrgs_add_view(&view, &picture) == SVRGS_OK, "add_view");
  lines.add("add_view", Digest(kWhole).add(panorama.sums));
  lines.refuse("add_view_of_nothing", svrgs_add_view(nullptr, &picture), SVRGS_INVALID);
}

// Logarithms and exponentials are those of the C library, so of two neighbours that choose each other either may come first.
void decimation(Lines& lines, int32_t level) {
  Decimation made;
  svrgs_decimation scene = made.scene();
  const svrgs_merges out = made.merges();
  int64_t steps = 0, merges = 0;
  lines.require(svrgs_decimate(level, &scene, nullptr, &out, &steps, &merges) == SVRGS_OK, "decimate");
  lines.add("decimate",
            Digest(kCoarse).add(&merges, 1).add(made.costs.data(), steps).add(made.to_means).add(made.to_scales).add(made.to_logits).add(made.to_sh));
  const int32_t set = 1;
  lines.refuse("decimate_cancel", svrgs_decimate(level, &scene, &set, &out, &steps, &merges), SVRGS_CANCELLED);
  scene.least = 0;
  lines.refuse("decimate_to_none", svrgs_decimate(level, &scene, nullptr, &out, &steps, &merges), SVRGS_INVALID);
  scene.least = 1, scene.visibility = nullptr;
  lines.refuse("decimate_unseen", svrgs_decimate(level, &scene, nullptr, &out, &steps, &merges), SVRGS_INVALID);
}

void triangles(Lines& lines) {
  Triangles made;
  svrgs_triangles t = made.view();
  std::vector<float> share(kPixels), depth(2 * kPixels), rgba(8 * kPixels);
  const svrgs_layers layers = {share.data(), depth.data(), rgba.data()};
  for (const int32_t orthographic : {0, 1}) {
    const svrgs_camera c = camera(orthographic);
    const std::string name = orthographic ? "draw_triangles_orthographic" : "draw_triangles";
    lines.require(svrgs_draw_triangles(&t, &c, &layers) == SVRGS_OK, name);
    lines.add(name, Digest(kWhole).add(share).add(depth).add(rgba));
  }
  const svrgs_camera c = camera(0);
  t.texture_count = 1;
  lines.refuse("texture_missing", svrgs_draw_triangles(&t, &c, &layers), SVRGS_INVALID);
  t.uvs = nullptr;
  lines.refuse("uvs_missing", svrgs_draw_triangles(&t, &c, &layers), SVRGS_INVALID);
}

// What the library says about itself, and what only has to answer.
void about(Lines& lines, int32_t level) {
  svrgs_thresholds thresholds;
  svrgs_get_thresholds(&thresholds);
  lines.add("thresholds", Digest(kWhole).add(&thresholds.near_depth, 8).add(&thresholds.tile, 3));
  std::string names;
  for (int32_t kind = SVRGS_LEVEL_NAMES; kind <= SVRGS_STAGE_NAMES; ++kind)
    for (int32_t i = 0; svrgs_name(kind, i); ++i) names += std::string(names.empty() ? "" : " ") + svrgs_name(kind, i);
  lines.all.push_back(lines.level + " names says " + names);
  lines.all.push_back(lines.level + " interface_version says " + std::to_string(svrgs_interface_version()));
  lines.require(svrgs_level_supported(level) && svrgs_level_supported(svrgs_best_level()) && !svrgs_level_supported(SVRGS_LEVELS), "levels");
  svrgs_machine machine;
  lines.require(svrgs_measure_machine(level, &machine) == SVRGS_OK && machine.fma > 0 && machine.read > 0 && machine.update > 0, "measure_machine");
  svrgs_context* context = nullptr;
  lines.refuse("context_level", svrgs_context_create(SVRGS_LEVELS, &context), SVRGS_INVALID);
}

template <class T>
Lines run(const std::string& name, int32_t level, int32_t threads) {
  svrgs_set_threads(threads);
  Lines lines = {name, {}};
  lines.require(svrgs_threads() == threads, "threads");
  about(lines, level);
  masks_and_options<T>(lines, level);
  refusals<T>(lines, level);
  optimiser<T>(lines, level);
  flip<T>(lines, level);
  linear_colours<T>(lines, level);
  exposure<T>(lines, level);
  without_level(lines);
  triangles(lines);
  decimation(lines, level);
  return lines;
}

template <class T>
int print(const std::string& name, int32_t level) {
  const Lines one = run<T>(name, level, 1), three = run<T>(name, level, 3);
  int differ = 0;
  for (size_t i = 0; i < one.all.size(); ++i) {
    std::puts(one.all[i].c_str());
    if (one.all[i] != three.all[i]) differ = 1, std::fprintf(stderr, "with three threads: %s\n", three.all[i].c_str());
  }
  return differ;
}

}  // namespace
}  // namespace digests

int main(int argc, char** argv) {
  if (argc != 2) return std::fprintf(stderr, "usage: digests LEVEL\n"), 2;
  for (int32_t level = 0; svrgs_name(SVRGS_LEVEL_NAMES, level); ++level)
    if (std::string(argv[1]) == svrgs_name(SVRGS_LEVEL_NAMES, level))
      return level == SVRGS_DOUBLE ? digests::print<double>(argv[1], level) : digests::print<float>(argv[1], level);
  return std::fprintf(stderr, "there is no level %s\n", argv[1]), 2;
}

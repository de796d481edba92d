// Calls each costly entry point of the core once on the case written by __init__.py, and has callgrind dump what that took.
// Usage: driver CASE LEVEL. CASE: four int32 (Gaussians, SH coefficients, width, height), 20 doubles (viewmat, fx fy cx cy),
// then the scene's five float arrays and a byte mask for each Gaussian.
#include <valgrind/callgrind.h>

#include <cstdio>
#include <cstdlib>
#include <vector>

#include "svrgs.h"

namespace {

struct Case {
  int32_t size[4];
  double camera[20];
  std::vector<float> means, log_scales, quats, opacity_logits, sh;
  std::vector<uint8_t> masks;
};

void require(bool good) {
  if (good) return;
  std::fprintf(stderr, "driver: %s\n", svrgs_last_error());
  std::exit(1);
}

template <class T>
void read(std::FILE* file, T* values, size_t count) {
  require(std::fread(values, sizeof(T), count, file) == count);
}

template <class T>
void fill(std::FILE* file, std::vector<T>& values, size_t count) {
  values.resize(count);
  read(file, values.data(), count);
}

Case read_case(const char* path) {
  Case c;
  std::FILE* file = std::fopen(path, "rb");
  require(file);
  read(file, c.size, 4);
  read(file, c.camera, 20);
  const size_t n = c.size[0], k = c.size[1];
  fill(file, c.means, 3 * n);
  fill(file, c.log_scales, 3 * n);
  fill(file, c.quats, 4 * n);
  fill(file, c.opacity_logits, n);
  fill(file, c.sh, 3 * k * n);
  fill(file, c.masks, n);
  std::fclose(file);
  return c;
}

template <class Call>
void measure(const char* name, Call call) {
  CALLGRIND_ZERO_STATS;
  const int32_t status = call();
  CALLGRIND_DUMP_STATS_AT(name);
  require(status == SVRGS_OK);
}

void run(const Case& c, int32_t level) {
  const auto [n, k, width, height] = c.size;
  const size_t pixels = size_t(width) * height, values = 3 * size_t(k);
  svrgs_context* context;
  require(svrgs_context_create(level, &context) == SVRGS_OK);

  svrgs_scene scene = {};
  scene.count = n, scene.sh_coefficients = k;
  scene.means = c.means.data(), scene.log_scales = c.log_scales.data(), scene.quats = c.quats.data();
  scene.opacity_logits = c.opacity_logits.data(), scene.sh = c.sh.data();
  svrgs_camera camera = {};
  for (int i = 0; i < 16; ++i) camera.viewmat[i] = c.camera[i];
  camera.fx = c.camera[16], camera.fy = c.camera[17], camera.cx = c.camera[18], camera.cy = c.camera[19];
  camera.width = width, camera.height = height;
  svrgs_options options = {};
  options.sh_degree = 3, options.full = 1, options.eps_a = 1e-3;

  std::vector<float> rgb(3 * pixels), mask(pixels), target(3 * pixels, 0.5f), rgb_grad(3 * pixels), mask_grad(pixels, 1e-5f);
  svrgs_images images = {};
  images.rgb = rgb.data();
  measure("render", [&] { return svrgs_forward(context, &scene, &camera, &options, &images); });
  scene.masks = c.masks.data(), images.mask = mask.data(), options.mask_kind = SVRGS_MASK_SVR;
  measure("forward", [&] { return svrgs_forward(context, &scene, &camera, &options, &images); });

  double loss[2];
  measure("loss", [&] { return svrgs_loss(context, rgb.data(), target.data(), height, width, 0.8, 0.2, rgb_grad.data(), loss); });

  const uint32_t* ids;
  int64_t rows, bad;
  require(svrgs_visible(context, &ids, &rows) == SVRGS_OK);
  std::vector<float> means(3 * rows), log_scales(3 * rows), quats(4 * rows), logits(rows), sh(values * rows), masks(rows), means2d(2 * rows);
  const svrgs_image_grads in = {rgb_grad.data(), nullptr, nullptr, mask_grad.data()};
  const svrgs_grads out = {means.data(), log_scales.data(), quats.data(), logits.data(), sh.data(), masks.data(), means2d.data()};
  measure("backward", [&] { return svrgs_backward(context, &in, &out); });

  std::vector<double> sum(n), through(n), moments(SVRGS_MOMENTS * rows);
  std::vector<float> most(n);
  std::vector<int64_t> hits(n);
  measure("scores", [&] { return svrgs_scores(context, sum.data(), most.data(), hits.data(), through.data()); });
  measure("moments", [&] { return svrgs_moments(context, moments.data()); });

  const std::vector<double> rates(values, 1e-3);
  svrgs_adam_settings settings = {rates.data(), 0.9, 0.999, 1e-15, 1, 0};
  std::vector<float> param(c.means);
  std::vector<uint32_t> words(values * n);
  measure("adam", [&] { return svrgs_adam(context, &settings, param.data(), words.data(), means.data(), ids, rows, 3, &bad); });
  settings.shared = 1, param = c.sh;
  words.assign(words.size(), 0);
  measure("adam sh", [&] { return svrgs_adam(context, &settings, param.data(), words.data(), sh.data(), ids, rows, int32_t(values), &bad); });
  svrgs_context_destroy(context);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  svrgs_set_threads(1);
  run(read_case(argv[1]), std::atoi(argv[2]));
}

// Calls each costly entry point of the core once on the case written by __init__.py, and has callgrind dump what that took; or, compiled
// with COUNTED_BY_QEMU, marks each call for qemu_counter.c and prints its name. Usage: driver CASE LEVEL. CASE: four int32 (Gaussians, SH coefficients, width, height), 20 doubles (viewmat, fx fy cx cy),
// then the scene's five float arrays and a byte mask for each Gaussian.
#if defined(COUNTED_BY_QEMU)
#include <unistd.h>
#else
#include <valgrind/callgrind.h>
#endif

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

#if defined(COUNTED_BY_QEMU)
void begin() { require(write(-1, nullptr, 0) < 0); }
void end(const char* name) {
  begin();
  std::puts(name);
}
#else
void begin() { CALLGRIND_ZERO_STATS; }
void end(const char* name) { CALLGRIND_DUMP_STATS_AT(name); }
#endif

template <class Call>
void measure(const char* name, Call call) {
  begin();
  const int32_t status = call();
  end(name);
  require(status == SVRGS_OK);
}

// A case at one level: what its calls share.
struct Run {
  const Case& c;
  const int32_t count, coefficients, width, height;
  svrgs_context* context = nullptr;
  svrgs_scene scene = {};
  svrgs_camera camera = {};
  std::vector<float> rgb, mask, rgb_grad, mask_grad;
  const uint32_t* ids = nullptr;
  int64_t rows = 0;
  std::vector<float> means, log_scales, quats, logits, sh, masks, means2d;  // gradients

  Run(const Case& from, int32_t level) : c(from), count(c.size[0]), coefficients(c.size[1]), width(c.size[2]), height(c.size[3]) {
    require(svrgs_context_create(level, &context) == SVRGS_OK);
    scene.count = count, scene.sh_coefficients = coefficients;
    scene.means = c.means.data(), scene.log_scales = c.log_scales.data(), scene.quats = c.quats.data();
    scene.opacity_logits = c.opacity_logits.data(), scene.sh = c.sh.data();
    for (int i = 0; i < 16; ++i) camera.viewmat[i] = c.camera[i];
    camera.fx = c.camera[16], camera.fy = c.camera[17], camera.cx = c.camera[18], camera.cy = c.camera[19];
    camera.width = width, camera.height = height;
    const size_t pixels = size_t(width) * height;
    rgb.resize(3 * pixels), mask.resize(pixels), rgb_grad.resize(3 * pixels), mask_grad.assign(pixels, 1e-5f);
  }
  ~Run() { svrgs_context_destroy(context); }
  Run(const Run&) = delete;

  void forward() {
    svrgs_options options = {};
    options.sh_degree = 3, options.full = 1, options.eps_a = 1e-3;
    svrgs_images images = {};
    images.rgb = rgb.data();
    measure("render", [&] { return svrgs_forward(context, &scene, &camera, &options, &images); });
    scene.masks = c.masks.data(), images.mask = mask.data(), options.mask_kind = SVRGS_MASK_SVR;
    measure("forward", [&] { return svrgs_forward(context, &scene, &camera, &options, &images); });
  }

  void loss() {
    double values[2];
    const std::vector<float> target(rgb.size(), 0.5f);
    measure("loss", [&] { return svrgs_loss(context, rgb.data(), target.data(), height, width, 0.8, 0.2, rgb_grad.data(), values); });
  }

  void flip(int32_t level) {
    const std::vector<float> target(rgb.size(), 0.5f);
    std::vector<float> errors(mask.size());
    measure("flip", [&] { return svrgs_flip(level, rgb.data(), target.data(), height, width, 67, errors.data()); });
  }

  void backward() {
    require(svrgs_visible(context, &ids, &rows) == SVRGS_OK);
    means.resize(3 * rows), log_scales.resize(3 * rows), quats.resize(4 * rows), logits.resize(rows);
    sh.resize(3 * coefficients * rows), masks.resize(rows), means2d.resize(2 * rows);
    const svrgs_image_grads in = {rgb_grad.data(), nullptr, nullptr, mask_grad.data()};
    const svrgs_grads out = {means.data(), log_scales.data(), quats.data(), logits.data(), sh.data(), masks.data(), means2d.data()};
    measure("backward", [&] { return svrgs_backward(context, &in, &out); });
  }

  void statistics() {
    std::vector<double> sum(count), transmittance(count), moments(SVRGS_MOMENTS * rows);
    std::vector<float> most(count);
    std::vector<int64_t> hits(count);
    measure("scores", [&] { return svrgs_scores(context, nullptr, sum.data(), most.data(), hits.data(), transmittance.data(), nullptr); });
    measure("moments", [&] { return svrgs_moments(context, moments.data()); });
  }

  void adam() {
    const int32_t values = 3 * coefficients;
    const std::vector<double> rates(values, 1e-3);
    svrgs_adam_settings settings = {rates.data(), 0.9, 0.999, 1e-15, 1, 0};
    std::vector<float> param(c.means);
    std::vector<uint32_t> words(size_t(values) * count);
    int64_t bad;
    measure("adam", [&] { return svrgs_adam(context, &settings, param.data(), words.data(), means.data(), ids, rows, 3, &bad); });
    settings.shared = 1, param = c.sh;
    words.assign(words.size(), 0);
    measure("adam_sh", [&] { return svrgs_adam(context, &settings, param.data(), words.data(), sh.data(), ids, rows, values, &bad); });
  }
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  svrgs_set_threads(1);
  const Case c = read_case(argv[1]);
  Run run(c, std::atoi(argv[2]));
  run.forward();
  run.loss();
  run.flip(std::atoi(argv[2]));
  run.backward();
  run.statistics();
  run.adam();
}

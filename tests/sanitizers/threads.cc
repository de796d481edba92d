// Pool and kernels under the thread sanitizer: views at several sizes of the pool, the pool's size changed while others draw,
// contexts side by side, a cancel flag set from outside. Prints "clean" at the end; a data race ends the program.
// threads [N]: N views at every level; 12 where N is not given.
#include <random>
#include <thread>

#define VIEWERS 10.0  // small filters, which take most of the time under the sanitizer
#include "views.h"

namespace {

std::vector<uint8_t> noise(unsigned seed) {
  std::mt19937 random(seed);
  std::vector<uint8_t> bytes(20000);
  for (auto& byte : bytes) byte = static_cast<uint8_t>(random());
  bytes[0] = 39;  // Gaussians
  return bytes;
}

views::Results drawn(unsigned seed, int32_t level) {
  const std::vector<uint8_t> bytes = noise(seed);
  views::Bytes source{bytes.data(), bytes.size()};
  views::Case c(source);
  c.camera.fx = c.camera.fy = 40;
  svrgs_context* context;
  views::require(svrgs_context_create(level, &context) == SVRGS_OK, "a context");
  views::Results r = views::run(c, context, level);
  svrgs_context_destroy(context);
  return r;
}

// Enough Gaussians for several blocks of every stage, cancelled at some point or not at all.
void cancelled(int microseconds) {
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  const int n = 20000, width = 200, height = 150;
  std::vector<float> means(3 * n), scales(3 * n, -4.0f), quats(4 * n), logits(n, 1.0f), sh(3 * n, 0.3f), rgb(3 * width * height);
  for (int i = 0; i < n; ++i) means[3 * i] = normal(random), means[3 * i + 1] = normal(random), means[3 * i + 2] = 4 + normal(random);
  for (auto& q : quats) q = normal(random);
  svrgs_scene scene = {};
  scene.count = n, scene.sh_coefficients = 1, scene.means = means.data(), scene.log_scales = scales.data(), scene.quats = quats.data();
  scene.opacity_logits = logits.data(), scene.sh = sh.data();
  svrgs_camera camera = {};
  for (int i : {0, 5, 10, 15}) camera.viewmat[i] = 1;
  camera.fx = camera.fy = 150, camera.cx = width / 2, camera.cy = height / 2, camera.width = width, camera.height = height;
  svrgs_options options = {};
  int32_t cancel = 0;
  options.cancel = &cancel;
  svrgs_images images = {};
  images.rgb = rgb.data();
  svrgs_context* context;
  views::require(svrgs_context_create(svrgs_best_level(), &context) == SVRGS_OK, "a context");
  std::thread other([&] {
    std::this_thread::sleep_for(std::chrono::microseconds(microseconds));
    __atomic_store_n(&cancel, 1, __ATOMIC_RELAXED);
  });
  const int32_t status = svrgs_forward(context, &scene, &camera, &options, &images);
  views::require(status == SVRGS_OK || status == SVRGS_CANCELLED, "drawn or cancelled");
  other.join();
  svrgs_context_destroy(context);
}

// Triangles of a picture that is drawn in several bands.
std::vector<float> triangles() {
  std::mt19937 random(2);
  std::normal_distribution<float> normal;
  const int n = 500, width = 300, height = 130;
  std::vector<float> corners(9 * n), colors(9 * n, 0.5f), light(3 * n, 0.1f);
  for (int i = 0; i < 9 * n; ++i) corners[i] = (i % 3 == 2 ? 5.0f : 0.0f) + normal(random);
  const std::vector<uint8_t> holdout(n);
  svrgs_triangles t = {};
  t.count = n, t.corners = corners.data(), t.colors = colors.data(), t.light = light.data(), t.holdout = holdout.data(), t.ambient = 0.6;
  svrgs_camera camera = {};
  for (int i : {0, 5, 10, 15}) camera.viewmat[i] = 1;
  camera.fx = camera.fy = 130, camera.cx = width / 2, camera.cy = height / 2, camera.width = width, camera.height = height;
  std::vector<float> share(width * height), depth(2 * share.size()), rgba(8 * share.size());
  const svrgs_layers layers = {share.data(), depth.data(), rgba.data()};
  views::require(svrgs_draw_triangles(&t, &camera, &layers) == SVRGS_OK, "triangles");
  return rgba;
}

}  // namespace

int main(int argc, char** argv) {
  const unsigned seeds = argc > 1 ? static_cast<unsigned>(std::atoi(argv[1])) : 12;
  unsigned compared = 0;
  for (const int32_t level : {SVRGS_SCALAR, SVRGS_BASELINE, SVRGS_AVX2, SVRGS_AVX512}) {
    if (!svrgs_level_supported(level)) continue;
    for (unsigned seed = 0; seed < seeds; ++seed) {
      svrgs_set_threads(1);
      const views::Results one = drawn(seed, level);
      compared += one.drawn;
      for (const int threads : {2, 3, 7}) {
        svrgs_set_threads(threads);
        views::require(drawn(seed, level).values == one.values || !views::finite(one), "the same bits for any number of threads");
      }
    }
  }
  views::require(compared >= seeds, "views that are drawn");
  svrgs_set_threads(1);
  const std::vector<float> one = triangles();
  svrgs_set_threads(4);
  views::require(triangles() == one, "the same triangles for any number of threads");
  std::vector<std::thread> drawing;
  for (unsigned seed = 0; seed < 4; ++seed)
    drawing.emplace_back([=] {
      for (int i = 0; i < 5; ++i) drawn(seed, SVRGS_BASELINE);
    });
  for (int i = 0; i < 20; ++i) svrgs_set_threads(1 + i % 5);
  for (auto& thread : drawing) thread.join();
  for (const int microseconds : {0, 300, 3000, 30000}) cancelled(microseconds);
  std::puts("clean");
}

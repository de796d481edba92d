#include "panorama.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "pool.h"

namespace svrgs {
namespace {

// Weights of the four neighbours of a place at t of 0..1 between the second and the third (Catmull and Rom).
std::array<float, 4> cubic(double t) {
  const double t2 = t * t, t3 = t2 * t;
  return {static_cast<float>(0.5 * (2 * t2 - t - t3)), static_cast<float>(0.5 * (2 - 5 * t2 + 3 * t3)), static_cast<float>(0.5 * (t + 4 * t2 - 3 * t3)),
          static_cast<float>(0.5 * (t3 - t2))};
}

// Adds weight times the view at (x, y) to a pixel; values of `along` are multiplied with the length of the ray first.
void add_sample(const svrgs_view& v, double x, double y, double weight, double ray, float* pixel) {
  const double left = std::floor(x - 0.5), top = std::floor(y - 0.5);
  const std::array<float, 4> across = cubic(x - 0.5 - left), down = cubic(y - 0.5 - top);
  const auto inside = [](double at, int side) { return static_cast<int64_t>(std::clamp(at, 0.0, side - 1.0)); };
  for (int j = 0; j < 4; ++j) {
    const float* const row = v.image + inside(top + j - 1, v.height) * v.width * v.channels;
    for (int i = 0; i < 4; ++i) {
      const float* const from = row + inside(left + i - 1, v.width) * v.channels;
      const float part = static_cast<float>(weight) * down[j] * across[i];
      for (int c = 0; c < v.channels; ++c) pixel[c] += part * from[c] * (c == v.along ? static_cast<float>(ray) : 1);
    }
  }
}

}  // namespace

void add_view(const svrgs_view& v, const svrgs_panorama& p) {
  parallel_for(p.height, [&](int64_t row) {
    if (p.row_weights[row] == 0) return;
    const double level = std::cos(p.latitudes[row]), down = -std::sin(p.latitudes[row]);
    for (int column = 0; column < p.width; ++column) {
      const double weight = p.row_weights[row] * p.column_weights[column];
      if (weight == 0) continue;
      const double right = std::sin(p.longitudes[column]) * level, forward = std::cos(p.longitudes[column]) * level;
      const auto turned = [&](int k) { return v.turn[3 * k] * right + v.turn[3 * k + 1] * down + v.turn[3 * k + 2] * forward; };
      const double z = turned(2);
      add_sample(v, v.focal * turned(0) / z + v.cx, v.focal * turned(1) / z + v.cy, weight, 1 / z, p.sums + (row * p.width + column) * v.channels);
    }
  });
}

}  // namespace svrgs

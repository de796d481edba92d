#include "flip.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <numeric>

#include "kernels.h"
#include "pool.h"

namespace svrgs {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kWidest = 0.04;   // the largest b of table 1
constexpr double kUnseen = 1e-12;  // of the central tap: taps below are left out
struct Gaussian {
  double a, b;
};
constexpr Gaussian kSensitivity[] = {{1, 0.0047}, {1, 0.0053}, {34.1, kWidest}, {13.5, 0.025}};  // table 1: Y, Cx, Cz
constexpr double kFeatureWidth = 0.082;                                                          // degrees (w in the paper)

double sum(const FlipTaps& f) { return f.tap[0] + 2 * std::accumulate(f.tap + 1, f.tap + f.radius + 1, 0.0); }

// exp(-pi^2 x^2 / b), x in degrees, with sum 1 (equation 5). *weight receives its share in the sum of Gaussians of a channel, not normalised.
FlipTaps sensitivity(Gaussian g, int radius, double pixels_per_degree, double* weight) {
  FlipTaps f = {radius, {}};
  for (int k = 0; k <= radius; ++k) f.tap[k] = std::exp(-std::pow(kPi * k / pixels_per_degree, 2) / g.b);
  const double total = sum(f);
  *weight = g.a * std::sqrt(kPi / g.b) * total * total;
  while (f.radius > 1 && f.tap[f.radius] < kUnseen) --f.radius;
  for (double& t : f.tap) t /= total;
  return f;
}

// Scales positive and negative values of a filter to sums of 1 and -1, so that it gives 0 for a constant image.
void balance(FlipTaps& f, bool even) {
  double positive = 0, negative = 0;
  for (int k = 0; k <= f.radius; ++k) (f.tap[k] > 0 ? positive : negative) += even && k > 0 ? 2 * f.tap[k] : f.tap[k];
  for (double& t : f.tap) t /= t > 0 ? positive : -negative;
}

// A Gaussian and its derivatives, of the radius of three standard deviations (section 4.2).
void features(double pixels_per_degree, FlipTaps* filters) {
  const double sigma = 0.5 * kFeatureWidth * pixels_per_degree;
  FlipTaps smooth = {static_cast<int>(std::ceil(3 * sigma)), {}}, edge = smooth, point = smooth;
  for (int k = 0; k <= smooth.radius; ++k) {
    const double g = std::exp(-k * k / (2 * sigma * sigma));
    smooth.tap[k] = g, edge.tap[k] = k * g, point.tap[k] = (k * k / (sigma * sigma) - 1) * g;
  }
  const double total = sum(smooth);
  for (double& t : smooth.tap) t /= total;
  balance(edge, false), balance(point, true);
  filters[kFlipSmooth] = smooth, filters[kFlipEdge] = edge, filters[kFlipPoint] = point;
}

void set_filters(double pixels_per_degree, FlipArguments& a) {
  const int radius = static_cast<int>(std::ceil(3 * std::sqrt(kWidest / (2 * kPi * kPi)) * pixels_per_degree));  // of the widest one, for all
  double weight[4];
  for (int i = 0; i < 4; ++i) a.filters[kFlipY + i] = sensitivity(kSensitivity[i], radius, pixels_per_degree, weight + i);
  for (int i = 0; i < 2; ++i) a.cz_share[i] = weight[2 + i] / (weight[2] + weight[3]);
  features(pixels_per_degree, a.filters);
  for (const FlipTaps& f : a.filters) a.margin = std::max<int64_t>(a.margin, f.radius);
}

}  // namespace

void flip(const Kernels& kernels, const void* image, const void* target, int64_t height, int64_t width, double pixels_per_degree, void* errors) {
  FlipArguments a = {image, target, errors, height, width, (width + kFlipTileColumns - 1) / kFlipTileColumns, 0, {}, {}};
  set_filters(pixels_per_degree, a);
  const int64_t tiles = (height + kFlipTileRows - 1) / kFlipTileRows * a.tiles_across, own = a.scratch() * kernels.real_size;
  std::unique_ptr<char[]> scratch;
  parallel_for_workers(
      tiles, [&](int workers) { scratch = std::make_unique_for_overwrite<char[]>(workers * own); },
      [&](int64_t tile, int worker) { kernels.flip_tile(a, tile, scratch.get() + worker * own); });
}

}  // namespace svrgs

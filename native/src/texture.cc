#include "texture.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace svrgs {
namespace {

constexpr int kProbes = 8;          // at most, along the longer side of a footprint
constexpr double kLargest = 65536;  // side of a footprint, texels

// The linear values of the 256 levels of sRGB.
const std::array<float, 256> kLinear = [] {
  std::array<float, 256> table;
  for (int k = 0; k < 256; ++k) {
    const double s = k / 255.0;
    table[k] = static_cast<float>(s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4));
  }
  return table;
}();

struct Level {
  const uint8_t* texels;
  int width, height;
};

Level level_of(const svrgs_texture& t, int number) {
  Level level = {t.texels, t.width, t.height};
  for (int k = 0; k < number && (level.width > 1 || level.height > 1); ++k) {
    level.texels += int64_t{3} * level.width * level.height;
    level.width = (level.width + 1) / 2, level.height = (level.height + 1) / 2;
  }
  return level;
}

// The two texels around a coordinate of 0..1 along a side, and the share of the second.
struct Between {
  int first, second;
  double share;
};

Between between(double at, int side, bool repeat) {
  at = (repeat ? at - std::floor(at) : std::clamp(at, 0.0, 1.0)) * side - 0.5;
  const double low = std::floor(at);
  const int first = static_cast<int>(low), second = first + 1;
  if (repeat) return {first < 0 ? side - 1 : first, second >= side ? 0 : second, at - low};
  return {std::max(first, 0), std::min(second, side - 1), at - low};
}

// Adds weight times the bilinear colour of a level.
void add_level(const svrgs_texture& t, int number, double u, double v, double weight, double rgb[3]) {
  const Level level = level_of(t, number);
  const Between x = between(u, level.width, t.repeat), y = between(v, level.height, t.repeat);
  const auto row = [&](int k) { return level.texels + int64_t{3} * level.width * k; };
  const uint8_t *low = row(y.first), *high = row(y.second);
  for (int c = 0; c < 3; ++c) {
    const auto along = [&](const uint8_t* texels) {
      const double a = kLinear[texels[3 * x.first + c]], b = kLinear[texels[3 * x.second + c]];
      return a + x.share * (b - a);
    };
    const double a = along(low), b = along(high);
    rgb[c] += weight * (a + y.share * (b - a));
  }
}

}  // namespace

void sample_texture(const svrgs_texture& t, double u, double v, const Footprint& f, double rgb[3]) {
  rgb[0] = rgb[1] = rgb[2] = 0;
  if (!std::isfinite(u) || !std::isfinite(v)) return;
  const auto texels = [&](double du, double dv) { return std::fmin(std::hypot(du * t.width, dv * t.height), kLargest); };  // NaN becomes kLargest
  const double across = texels(f.u_x, f.v_x), down = texels(f.u_y, f.v_y), longer = std::max(across, down), shorter = std::min(across, down);
  const double u_step = across >= down ? f.u_x : f.u_y, v_step = across >= down ? f.v_x : f.v_y;
  const int probes = static_cast<int>(std::clamp(std::ceil(longer / std::max(shorter, 1.0)), 1.0, double{kProbes}));
  const double detail = std::log2(std::max(longer / probes, 1.0));
  const int level = static_cast<int>(detail);
  const double coarser = detail - level;
  for (int k = 0; k < probes; ++k) {
    const double along = (k + 0.5) / probes - 0.5;
    add_level(t, level, u + along * u_step, v + along * v_step, (1 - coarser) / probes, rgb);
    if (coarser > 0) add_level(t, level + 1, u + along * u_step, v + along * v_step, coarser / probes, rgb);
  }
}

float srgb_of_linear(double value) { return static_cast<float>(value <= 0.0031308 ? 12.92 * value : 1.055 * std::pow(value, 1 / 2.4) - 0.055); }

}  // namespace svrgs

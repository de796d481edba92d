// A scene, photographs, triangles and a panorama made by integer arithmetic: the same bits on every system.
#pragma once
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "svrgs.h"

namespace digests {

inline uint64_t mix(uint64_t x) {  // the splitmix64 finaliser
  x += 0x9e3779b97f4a7c15ULL;
  x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ x >> 27) * 0x94d049bb133111ebULL;
  return x ^ x >> 31;
}

// `count` multiples of 1/4096 in low .. high. Both float and double hold them exactly.
template <class T>
std::vector<T> values(uint64_t seed, size_t count, int low, int high) {
  std::vector<T> made(count);
  for (size_t i = 0; i < count; ++i) {
    const uint64_t steps = mix(seed << 32 | i) % (static_cast<uint64_t>(high - low) * 4096 + 1);
    made[i] = static_cast<T>(low) + static_cast<T>(steps) / 4096;
  }
  return made;
}

constexpr int kCount = 2500, kWidth = 70, kHeight = 50, kPixels = kWidth * kHeight;

template <class T>
struct Scene {
  int32_t coefficients;
  std::vector<T> means = values<T>(1, 3 * kCount, -4, 4), log_scales = values<T>(2, 3 * kCount, -4, 0), quats = values<T>(3, 4 * kCount, -1, 1),
                 logits = values<T>(4, kCount, -4, 6), sh, depth_limit = values<T>(5, kPixels, 1, 9);
  std::vector<uint8_t> masks;

  explicit Scene(int32_t stored) : coefficients(stored), sh(values<T>(6, 3 * kCount * stored, -1, 1)) {
    for (int i = 0; i < kCount; ++i) means[3 * i + 2] += 4, masks.push_back(mix(i) % 4 > 0);
    means[31] = std::numeric_limits<T>::quiet_NaN(), log_scales[61] = 200, logits[33] = std::numeric_limits<T>::infinity();  // such are not drawn
    for (int k = 0; k < 4; ++k) quats[4 * 44 + k] = 0;
    for (int k = 0; k < 3; ++k) log_scales[3 * 55 + k] = 2;  // covers the image
  }

  svrgs_scene view() const { return {kCount, coefficients, means.data(), log_scales.data(), quats.data(), logits.data(), sh.data(), masks.data()}; }
};

// Turned by the angle whose cosine is 0.8, with square pixels or not, and an optical axis beside the centre.
inline svrgs_camera camera(int32_t orthographic) {
  svrgs_camera c = {{0.8, 0, 0.6, -2.25, 0, 1, 0, 0.125, -0.6, 0, 0.8, 1.5, 0, 0, 0, 1}, 60, 55, 33.5, 26.25, kWidth, kHeight, orthographic, {0.25, 0.5, 0.75}};
  if (orthographic) c.fx = 9, c.fy = 8;
  return c;
}

// A finite scene, what views see of it, and room for the operations.
struct Decimation {
  static constexpr int32_t kRows = 400, kLeast = 10, kCoefficients = 4;
  std::vector<float> means = values<float>(80, 3 * kRows, -4, 4), log_scales = values<float>(81, 3 * kRows, -3, 0), quats = values<float>(82, 4 * kRows, 1, 3),
                     logits = values<float>(83, kRows, -4, 4), sh = values<float>(84, 3 * kRows * kCoefficients, -1, 1);
  std::vector<double> visibility = values<double>(85, kRows* SVRGS_VISIBILITY, 0, 9);
  std::vector<uint32_t> a = std::vector<uint32_t>(kRows), b = a;
  std::vector<float> costs = std::vector<float>(kRows), to_means = std::vector<float>(3 * kRows), to_scales = to_means,
                     to_quats = std::vector<float>(4 * kRows), to_logits = costs, to_sh = std::vector<float>(3 * kRows * kCoefficients);

  svrgs_decimation scene() const {
    return {kRows, kCoefficients, 0, means.data(), log_scales.data(), quats.data(), logits.data(), sh.data(), visibility.data(), {0, 0, 0}, 0.0625, kLeast};
  }
  svrgs_merges merges() { return {a.data(), b.data(), costs.data(), to_means.data(), to_scales.data(), to_quats.data(), to_logits.data(), to_sh.data()}; }
};

struct Triangles {
  static constexpr int kTriangles = 120;
  std::vector<float> corners = values<float>(10, 9 * kTriangles, -3, 3), colors = values<float>(11, 9 * kTriangles, 0, 1),
                     light = values<float>(12, 3 * kTriangles, 0, 1), uvs = values<float>(13, 6 * kTriangles, -1, 2);
  std::vector<int32_t> textures;
  std::vector<uint8_t> holdout, texels;
  svrgs_texture texture[2];

  Triangles() {
    for (int i = 0; i < kTriangles; ++i) textures.push_back(i % 4 - 1), holdout.push_back(i % 9 == 0);
    for (auto& t : textures) t = t > 1 ? -1 : t;
    for (int i = 0; i < kTriangles; ++i)
      for (int k = 0; k < 3; ++k) corners[9 * i + 3 * k + 2] += 5;
    for (int i = 0; i < 3 * (64 * 32 + 32 * 16 + 16 * 8 + 8 * 4 + 4 * 2 + 2 + 1); ++i) texels.push_back(static_cast<uint8_t>(mix(i)));
    texture[0] = {texels.data(), 64, 32, 1}, texture[1] = {texels.data(), 64, 32, 0};
  }

  svrgs_triangles view() const {
    return {kTriangles, corners.data(), colors.data(), light.data(), uvs.data(), textures.data(), holdout.data(), texture, 2, 0.125};
  }
};

struct Panorama {
  static constexpr int kColumns = 48, kRows = 24, kChannels = 5, kSide = 20;
  std::vector<float> image = values<float>(20, kSide * kSide * kChannels, 0, 1), sums = values<float>(21, kColumns * kRows * kChannels, 0, 1);
  std::vector<double> latitudes, longitudes, row_weights, column_weights;

  Panorama() {
    for (int i = 0; i < kRows; ++i) latitudes.push_back((i - 11.5) / 8), row_weights.push_back(i > 5 && i < 18 ? 0.5 : 0);
    for (int i = 0; i < kColumns; ++i) longitudes.push_back((i - 23.5) / 8), column_weights.push_back(i > 18 && i < 29 ? 0.75 : 0);
  }

  svrgs_view view() const { return {image.data(), kSide, kSide, kChannels, 3, {0.8, 0, 0.6, 0, 1, 0, -0.6, 0, 0.8}, 8, 9.5, 10.25}; }
  svrgs_panorama picture() { return {sums.data(), kColumns, kRows, latitudes.data(), row_weights.data(), longitudes.data(), column_weights.data()}; }
};

}  // namespace digests

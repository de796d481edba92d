#include "triangles.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "constants.h"
#include "pool.h"
#include "texture.h"

namespace svrgs {
namespace {

constexpr int kSamples = 8;                                          // per pixel; no two in one row or column of sixteenths
constexpr double kSampleX[kSamples] = {1, -1, 5, -3, -5, -7, 3, 7};  // from the pixel's centre, in sixteenths; their mean is the centre
constexpr double kSampleY[kSamples] = {-3, 3, 1, -5, 5, -1, 7, -7};
constexpr double kSixteenth = 1.0 / 16;
constexpr float kLayerGap = 1.01f;        // two samples are in two layers if the ratio of their depths is larger
constexpr int64_t kBandPixels = 1 << 16;  // of rows that are drawn together, at most
constexpr int kBandRows = 32;             // at most
constexpr int64_t kTriangleGrain = 8192;  // triangles
constexpr int32_t kNoTriangle = -1;
constexpr float kEmpty = std::numeric_limits<float>::infinity();

using Point = std::array<double, 3>;

Point cross(const Point& a, const Point& b) { return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]}; }

double dot(const Point& a, const Point& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// The corners of a triangle: (x w, y w, w) for the pixel (x, y), with w = z in perspective and 1 along parallel rays; and camera z.
struct Corners {
  Point pixel[3];
  Point depth;
};

Corners corners_of(const svrgs_triangles& t, const svrgs_camera& camera, int64_t number) {
  Corners c;
  for (int k = 0; k < 3; ++k) {
    const float* const at = t.corners + 9 * number + 3 * k;
    const auto row = [&](int j) {
      const double* const v = camera.viewmat + 4 * j;
      return v[0] * double{at[0]} + v[1] * double{at[1]} + v[2] * double{at[2]} + v[3];
    };
    c.depth[k] = row(2);
    const double w = camera.orthographic ? 1 : c.depth[k];
    c.pixel[k] = {camera.fx * row(0) + camera.cx * w, camera.fy * row(1) + camera.cy * w, w};
  }
  return c;
}

// A triangle in homogeneous pixel coordinates (Olano and Greer 1997). Edge k is a linear function of the pixel that is positive inside, 0
// on the side opposite to corner k. Edge k over the sum of the edges is the share of corner k in every value at the pixel, in perspective
// too. Nothing needs clipping. Two triangles have exactly opposite edges on their common side, so each sample on it belongs to one.
struct Outline {
  Point edge[3], sum;
  double volume;  // over the sum of the edges: camera z, in perspective
  Point depth;    // of the corners
  bool parallel;
  bool front;  // the camera sees the side to which (corner 1 - corner 0) x (corner 2 - corner 0) points
  bool valid;

  double depth_at(const Point& shares, double total) const { return parallel ? dot(shares, depth) / total : volume / total; }
};

Outline outline_of(const svrgs_triangles& t, const svrgs_camera& camera, int64_t number) {
  const Corners c = corners_of(t, camera, number);
  Outline o;
  for (int k = 0; k < 3; ++k) o.edge[k] = cross(c.pixel[(k + 1) % 3], c.pixel[(k + 2) % 3]);
  const double volume = dot(o.edge[0], c.pixel[0]);
  o.valid = std::isfinite(volume) && volume != 0;
  o.front = volume < 0;
  for (int j = 0; j < 3; ++j) {
    for (auto& e : o.edge) e[j] = volume < 0 ? -e[j] : e[j];
    o.sum[j] = o.edge[0][j] + o.edge[1][j] + o.edge[2][j];
  }
  o.volume = std::abs(volume), o.depth = c.depth, o.parallel = camera.orthographic;
  return o;
}

struct Rows {  // of pixels
  uint16_t begin, end;
};

// Rows in which the part of a triangle in front of the camera may be; none if it is beside the image.
Rows rows_of(const svrgs_triangles& t, const svrgs_camera& camera, int64_t number) {
  const Corners c = corners_of(t, camera, number);
  const double near = 1e-6 * std::max({c.depth[0], c.depth[1], c.depth[2]});
  double low[2] = {kEmpty, kEmpty}, high[2] = {-kEmpty, -kEmpty};
  const auto add = [&](double x, double y, double w) {
    for (int j = 0; j < 2; ++j) low[j] = std::min(low[j], (j ? y : x) / w), high[j] = std::max(high[j], (j ? y : x) / w);
  };
  if (!(near > 0)) return {0, 0};
  for (int k = 0; k < 3; ++k) {
    const Point &p = c.pixel[k], &q = c.pixel[(k + 1) % 3];
    const double z = c.depth[k], next = c.depth[(k + 1) % 3], share = (near - z) / (next - z);
    if (z >= near) add(p[0], p[1], p[2]);
    if ((z < near) != (next < near)) add(p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1]), p[2] + share * (q[2] - p[2]));
  }
  if (!(low[0] < camera.width && high[0] > 0 && low[1] < camera.height && high[1] > 0)) return {0, 0};
  return {static_cast<uint16_t>(std::max(low[1], 0.0)), static_cast<uint16_t>(std::ceil(std::min(high[1], double(camera.height))))};
}

// Columns [begin, end) of a row in which a triangle may cover a sample.
Rows columns_of(const Outline& o, int row, int width) {
  double low = 0, high = width;
  for (const auto& e : o.edge) {  // in this row, the edge is at most e[0] x + top
    const double top = e[1] * (row + 0.5) + e[2] + 0.5 * (std::abs(e[0]) + std::abs(e[1]));
    if (e[0] > 0)
      low = std::max(low, -top / e[0] - 1);
    else if (e[0] < 0)
      high = std::min(high, -top / e[0] + 1);
    else if (top < 0)
      return {0, 0};
  }
  return low < high ? Rows{static_cast<uint16_t>(low), static_cast<uint16_t>(std::ceil(high))} : Rows{0, 0};
}

// The nearest triangle at each sample of some rows of the image.
struct Band {
  int first = 0, end = 0, width;
  std::vector<float> depth;
  std::vector<int32_t> triangle;

  Band(int rows, int columns) : width(columns), depth(static_cast<size_t>(rows) * columns * kSamples), triangle(depth.size()) {}

  void start(int first_row, int end_row) {
    first = first_row, end = end_row;
    std::fill(depth.begin(), depth.end(), kEmpty);
    std::fill(triangle.begin(), triangle.end(), kNoTriangle);
  }
  int64_t place(int row, int column) const { return (int64_t{row - first} * width + column) * kSamples; }
};

void draw(const Outline& o, int32_t number, Rows rows, Band& band) {
  double offset[3][kSamples];
  bool closed[3];  // the side itself belongs to this triangle, not to its neighbour
  for (int k = 0; k < 3; ++k) {
    closed[k] = o.edge[k][0] > 0 || (o.edge[k][0] == 0 && o.edge[k][1] > 0);
    for (int s = 0; s < kSamples; ++s) offset[k][s] = kSixteenth * (o.edge[k][0] * kSampleX[s] + o.edge[k][1] * kSampleY[s]);
  }
  for (int row = std::max<int>(rows.begin, band.first), end = std::min<int>(rows.end, band.end); row < end; ++row) {
    const Rows span = columns_of(o, row, band.width);
    for (int column = span.begin; column < span.end; ++column) {
      double edge[3][kSamples];
      unsigned inside = (1u << kSamples) - 1;
      for (int k = 0; k < 3; ++k) {
        const double middle = o.edge[k][0] * (column + 0.5) + o.edge[k][1] * (row + 0.5) + o.edge[k][2];
        unsigned positive = 0;
        for (int s = 0; s < kSamples; ++s) {
          edge[k][s] = middle + offset[k][s];
          positive |= static_cast<unsigned>(closed[k] ? edge[k][s] >= 0 : edge[k][s] > 0) << s;
        }
        inside &= positive;
      }
      for (; inside; inside &= inside - 1) {
        const int s = std::countr_zero(inside);
        const Point shares = {edge[0][s], edge[1][s], edge[2][s]};
        const auto z = static_cast<float>(o.depth_at(shares, shares[0] + shares[1] + shares[2]));
        const int64_t at = band.place(row, column) + s;
        if (z > 0 && z < band.depth[at]) band.depth[at] = z, band.triangle[at] = number;
      }
    }
  }
}

// Linear colour of a triangle at a pixel, lit.
Point shaded(const svrgs_triangles& t, const svrgs_camera& camera, int64_t number, double x, double y) {
  const Outline o = outline_of(t, camera, number);
  const Point here = {x, y, 1};
  const double total = dot(o.sum, here);
  const Point shares = {dot(o.edge[0], here) / total, dot(o.edge[1], here) / total, dot(o.edge[2], here) / total};
  const float *const colors = t.colors + 9 * number, *const light = t.light + 3 * number;
  const double turned = dot(shares, {light[0], light[1], light[2]}), brightness = std::max(0.0, t.ambient + (o.front ? turned : -turned));
  Point rgb;
  for (int c = 0; c < 3; ++c) rgb[c] = brightness * dot(shares, {colors[c], colors[3 + c], colors[6 + c]});
  if (!t.textures || t.textures[number] < 0) return rgb;
  const float* const uv = t.uvs + 6 * number;
  const Point u = {uv[0], uv[2], uv[4]}, v = {uv[1], uv[3], uv[5]};
  const double u_here = dot(shares, u), v_here = dot(shares, v);
  const auto slope = [&](const Point& values, double value, int j) {  // derivative of a value at the corners by the pixel's x or y
    return (o.edge[0][j] * values[0] + o.edge[1][j] * values[1] + o.edge[2][j] * values[2] - value * o.sum[j]) / total;
  };
  Point texel;
  sample_texture(t.texture[t.textures[number]], u_here, v_here, {slope(u, u_here, 0), slope(v, v_here, 0), slope(u, u_here, 1), slope(v, v_here, 1)},
                 texel.data());
  for (int c = 0; c < 3; ++c) rgb[c] *= texel[c];
  return rgb;
}

struct Sample {
  float depth;
  int32_t triangle;
  int place;
};

// Writes one layer of a pixel from its samples: the mean of their depths and colours. A triangle is shaded once, at the mean of its samples.
void write_layer(const svrgs_triangles& t, const svrgs_camera& camera, const Sample* samples, int count, int row, int column, float* depth, float* rgba) {
  double z = 0, rgb[3] = {};
  int shown = 0;
  bool done[kSamples] = {};
  for (int s = 0; s < count; ++s) {
    z += static_cast<double>(samples[s].depth) / count;
    const int32_t number = samples[s].triangle;
    if (done[s] || number == kNoTriangle || t.holdout[number]) continue;
    double x = 0, y = 0;
    int same = 0;
    for (int other = s; other < count; ++other)
      if (samples[other].triangle == number) {
        done[other] = true, ++same;
        x += kSampleX[samples[other].place], y += kSampleY[samples[other].place];
      }
    const Point colour = shaded(t, camera, number, column + 0.5 + kSixteenth * x / same, row + 0.5 + kSixteenth * y / same);
    for (int c = 0; c < 3; ++c) rgb[c] += same * colour[c];
    shown += same;
  }
  *depth = static_cast<float>(z);
  const float alpha = static_cast<float>(shown) / static_cast<float>(count);
  for (int c = 0; c < 3; ++c) rgba[c] = shown ? alpha * srgb_of_linear(rgb[c] / shown) : 0;
  rgba[3] = alpha;
}

// How many of a pixel's samples, which it sorts by depth, are in the front layer: those before the largest gap, if that is large enough.
int front_layer(Sample (&samples)[kSamples]) {
  const int32_t first = samples[0].triangle;
  if (std::all_of(samples, samples + kSamples, [first](const Sample& s) { return s.triangle == first; })) return kSamples;
  std::stable_sort(samples, samples + kSamples, [](const Sample& a, const Sample& b) { return a.depth < b.depth; });
  int front = kSamples;
  float largest = kLayerGap;
  for (int s = 1; s < kSamples; ++s)
    if (samples[s].depth > largest * samples[s - 1].depth) front = s, largest = samples[s].depth / samples[s - 1].depth;
  return front;
}

void write_pixel(const svrgs_triangles& t, const svrgs_camera& camera, const Band& band, int row, int column, const svrgs_layers& out) {
  Sample samples[kSamples];
  const int64_t at = band.place(row, column);
  for (int s = 0; s < kSamples; ++s) samples[s] = {band.depth[at + s], band.triangle[at + s], s};
  const int front = front_layer(samples);
  const int64_t pixel = int64_t{row} * camera.width + column, second = int64_t{camera.height} * camera.width + pixel;
  out.share[pixel] = static_cast<float>(front) / kSamples;
  write_layer(t, camera, samples, front, row, column, out.depth + pixel, out.rgba + 4 * pixel);
  if (front < kSamples) return write_layer(t, camera, samples + front, kSamples - front, row, column, out.depth + second, out.rgba + 4 * second);
  out.depth[second] = kEmpty;
  std::fill_n(out.rgba + 4 * second, 4, 0.0f);
}

}  // namespace

void draw_triangles(const svrgs_triangles& t, const svrgs_camera& camera, const svrgs_layers& out) {
  const auto rows = std::make_unique_for_overwrite<Rows[]>(t.count);
  parallel_blocks(t.count, kTriangleGrain, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) rows[i] = rows_of(t, camera, i);
  });
  const int height = static_cast<int>(std::clamp<int64_t>(kBandPixels / camera.width, 1, kBandRows)), count = (camera.height + height - 1) / height;
  std::vector<Band> bands(std::min(threads(), count), Band(height, camera.width));  // here, as tasks must not throw
  std::atomic<int> next = 0;
  parallel_for(static_cast<int64_t>(bands.size()), [&](int64_t worker) {
    Band& band = bands[worker];
    for (int number = next++; number < count; number = next++) {
      band.start(number * height, std::min(camera.height, (number + 1) * height));
      for (int64_t i = 0; i < t.count; ++i) {
        if (rows[i].end <= band.first || rows[i].begin >= band.end) continue;
        const Outline o = outline_of(t, camera, i);
        if (o.valid) draw(o, static_cast<int32_t>(i), rows[i], band);
      }
      for (int row = band.first; row < band.end; ++row)
        for (int column = 0; column < camera.width; ++column) write_pixel(t, camera, band, row, column, out);
    }
  });
}

}  // namespace svrgs

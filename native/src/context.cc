#include "context.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstring>
#include <numeric>

#include "pool.h"

namespace svrgs {
namespace {

constexpr int64_t kProjectGrain = 2048;  // Gaussians per projection chunk
constexpr int64_t kVisibleGrain = 1024;
constexpr int64_t kMaskLossGrain = 16384;  // pixels
constexpr int64_t kMostBinPairs = 65536;   // (Gaussian, tile) pairs of a bin, on average
constexpr int64_t kPairsOfFewBins = 4096;  // the same, times the number of bins, where they are few

using Time = std::chrono::steady_clock::time_point;
double seconds_between(Time begin, Time end) { return std::chrono::duration<double>(end - begin).count(); }

PixelWindow window_of(const uint8_t* valid, int width, int height) {
  if (!valid) return {0, 0, width, height};
  PixelWindow w = {width, height, 0, 0};
  for (int y = 0; y < height; ++y, valid += width) {
    const int first = static_cast<int>(std::find_if(valid, valid + width, [](uint8_t v) { return v; }) - valid);
    if (first == width) continue;
    int last = width;
    while (!valid[last - 1]) --last;
    w = {std::min(w.left, first), std::min(w.top, y), std::max(w.right, last), y + 1};
  }
  return w;
}

int64_t chunk_count(int64_t items, int64_t grain) { return (items + grain - 1) / grain; }

}  // namespace

void Context::set_frame(const svrgs_scene& s, const svrgs_camera& c, const svrgs_options& o, const svrgs_images& images) {
  Frame& f = frame_;
  f = {};
  f.count = s.count;
  f.sh_coefficients = s.sh_coefficients;
  f.sh_degree = o.sh_degree;
  f.means = s.means, f.log_scales = s.log_scales, f.quats = s.quats, f.opacity_logits = s.opacity_logits, f.sh = s.sh;
  f.masks = s.masks;
  std::memcpy(f.viewmat, c.viewmat, sizeof f.viewmat);
  for (int k = 0; k < 3; ++k) {  // -R^T t
    f.position[k] = -(c.viewmat[k] * c.viewmat[3] + c.viewmat[4 + k] * c.viewmat[7] + c.viewmat[8 + k] * c.viewmat[11]);
    f.background[k] = c.background[k];
  }
  f.fx = c.fx, f.fy = c.fy, f.cx = c.cx, f.cy = c.cy;
  f.near_depth = c.near_depth > 0 ? c.near_depth : kNear;
  f.orthographic = c.orthographic;
  f.width = c.width, f.height = c.height;
  f.antialiased = o.antialiased, f.mask_kind = o.mask_kind, f.eps_a = o.eps_a, f.stop = std::max(o.stop, kStop), f.disabled_skips = o.disabled_skips;
  f.depth_limit = o.depth_limit, f.valid = o.valid, f.window = window_of(o.valid, c.width, c.height);
  f.picture_only = o.picture_only || o.depth_limit;
  f.full = o.full && o.mask_kind != SVRGS_MASK_NONE;
  f.want_depth = images.depth != nullptr;
}

void Context::project() {
  Frame& f = frame_;
  f.gaussians = gaussians_.reserve<char>(f.count * kernels_.gaussian_size);
  f.rects = rects_.reserve<TileRect>(f.count);
  uint32_t *ids = ids_.reserve<uint32_t>(f.count), *keys = depth_keys_.reserve<uint32_t>(f.count);
  chunk_counts_.resize(chunk_count(f.count, kProjectGrain)), before_.resize(chunk_counts_.size());
  parallel_blocks(f.count, kProjectGrain,
                  [&](int64_t begin, int64_t end) { chunk_counts_[begin / kProjectGrain] = kernels_.project_range(f, begin, end, ids, keys); });
  f.visible_count = sum_before(&ProjectionCounts::visible);
}

// Finds the exact tiles of every visible Gaussian; makes the lists of visible ids and places.
void Context::find_tiles(int64_t max_pairs) {
  Frame& f = frame_;
  const int64_t limit = max_pairs > 0 ? max_pairs : INT32_MAX;
  const auto too_large = [&](int64_t n) {
    if (n > limit)
      throw Failure{SVRGS_TOO_LARGE, "the view needs " + std::to_string(n) + " (Gaussian, tile) pairs, more than the limit of " + std::to_string(limit)};
  };
  const int64_t rows = sum_before(&ProjectionCounts::rows);
  too_large(rows);
  const uint32_t* const ids = ids_.reserve<uint32_t>(f.count);
  uint32_t *visible = visible_.reserve<uint32_t>(f.visible_count), *places = places_.reserve<uint32_t>(f.visible_count);
  f.visible = visible, f.places = places;
  f.tiles = tiles_.reserve<GaussianTiles>(f.count);
  f.spans = spans_.reserve<Span>(rows);
  parallel_for(static_cast<int64_t>(chunk_counts_.size()), [&](int64_t c) {
    const int64_t begin = c * kProjectGrain, end = begin + chunk_counts_[c].visible;
    int64_t row = before_[c].rows, i = before_[c].visible;
    chunk_counts_[c].pairs = kernels_.fill_spans(f, begin, end, f.spans + row);
    for (int64_t place = begin; place < end; ++place, ++i) {
      visible[i] = ids[place], places[i] = static_cast<uint32_t>(place);
      f.tiles[place].span = static_cast<uint32_t>(row);
      row += span_rows(f.rects[place]);
    }
  });
  pairs_ = sum_before(&ProjectionCounts::pairs);
  too_large(pairs_);
}

// Exclusive prefix sums over the chunks of projection; returns the total.
int64_t Context::sum_before(int64_t ProjectionCounts::* what) {
  int64_t sum = 0;
  for (size_t c = 0; c < chunk_counts_.size(); ++c) before_[c].*what = sum, sum += chunk_counts_[c].*what;
  return sum;
}

// A bin with too many pairs does not fit into the caches, and where there are few bins, threads wait for the last one: then a bin is a tile.
void Context::choose_bins() {
  Frame& f = frame_;
  const auto along = [](int pixels, int side) { return (pixels + side * kTile - 1) / (side * kTile); };
  const int64_t bins = int64_t{along(f.width, kBin)} * along(f.height, kBin);
  f.bin_side = pairs_ > bins * std::min(kMostBinPairs, bins * kPairsOfFewBins) ? 1 : kBin;
  f.bins_x = along(f.width, f.bin_side), f.bins_y = along(f.height, f.bin_side);
}

void Context::fill_bins() {
  Frame& f = frame_;
  choose_bins();
  parts_.resize(chunk_counts_.size());
  for (size_t c = 0; c < parts_.size(); ++c) {
    const int64_t begin = static_cast<int64_t>(c) * kProjectGrain;
    parts_[c] = {begin, begin + chunk_counts_[c].visible, before_[c].pairs, 0};
  }
  BinEntry* const written = slots_.reserve<BinEntry>(3 * pairs_);
  uint64_t* const keys = reinterpret_cast<uint64_t*>(written + 2 * pairs_);
  lists_ = {f.bin_tiles(),
            f.bin_side == 1 && f.picture_only,
            written,
            written + pairs_,
            keys,
            keys + pairs_,
            counts_.reserve<BinCount>(listing_groups(parts_) * f.bin_count()),
            bin_begin_.reserve<int64_t>(f.bin_count() + 1),
            tile_begin_.reserve<int64_t>(f.tile_count() + 1),
            entries_.reserve<TileEntry>(pairs_)};
  svrgs::fill_bins(f, parts_, depth_keys_.reserve<uint32_t>(f.count), lists_);
  f.tile_begin = lists_.tile_begin, f.entries = lists_.entries;
}

bool Context::cancelled() const { return cancel_ && __atomic_load_n(cancel_, __ATOMIC_RELAXED); }

template <class F>
void Context::for_each_tile(F&& run) const {
  std::atomic<bool> stopped{false};
  parallel_for(frame_.tile_count(), [&](int64_t tile) {
    if (cancelled()) stopped.store(true, std::memory_order_relaxed);
    if (frame_.in_image(frame_.tile_origin(tile)) && !stopped.load(std::memory_order_relaxed)) run(tile);
  });
  if (stopped) throw Failure{SVRGS_CANCELLED, "cancelled"};
}

// Sorts the bins and blends their tiles, in one job: no thread waits for the last bin before it blends the tiles of the first ones. Without gradients or
// statistics to come, each thread needs the pixels of one tile at a time.
void Context::list_and_blend(const svrgs_images& images) {
  const int64_t bins = frame_.bin_count(), tile_bytes = kTileState * kernels_.real_size;
  uint8_t* const listed = listed_.reserve<uint8_t>(bins);
  std::fill_n(listed, bins, uint8_t{0});
  std::atomic<int64_t> left{bins};
  std::atomic<bool> stopped{false};
  const auto begun = std::chrono::steady_clock::now();
  auto all_listed = begun;
  if (!frame_.picture_only) frame_.hits = hits_.reserve<BlockMask>(pairs_), frame_.state = state_.reserve<char>(frame_.tile_count() * tile_bytes);
  const auto prepare = [&](int workers) {
    if (frame_.picture_only) frame_.state = state_.reserve<char>(workers * tile_bytes);
  };
  parallel_for_workers(bins + frame_.tile_count(), prepare, [&](int64_t task, int worker) {
    if (task < bins) {
      list_bin(lists_, task);
      __atomic_store_n(listed + task, 1, __ATOMIC_RELEASE);
      if (--left == 0) all_listed = std::chrono::steady_clock::now();
      return;
    }
    const int64_t tile = task - bins;
    wait_for_earlier_task([&] { return __atomic_load_n(listed + tile / frame_.bin_tiles(), __ATOMIC_ACQUIRE); });
    if (cancelled()) stopped.store(true, std::memory_order_relaxed);
    if (!frame_.in_image(frame_.tile_origin(tile)) || stopped.load(std::memory_order_relaxed)) return;
    const auto draw = [&](const Frame& f) { kernels_.forward_tile(f, tile), kernels_.write_tile(f, tile, images); };
    if (!frame_.picture_only) return draw(frame_);
    Frame own = frame_;
    own.state = static_cast<char*>(own.state) + worker * tile_bytes;
    draw(own);
  });
  seconds_[SVRGS_SORT] += seconds_between(begun, all_listed), seconds_[SVRGS_BLEND] = seconds_between(all_listed, std::chrono::steady_clock::now());
  if (stopped) throw Failure{SVRGS_CANCELLED, "cancelled"};
}

template <class F>
void Context::timed(svrgs_stage stage, F&& run) {
  const auto begin = std::chrono::steady_clock::now();
  run();
  seconds_[stage] = seconds_between(begin, std::chrono::steady_clock::now());
}

void Context::forward(const svrgs_scene& s, const svrgs_camera& c, const svrgs_options& o, const svrgs_images& images) {
  holds_view_ = scored_ = false;
  set_frame(s, c, o, images);
  cancel_ = o.cancel;
  timed(SVRGS_PROJECT, [&] { project(); });
  timed(SVRGS_TILES, [&] { find_tiles(o.max_pairs); });
  timed(SVRGS_SORT, [&] { fill_bins(); });
  list_and_blend(images);
  holds_view_ = !o.picture_only;
}

// Memory for this number of values for each (Gaussian, tile) pair. It may no longer hold scores.
char* Context::slots_of(int values) {
  scored_ = false;
  return slots_.reserve<char>(pairs_ * values * kernels_.real_size);
}

int64_t Context::backward(const svrgs_image_grads& in, const svrgs_grads& out, const svrgs_update* update) {
  char* const slots = slots_of(kSlotWidth);
  timed(SVRGS_RASTER_GRADS, [&] { for_each_tile([&](int64_t tile) { kernels_.backward_tile(frame_, in, out, update, tile, slots); }); });
  std::atomic<int64_t> nonfinite{0};
  timed(SVRGS_PARAMETER_GRADS, [&] {
    if (update && update->frozen) leave_out(update->frozen);
    parallel_blocks(frame_.visible_count, kVisibleGrain,
                    [&](int64_t begin, int64_t end) { nonfinite += kernels_.gradients_range(frame_, in, out, update, slots, begin, end); });
  });
  if (update) holds_view_ = false;
  return nonfinite;
}

// From here on, the visible Gaussians are those that are not frozen.
void Context::leave_out(const uint8_t* frozen) {
  uint32_t* const visible = visible_.reserve<uint32_t>(frame_.visible_count);
  uint32_t* const places = places_.reserve<uint32_t>(frame_.visible_count);
  int64_t left = 0;
  for (int64_t i = 0; i < frame_.visible_count; ++i) {
    visible[left] = visible[i], places[left] = places[i];
    left += !frozen[visible[left]];
  }
  frame_.visible_count = left;
}

void Context::scores(const uint8_t* valid, const Scores& out) {
  const bool known = scored_;
  char* const slots = out.sums() ? slots_of(kScoreValues) : nullptr;
  Frame f = frame_;
  if (valid) f.valid = valid;
  if (slots) for_each_tile([&](int64_t tile) { kernels_.scores_tile(f, tile, known, slots); });
  scored_ = slots && !f.valid && !cancelled();
  parallel_blocks(f.visible_count, kVisibleGrain, [&](int64_t begin, int64_t end) { kernels_.scores_range(f, slots, begin, end, out); });
}

void Context::moments(double* rows) {
  char* const slots = slots_of(SVRGS_MOMENTS);
  for_each_tile([&](int64_t tile) { kernels_.moments_tile(frame_, tile, slots); });
  parallel_blocks(frame_.visible_count, kVisibleGrain, [&](int64_t begin, int64_t end) { kernels_.moments_range(frame_, slots, begin, end, rows); });
}

void Context::visibility(double* sums) {
  char* const slots = slots_of(kSlotWidth);
  for_each_tile([&](int64_t tile) { kernels_.visibility_tile(frame_, tile, slots); });
  parallel_blocks(frame_.visible_count, kVisibleGrain, [&](int64_t begin, int64_t end) { kernels_.visibility_range(frame_, slots, begin, end, sums); });
}

// Adds one number per pair, which run(tile, slots) writes, to out (N,).
template <class F>
void Context::add_sums(double* out, F&& run) {
  char* const slots = slots_of(1);
  for_each_tile([&](int64_t tile) { run(tile, slots); });
  parallel_blocks(frame_.visible_count, kVisibleGrain, [&](int64_t begin, int64_t end) { kernels_.sums_range(frame_, slots, begin, end, out); });
}

void Context::removal(const void* residuals, double* cost) {
  add_sums(cost, [&](int64_t tile, void* slots) { kernels_.removal_tile(frame_, tile, residuals, slots); });
}

void Context::slopes(double* sums) {
  add_sums(sums, [&](int64_t tile, void* slots) { kernels_.slopes_tile(frame_, tile, slots); });
}

void Context::dominance(double* pixels) {
  add_sums(pixels, [&](int64_t tile, void* slots) { kernels_.dominance_tile(frame_, tile, slots); });
}

svrgs_work Context::work(bool count_pixels) const {
  svrgs_work work = {};
  work.visible = frame_.visible_count, work.pairs = pairs_;
  for (int64_t tile = 0, tiles = frame_.tile_count(); count_pixels && tile < tiles; ++tile) kernels_.count_tile(frame_, tile, work);
  return work;
}

// Returns the rows left alone.
int64_t Context::adam(const svrgs_adam_settings& settings, void* param, void* moments, const void* grad, const uint32_t* ids, int64_t rows, int width) {
  std::atomic<int64_t> nonfinite{0};
  timed(SVRGS_ADAM, [&] {
    parallel_blocks(rows, kVisibleGrain,
                    [&](int64_t begin, int64_t end) { nonfinite += kernels_.adam_rows(settings, param, moments, grad, ids, begin, end, width); });
  });
  return nonfinite;
}

void Context::loss(const void* image, const void* target, int height, int width, double l1_weight, double ssim_weight, void* grad, double values[2]) {
  timed(SVRGS_LOSS, [&] { loss_tiles(image, target, height, width, l1_weight, ssim_weight, grad, values); });
}

void Context::loss_tiles(const void* image, const void* target, int height, int width, double l1_weight, double ssim_weight, void* grad, double values[2]) {
  const int64_t row = 3 * static_cast<int64_t>(width);
  const double values_in = static_cast<double>(row * height);
  const int64_t down = chunk_count(height, kLossTileRows), across = chunk_count(row, kLossTileValues), tiles = down * across;
  const int64_t tile_row = chunk_count(row, across * 16) * 16;  // equal shares, in whole vectors
  double* tile_values = tile_values_.reserve<double>(2 * tiles);
  const int64_t own = kernels_.loss_scratch * kernels_.real_size;
  char* scratch = nullptr;
  const LossArguments a = {
      image, target, height, row, tile_row, across, l1_weight / values_in, -ssim_weight / values_in, grad, tile_values, tile_values + tiles};
  parallel_for_workers(
      tiles, [&](int workers) { scratch = loss_scratch_.reserve<char>(workers * own); },
      [&](int64_t tile, int worker) { kernels_.loss_tile(a, tile, scratch + worker * own); });
  values[0] = values[1] = 0;
  for (int64_t t = 0; t < tiles; ++t) values[0] += a.tile_l1[t], values[1] += a.tile_ssim[t];
  values[0] /= values_in, values[1] /= values_in;
}

double Context::mask_loss(const void* mask, int64_t count, double weight, void* grad) {
  double* const sums = tile_values_.reserve<double>(chunk_count(count, kMaskLossGrain));
  const double scale = 2 * weight / static_cast<double>(count);
  parallel_blocks(count, kMaskLossGrain,
                  [&](int64_t begin, int64_t end) { sums[begin / kMaskLossGrain] = kernels_.mask_loss_range(mask, scale, begin, end, grad); });
  return std::accumulate(sums, sums + chunk_count(count, kMaskLossGrain), 0.0) / static_cast<double>(count);
}

}  // namespace svrgs

#include "tiles.h"

#include <algorithm>

#include "pool.h"

namespace svrgs {
namespace {

constexpr int kRadixBits = 11, kRadix = 1 << kRadixBits, kPasses = 3;  // 33 bits cover the 32 of a key
constexpr int64_t kSortChunks = 8;
constexpr int64_t kAhead = 12;  // sorted Gaussians fetched before they are needed

void radix_pass(const Keyed* from, Keyed* to, int64_t count, int shift) {
  static thread_local uint32_t offsets[kSortChunks][kRadix];
  uint32_t(*offset)[kRadix] = offsets;  // workers write the caller's table
  const int64_t grain = (count + kSortChunks - 1) / kSortChunks;
  const auto digit = [shift](const Keyed& k) { return k.key >> shift & (kRadix - 1); };
  parallel_for(kSortChunks, [&](int64_t c) {
    std::fill_n(offset[c], kRadix, 0u);
    for (int64_t i = c * grain, end = std::min(count, i + grain); i < end; ++i) ++offset[c][digit(from[i])];
  });
  uint32_t total = 0;
  for (int d = 0; d < kRadix; ++d)
    for (int64_t c = 0; c < kSortChunks; ++c) {
      const uint32_t n = offset[c][d];
      offset[c][d] = total;
      total += n;
    }
  parallel_for(kSortChunks, [&](int64_t c) {
    for (int64_t i = c * grain, end = std::min(count, i + grain); i < end; ++i) to[offset[c][digit(from[i])]++] = from[i];
  });
}

// Calls visit(tile, k) for the k-th tile of a Gaussian, in row order.
template <class F>
void for_tiles(const Frame& f, uint32_t place, F&& visit) {
  const SplatTiles& t = f.tiles[place];
  uint32_t k = 0;
  const Span* spans = t.rows > 1 ? f.spans + t.span : &t.columns;
  for (int r = 0; r < t.rows; ++r) {
    const Span s = spans[r];
    for (int x = s.begin; x < s.end; ++x) visit(static_cast<int64_t>(t.row + r) * f.tiles_x + x, k++);
  }
}

}  // namespace

Keyed* sort_by_depth(Keyed* items, Keyed* scratch, int64_t count) {
  for (int pass = 0; pass < kPasses; ++pass) {
    radix_pass(items, scratch, count, pass * kRadixBits);
    std::swap(items, scratch);
  }
  return items;
}

int64_t binning_chunks(int64_t visible) { return std::clamp<int64_t>(visible / 4096, 1, 16); }

void bin_tiles(const Frame& f, const Keyed* sorted, int64_t* tile_begin, TileEntry* entries, uint32_t* counts) {
  const int64_t tiles = static_cast<int64_t>(f.tiles_x) * f.tiles_y, chunks = binning_chunks(f.visible_count);
  const int64_t grain = (f.visible_count + chunks - 1) / chunks;
  const auto range = [&](int64_t c, auto&& visit) {
    for (int64_t i = c * grain, end = std::min(f.visible_count, i + grain); i < end; ++i) {
      if (i + 2 * kAhead < end) __builtin_prefetch(f.tiles + sorted[i + 2 * kAhead].place);
      if (i + kAhead < end) __builtin_prefetch(f.spans + f.tiles[sorted[i + kAhead].place].span);
      visit(sorted[i].place);
    }
  };
  parallel_for(chunks, [&](int64_t c) {
    uint32_t* count = counts + c * tiles;
    std::fill_n(count, tiles, 0u);
    range(c, [&](uint32_t place) { for_tiles(f, place, [&](int64_t tile, uint32_t) { ++count[tile]; }); });
  });
  uint32_t total = 0;
  for (int64_t tile = 0; tile < tiles; ++tile) {
    tile_begin[tile] = total;
    for (int64_t c = 0; c < chunks; ++c) {
      const uint32_t n = counts[c * tiles + tile];
      counts[c * tiles + tile] = total;
      total += n;
    }
  }
  tile_begin[tiles] = total;
  parallel_for(chunks, [&](int64_t c) {
    uint32_t* next = counts + c * tiles;
    range(c, [&](uint32_t place) {
      for_tiles(f, place, [&](int64_t tile, uint32_t k) { entries[next[tile]++] = {place, f.tiles[place].slot + k}; });
    });
  });
}

}  // namespace svrgs

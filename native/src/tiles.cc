#include "tiles.h"

#include <algorithm>
#include <bit>
#include <utility>

#include "pool.h"

namespace svrgs {
namespace {

constexpr int kMaxDigitBits = 11;       // of a digit
constexpr int64_t kMaxMovesPerKey = 8;  // moves for each item before another way is taken

// Sort key of an entry of a tile's list: depth, then slot. No two are equal, and equal depths are in the order of slots. The order of places is
// the same, so the key of a picture that needs no slots has the place instead.
uint64_t entry_key(uint32_t depth_key, int64_t index) { return static_cast<uint64_t>(depth_key) << 32 | static_cast<uint64_t>(index); }

// For keys that are nearly sorted.
void sort_by_insertion(uint64_t* keys, int64_t n) {
  int64_t moves = 0;
  for (int64_t i = 1; i < n; ++i) {
    const uint64_t key = keys[i];
    int64_t j = i;
    for (; j && keys[j - 1] > key; --j) keys[j] = keys[j - 1];
    keys[j] = key, moves += i - j;
    if (moves > kMaxMovesPerKey * n) return std::sort(keys, keys + n);
  }
}

// Radix sort by the two highest digits in which the depths differ; an insertion sort does the little that is left.
void sort_list(uint64_t* keys, uint64_t* scratch, int64_t n) {
  uint64_t low = ~uint64_t{0}, high = 0;
  for (int64_t i = 0; i < n; ++i) low = std::min(low, keys[i] >> 32), high = std::max(high, keys[i] >> 32);
  if (low >= high) return;  // they are in the order of slots
  const int bits = std::clamp(static_cast<int>(std::bit_width(static_cast<uint64_t>(n))) - 1, 4, kMaxDigitBits);
  const int second = std::max(static_cast<int>(std::bit_width(high - low)) - 2 * bits, 0), first = second + bits;
  const uint64_t mask = (1u << bits) - 1;
  const auto digit = [low, mask](uint64_t key, int shift) { return ((key >> 32) - low) >> shift & mask; };
  uint32_t begin[2][1 << kMaxDigitBits];
  std::fill_n(begin[0], mask + 1, 0u), std::fill_n(begin[1], mask + 1, 0u);
  for (int64_t i = 0; i < n; ++i) ++begin[0][digit(keys[i], second)], ++begin[1][digit(keys[i], first)];
  uint32_t total[2] = {};
  for (uint64_t d = 0; d <= mask; ++d)
    for (int k = 0; k < 2; ++k) total[k] += std::exchange(begin[k][d], total[k]);
  for (int64_t i = 0; i < n; ++i) scratch[begin[0][digit(keys[i], second)]++] = keys[i];
  for (int64_t i = 0; i < n; ++i) keys[begin[1][digit(scratch[i], first)]++] = scratch[i];
  sort_by_insertion(keys, n);
}

}  // namespace

void write_intersections(const Frame& f, int64_t begin, int64_t end, int64_t slot, int64_t slot_end, TileIntersection* pairs) {
  constexpr int kAtOnce = 4;  // most spans have fewer tiles: their pairs are written without a branch, and those too many are overwritten
  TileIntersection* next = pairs + slot;
  const TileIntersection* const last = pairs + slot_end;
  for (int64_t place = begin; place < end; ++place) {
    const TileRect& t = f.rects[place];
    f.tiles[place].slot = static_cast<uint32_t>(next - pairs);
    const Span* const spans = t.rows > 1 ? f.spans + f.tiles[place].span : &t.columns;
    for (uint32_t r = 0; r < t.rows; ++r) {
      const uint32_t first = (t.row + r) * static_cast<uint32_t>(f.tiles_x) + spans[r].begin, count = spans[r].end - spans[r].begin;
      uint32_t k = 0;
      if (last - next >= kAtOnce)
        for (; k < kAtOnce; ++k) next[k] = {first + k, static_cast<uint32_t>(place)};
      for (; k < count; ++k) next[k] = {first + k, static_cast<uint32_t>(place)};
      next += count;
    }
    f.tiles[place].tiles = static_cast<uint32_t>(next - pairs) - f.tiles[place].slot;
  }
}

int64_t listing_chunks(int64_t pairs) { return std::clamp<int64_t>(pairs / 8192, 1, 16); }

void list_tiles(const Frame& f, const TileIntersection* pairs, int64_t count, const uint32_t* depth_keys, uint64_t* keys, uint32_t* counts, int64_t* tile_begin,
                TileEntry* entries) {
  const int64_t tiles = f.tile_count(), chunks = listing_chunks(count), grain = (count + chunks - 1) / chunks;
  parallel_for(chunks, [&](int64_t c) {
    uint32_t* const own = counts + c * tiles;
    std::fill_n(own, tiles, 0u);
    for (int64_t p = c * grain, end = std::min(count, p + grain); p < end; ++p) ++own[pairs[p].tile];
  });
  uint32_t total = 0;
  for (int64_t tile = 0; tile < tiles; ++tile) {
    tile_begin[tile] = total;
    for (int64_t c = 0; c < chunks; ++c) total += std::exchange(counts[c * tiles + tile], total);
  }
  tile_begin[tiles] = total;
  parallel_for(chunks, [&](int64_t c) {
    uint32_t* const next = counts + c * tiles;
    for (int64_t p = c * grain, end = std::min(count, p + grain); p < end; ++p)
      keys[next[pairs[p].tile]++] = entry_key(depth_keys[pairs[p].place], f.picture_only ? pairs[p].place : p);
  });
  parallel_for(tiles, [&](int64_t tile) {
    const int64_t begin = tile_begin[tile], end = tile_begin[tile + 1];
    sort_list(keys + begin, keys + count + begin, end - begin);
    for (int64_t i = begin; i < end; ++i) {
      const uint32_t index = static_cast<uint32_t>(keys[i]);
      entries[i] = f.picture_only ? TileEntry{index, 0} : TileEntry{pairs[index].place, index};
    }
  });
}

}  // namespace svrgs

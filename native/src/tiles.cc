#include "tiles.h"

#include <algorithm>
#include <bit>
#include <utility>

#include "pool.h"

namespace svrgs {
namespace {

constexpr int64_t kMostGroups = 32;
constexpr int kMaxDigitBits = 11;       // of a digit
constexpr int64_t kMaxMovesPerKey = 8;  // moves for each item before another way is taken

// Sort key of an entry of a bin: depth, then where it is, or its place. No two are equal, and equal depths are in the order of places.
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
  if (low >= high) return;  // they are in the order of places
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

struct BinTiles {
  uint32_t bits, count;
};

// Rows [row, end) of the tiles of a Gaussian, as far as they are in a bin of `side` tiles whose first column is `left`.
template <int side>
BinTiles tiles_in_bin(const TileRect& t, const Span* spans, int row, int end, int left) {
  BinTiles tiles = {0, 0};
  for (; row < end; ++row) {
    const Span s = spans[row - t.row];
    const int from = std::clamp(s.begin - left, 0, side), to = std::clamp(s.end - left, from, side);
    tiles.bits |= ((1u << to) - (1u << from)) << side * (row % side), tiles.count += static_cast<uint32_t>(to - from);
  }
  return tiles;
}

// The same of all rows where no tile is outside the bin.
template <int side>
BinTiles tiles_in_only_bin(const TileRect& t, const Span* spans) {
  BinTiles tiles = {0, 0};
  for (uint32_t k = 0; k < t.rows; ++k) {
    const uint32_t count = spans[k].end - spans[k].begin;
    tiles.bits |= ((1u << count) - 1) << (side * ((t.row + k) % side) + spans[k].begin % side), tiles.count += count;
  }
  return tiles;
}

// Writes the entries of a part from `next` on, at most one for each of its slots. Returns where they end.
template <int side>
BinEntry* write_entries(const Frame& f, const BinPart& part, BinEntry* next) {
  uint32_t slot = static_cast<uint32_t>(part.slot);
  for (int64_t place = part.begin; place < part.end; ++place) {
    const TileRect& t = f.rects[place];
    GaussianTiles& g = f.tiles[place];
    g.slot = slot;
    const Span* const spans = t.rows > 1 ? f.spans + g.span : &t.columns;
    const auto write = [&](int x, int y, BinTiles tiles) {
      if (!tiles.count) return;
      *next++ = {static_cast<uint32_t>(y * f.bins_x + x), static_cast<uint32_t>(place), slot, static_cast<uint16_t>(tiles.bits),
                 static_cast<uint16_t>(tiles.count)};
      slot += tiles.count;
    };
    const int end = t.row + t.rows, x = t.columns.begin / side, y = t.row / side, last_x = (t.columns.end - 1) / side, last_y = (end - 1) / side;
    if (x == last_x && y == last_y) {  // as most
      write(x, y, tiles_in_only_bin<side>(t, spans));
    } else {
      for (int b = y; b <= last_y; ++b)
        for (int a = x; a <= last_x; ++a) write(a, b, tiles_in_bin<side>(t, spans, std::max<int>(t.row, b * side), std::min(end, (b + 1) * side), a * side));
    }
    g.tiles = slot - g.slot;
  }
  return next;
}

// Adds how many entries each tile of their bin has.
void count_tiles(const BinEntry* entry, const BinEntry* end, uint32_t counts[kBinTiles]) {
  typedef uint16_t Half __attribute__((vector_size(16)));
  constexpr int64_t kMost = UINT16_MAX;
  const Half low = {1, 2, 4, 8, 16, 32, 64, 128}, high = low << 8;
  while (entry < end) {
    Half first = {}, second = {};
    for (const BinEntry* const stop = entry + std::min<int64_t>(kMost, end - entry); entry < stop; ++entry) {
      const Half tiles = Half{} + entry->tiles;
      first -= (Half)((tiles & low) != 0), second -= (Half)((tiles & high) != 0);
    }
    for (int k = 0; k < kBinTiles / 2; ++k) counts[k] += first[k], counts[kBinTiles / 2 + k] += second[k];
  }
}

// Deals the sorted entries of a bin out to its tiles. next[tile]: where the next entry of the tile goes; one more for those of no tile.
void deal_out(const BinEntry* binned, const uint64_t* keys, int64_t n, TileEntry* next[kBinTiles + 1]) {
  for (int64_t i = 0; i < n; ++i) {
    const BinEntry& e = binned[static_cast<uint32_t>(keys[i])];
    uint32_t left = e.tiles, slot = e.slot;
    for (int k = 0; k < 2; ++k) {  // without a branch, because the number of tiles cannot be foreseen
      const int tile = __builtin_ctz(left | 1u << kBinTiles);
      *next[tile] = {e.place, slot++};
      next[tile] += tile < kBinTiles;
      left &= left - 1;
    }
    for (; left; left &= left - 1) *next[__builtin_ctz(left)]++ = {e.place, slot++};
  }
}

// Fills the entries of a bin of one tile.
void list_tile(const TileLists& lists, int64_t begin, int64_t end) {
  sort_list(lists.keys + begin, lists.scratch + begin, end - begin);
  for (int64_t i = begin; i < end; ++i) {
    const uint32_t low = static_cast<uint32_t>(lists.keys[i]);
    lists.entries[i] = lists.places ? TileEntry{low, 0} : TileEntry{lists.binned[low].place, lists.binned[low].slot};
  }
}

}  // namespace

int64_t listing_groups(const std::vector<BinPart>& parts) { return std::min<int64_t>(static_cast<int64_t>(parts.size()), kMostGroups); }

void fill_bins(const Frame& f, std::vector<BinPart>& parts, const uint32_t* depth_keys, const TileLists& lists) {
  const int64_t bins = f.bin_count(), groups = listing_groups(parts), grain = groups ? (static_cast<int64_t>(parts.size()) + groups - 1) / groups : 0;
  const auto for_parts = [&](int64_t group, auto&& run) {
    for (size_t k = static_cast<size_t>(group * grain), end = std::min(parts.size(), k + static_cast<size_t>(grain)); k < end; ++k) run(parts[k]);
  };
  parallel_for(groups, [&](int64_t group) {
    BinCount* const own = lists.counts + group * bins;
    std::fill_n(own, bins, BinCount{0, 0});
    for_parts(group, [&](BinPart& part) {
      BinEntry *e = lists.written + part.slot, *const end = f.bin_side == 1 ? write_entries<1>(f, part, e) : write_entries<kBin>(f, part, e);
      part.entries = end - e;
      for (; e < end; ++e) ++own[e->bin].entries, own[e->bin].pairs += e->count;
    });
  });
  BinCount total = {0, 0};
  for (int64_t bin = 0; bin < bins; ++bin) {
    lists.bin_begin[bin] = total.entries, lists.tile_begin[bin * lists.bin_tiles] = total.pairs;
    for (int64_t group = 0; group < groups; ++group) {
      BinCount& own = lists.counts[group * bins + bin];
      total.pairs += own.pairs, total.entries += std::exchange(own.entries, total.entries);
    }
  }
  lists.bin_begin[bins] = total.entries, lists.tile_begin[bins * lists.bin_tiles] = total.pairs;
  parallel_for(groups, [&](int64_t group) {
    BinCount* const next = lists.counts + group * bins;
    for_parts(group, [&](const BinPart& part) {
      for (const BinEntry *e = lists.written + part.slot, *const end = e + part.entries; e < end; ++e) {
        const uint32_t to = next[e->bin].entries++;
        lists.keys[to] = entry_key(depth_keys[e->place], lists.places ? e->place : to);
        if (!lists.places) lists.binned[to] = *e;
      }
    });
  });
}

void list_bin(const TileLists& lists, int64_t bin) {
  const int64_t begin = lists.bin_begin[bin], end = lists.bin_begin[bin + 1];
  if (lists.bin_tiles == 1) return list_tile(lists, begin, end);
  int64_t* const tile_begin = lists.tile_begin + bin * kBinTiles;
  uint32_t counts[kBinTiles] = {};
  count_tiles(lists.binned + begin, lists.binned + end, counts);
  TileEntry none, *next[kBinTiles + 1];
  next[kBinTiles] = &none;
  for (int k = 0; k < kBinTiles; ++k) {
    if (k) tile_begin[k] = tile_begin[k - 1] + counts[k - 1];
    next[k] = lists.entries + tile_begin[k];
  }
  sort_list(lists.keys + begin, lists.scratch + begin, end - begin);
  deal_out(lists.binned, lists.keys + begin, end - begin, next);
}

}  // namespace svrgs

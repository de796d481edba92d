// Which Gaussians touch which tile, nearest first. Independent of the SIMD level and of the number of threads.
#pragma once
#include <vector>

#include "frame.h"

namespace svrgs {

struct BinEntry {  // a Gaussian and a bin whose tiles it touches
  uint32_t bin, place;
  uint32_t slot;          // of the first of these tiles
  uint16_t tiles, count;  // a bit for each of them; how many
};
static_assert(kBinTiles == 16, "a bit for each tile");

struct BinPart {  // the visible Gaussians at places [begin, end), the first of their slots, and how many entries they have in bins
  int64_t begin, end, slot, entries;
};

struct BinCount {
  uint32_t entries, pairs;
};

// Number of groups of parts that are counted apart.
int64_t listing_groups(const std::vector<BinPart>& parts);

struct TileLists {
  int64_t bin_tiles;                // tiles per bin
  bool places;                      // bins of one tile have the places of their Gaussians only: no slots
  BinEntry *written, *binned;       // room for as many entries as there are (Gaussian, tile) pairs
  uint64_t *keys, *scratch;         // likewise
  BinCount* counts;                 // [listing_groups][bins]
  int64_t *bin_begin, *tile_begin;  // [bins + 1] of binned; [tiles + 1] of entries
  TileEntry* entries;
};

// Gives the pairs of each Gaussian their slots and fills the bins. depth_keys: by place.
void fill_bins(const Frame& f, std::vector<BinPart>& parts, const uint32_t* depth_keys, const TileLists& lists);

// Fills tile_begin and entries of a bin: each tile's pairs by depth, equal ones in the order of places.
void list_bin(const TileLists& lists, int64_t bin);

}  // namespace svrgs

// Which Gaussians touch which tile, nearest first. Independent of the SIMD level and of the number of threads.
#pragma once
#include "frame.h"

namespace svrgs {

struct Keyed {
  uint32_t key, place;
};

// Stable sort by key: equal depths keep the order of ids. Returns where the sorted items are: in `items`, or in `scratch`, as many.
[[nodiscard]] Keyed* sort_by_depth(Keyed* items, Keyed* scratch, int64_t count);

// Number of scan chunks of tile binning; counts: [chunks][tiles].
int64_t binning_chunks(int64_t visible);

// Fills tile_begin[tiles + 1] and entries from the sorted places and their spans.
void bin_tiles(const Frame& f, const Keyed* sorted, int64_t* tile_begin, TileEntry* entries, uint32_t* counts);

}  // namespace svrgs

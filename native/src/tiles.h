// Which Gaussians touch which tile, nearest first. Independent of the SIMD level and of the number of threads.
#pragma once
#include "frame.h"

namespace svrgs {

struct TileIntersection {  // a Gaussian and a tile it touches; their slot is the pair's index
  uint32_t tile, place;
};

// The pairs of the visible Gaussians at places [begin, end), whose slots are [slot, slot_end), each into its slot.
void write_intersections(const Frame& f, int64_t begin, int64_t end, int64_t slot, int64_t slot_end, TileIntersection* pairs);

// Number of chunks that pairs are counted in; counts: [chunks][tiles].
int64_t listing_chunks(int64_t pairs);

// Fills tile_begin[tiles + 1] and entries: each tile's pairs by depth, equal ones in the order of slots. depth_keys: by place;
// keys: room for twice the pairs.
void list_tiles(const Frame& f, const TileIntersection* pairs, int64_t count, const uint32_t* depth_keys, uint64_t* keys, uint32_t* counts, int64_t* tile_begin,
                TileEntry* entries);

}  // namespace svrgs

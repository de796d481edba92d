// A stable sort by 32-bit keys, on all threads. Independent of the SIMD level and of the number of threads.
#pragma once
#include <cstdint>

namespace svrgs {

struct Keyed {
  uint32_t key, place;
};

// Returns where the sorted items are: in `items`, or in `scratch`, as many.
[[nodiscard]] Keyed* sort_by_depth(Keyed* items, Keyed* scratch, int64_t count);

}  // namespace svrgs

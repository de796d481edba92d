#include "depth_sort.h"

#include <algorithm>

#include "pool.h"

namespace svrgs {
namespace {

constexpr int kRadixBits = 11, kRadix = 1 << kRadixBits, kPasses = 3;  // 33 bits cover the 32 of a key
constexpr int64_t kSortChunks = 8;

void radix_pass(const Keyed* from, Keyed* to, int64_t count, int shift) {
  static thread_local uint32_t offsets[kSortChunks][kRadix];
  uint32_t (*offset)[kRadix] = offsets;  // workers write the caller's table
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

}  // namespace

Keyed* sort_by_depth(Keyed* items, Keyed* scratch, int64_t count) {
  for (int pass = 0; pass < kPasses; ++pass) {
    radix_pass(items, scratch, count, pass * kRadixBits);
    std::swap(items, scratch);
  }
  return items;
}

}  // namespace svrgs

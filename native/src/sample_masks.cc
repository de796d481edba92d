#include "sample_masks.h"

#include <algorithm>
#include <cmath>

#include "pool.h"

namespace svrgs {
namespace {

uint64_t mix(uint64_t x) {  // the splitmix64 finaliser
  x ^= x >> 30, x *= 0xbf58476d1ce4e5b9ULL;
  x ^= x >> 27, x *= 0x94d049bb133111ebULL;
  return x ^ x >> 31;
}

}  // namespace

void sample_masks(const float* logits, int64_t count, uint64_t seed, uint64_t step, uint8_t* masks, float* slope) {
  const uint64_t key = mix(mix(seed + 0x9e3779b97f4a7c15ULL) + step);
  parallel_blocks(count, 8192, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const uint64_t bits = mix(key + 0x9e3779b97f4a7c15ULL * static_cast<uint64_t>(i)) >> 40;
      // u is inside (0, 1), so the noise is finite
      const double u = (static_cast<double>(bits) + 0.5) / 16777216.0;
      const double odds = std::exp(-std::clamp<double>(logits[i], -80, 80)) * (1 - u) / u;  // of absence: e^-(d + l)
      masks[i] = odds < 1;
      slope[i] = static_cast<float>(odds / ((1 + odds) * (1 + odds)));
    }
  });
}

}  // namespace svrgs

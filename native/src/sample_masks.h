// Masks drawn from existence logits. Independent of the number of threads.
#pragma once
#include <cstdint>

namespace svrgs {

void sample_masks(const float* logits, int64_t count, uint64_t seed, uint64_t step, uint8_t* masks, float* slope);  // svrgs_sample_masks

}  // namespace svrgs

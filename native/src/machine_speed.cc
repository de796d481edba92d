#include "machine_speed.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <vector>

#include "pool.h"

namespace svrgs {
namespace {

constexpr int kTries = 5;
constexpr int64_t kRounds = 1 << 20;
constexpr int64_t kFloats = 32 << 20;  // per thread: 128 MB; of 48, a third still came out of a cache of 32
constexpr int64_t kStreams = 8;        // one stream of loads waits for memory; several do not

// The best rate of kTries; run(thread) does one thread's share and returns its amount.
template <class F>
double best_rate(F&& run) {
  double best = 0;
  for (int i = 0; i < kTries; ++i) {
    std::atomic<double> total{0};
    const auto begin = std::chrono::steady_clock::now();
    parallel_for(threads(), [&](int64_t thread) { total += run(thread); });
    best = std::max(best, total / std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  }
  return best;
}

double read_all(const float* data) {
  using Four = float __attribute__((vector_size(16)));
  Four sums[kStreams] = {};
  constexpr int64_t part = kFloats / kStreams;
  for (int64_t i = 0; i < part; i += 4)
    for (int64_t s = 0; s < kStreams; ++s) {
      Four v;
      __builtin_memcpy(&v, data + s * part + i, sizeof v);
      sums[s] += v;
    }
  Four total = {};
  for (const Four& stream : sums) total += stream;
  volatile float result = total[0] + total[1] + total[2] + total[3];
  (void)result;
  return sizeof(float) * kFloats;
}

double update_all(float* data) {
  constexpr int64_t part = kFloats / 3;
  float *a = data, *b = a + part;
  const float* g = b + part;
  for (int64_t i = 0; i < part; ++i) b[i] = 0.9f * b[i] + g[i], a[i] -= 1e-9f * b[i];
  return 5.0 * sizeof(float) * part;
}

}  // namespace

svrgs_machine measure_machine(const Kernels& kernels) {
  std::vector<std::vector<float>> data(threads(), std::vector<float>(kFloats, 1e-3f));
  svrgs_machine machine;
  machine.fma = best_rate([&](int64_t) { return kernels.multiply_adds(kRounds); });
  machine.read = best_rate([&](int64_t t) { return read_all(data[t].data()); });
  machine.update = best_rate([&](int64_t t) { return update_all(data[t].data()); });
  return machine;
}

}  // namespace svrgs

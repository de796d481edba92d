// The one thread pool of the library. Work is handed out by an atomic counter; the caller takes part.
#pragma once
#include <cstdint>

namespace svrgs {

void set_threads(int threads);  // 0: one per core; at most 8 per core, or 32
int threads();

using Task = void (*)(void* argument, int64_t index);
void run_tasks(int64_t count, Task task, void* argument);

// Calls f(i) for i in [0, count), in any order, on all threads; returns when all are done. f must not throw.
template <class F>
void parallel_for(int64_t count, F&& f) {
  run_tasks(count, [](void* a, int64_t i) { (*static_cast<F*>(a))(i); }, &f);
}

// Calls f(begin, end) for fixed blocks of `grain` items: the split does not depend on the number of threads.
template <class F>
void parallel_blocks(int64_t count, int64_t grain, F&& f) {
  parallel_for((count + grain - 1) / grain, [&](int64_t b) {
    const int64_t begin = b * grain, end = begin + grain;
    f(begin, end < count ? end : count);
  });
}

}  // namespace svrgs

// The one thread pool of the library. Work is handed out by an atomic counter, some tasks at a time; the caller takes part.
#pragma once
#include <cstdint>
#include <thread>
#include <vector>

namespace svrgs {

void set_threads(int threads);  // 0: one per core; at most 8 per core, or 32
int threads();

using Task = void (*)(void* argument, int64_t index, int worker);
using Prepare = void (*)(void* argument, int workers);
void run_tasks(int64_t count, Task task, void* argument, Prepare prepare = nullptr);

// The seconds of each task, in the order of the jobs, with -1 before each job, since trace(true). Only with one thread.
void trace(bool on);
const std::vector<double>& traced();

// Calls f(i) for i in [0, count), in any order, on all threads; returns when all are done. f must not throw.
template <class F>
void parallel_for(int64_t count, F&& f) {
  run_tasks(count, [](void* a, int64_t i, int) { (*static_cast<F*>(a))(i); }, &f);
}

// The same with f(i, worker), for tasks that need memory of their own: each thread is another worker, 0 to workers - 1. prepare(workers) is called before.
template <class P, class F>
void parallel_for_workers(int64_t count, P&& prepare, F&& f) {
  struct Both {
    P& prepare;
    F& f;
  } both{prepare, f};
  run_tasks(
      count, [](void* a, int64_t i, int worker) { static_cast<Both*>(a)->f(i, worker); }, &both,
      [](void* a, int workers) { static_cast<Both*>(a)->prepare(workers); });
}

// A view is a dozen short jobs. To wake a sleeping thread takes as long as some of them, so threads spin for a while before they sleep.
template <class F>
bool spin_until(F&& found) {
  constexpr int kSpins = 4000;  // some 50 microseconds; more on a processor with a longer pause
  for (int i = 0; i < kSpins; ++i) {
    if (found()) return true;
#if defined(__x86_64__)
    __builtin_ia32_pause();
#endif
  }
  return false;
}

// Within a task: returns when found() is true. A task with a smaller index must make it so, and must not wait itself.
template <class F>
void wait_for_earlier_task(F&& found) {
  while (!spin_until(found)) std::this_thread::yield();
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

#include "pool.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#if defined(__linux__)
#include <sched.h>
#endif

namespace svrgs {
namespace {

constexpr size_t kLine = 64;        // bytes of a cache line
constexpr int64_t kMostAtOnce = 8;  // tasks that a thread takes at once, at most
constexpr int64_t kShares = 4;      // with n threads, a thread takes at most 1 / (n kShares) of the tasks that are left, or that were taken before

struct Job {
  Task task;
  void* argument;
  int64_t count;
  int64_t shares;                               // kShares for each thread
  alignas(kLine) std::atomic<int64_t> next{0};  // all threads write to it: a line of its own

  void traced_work();
  // Tasks that follow each other use the same data, so a thread takes several at once. It takes single tasks at the start, because later tasks may wait for
  // them, and at the end, so that all threads finish at the same time.
  void work(int worker) {
    for (;;) {
      const int64_t taken = next.load(std::memory_order_relaxed), wanted = std::clamp<int64_t>(std::min(taken, count - taken) / shares, 1, kMostAtOnce);
      int64_t i = next.fetch_add(wanted, std::memory_order_relaxed);
      if (i >= count) return;
      for (const int64_t end = std::min(i + wanted, count); i < end; ++i) task(argument, i, worker);
    }
  }
};

std::atomic<bool> tracing{false};
std::vector<double> seconds_of_tasks;

void Job::traced_work() {
  using Clock = std::chrono::steady_clock;
  seconds_of_tasks.push_back(-1);
  for (int64_t i = 0; i < count; ++i) {
    const auto begun = Clock::now();
    task(argument, i, 0);
    seconds_of_tasks.push_back(std::chrono::duration<double>(Clock::now() - begun).count());
  }
}

// The gate is one atomic word. Its low half counts the workers inside the job. Its high half is even while workers may enter, odd while they may not, and grows
// by two with each job. A lock is taken only to sleep and to wake.
class Pool {
 public:
  explicit Pool(int size) {
    try {
      for (int i = 1; i < size; ++i) workers_.emplace_back([this, i] { loop(i); });
    } catch (const std::system_error&) {  // the system gives no more threads: those there are do the work
    }
  }

  ~Pool() {
    {
      std::lock_guard lock(mutex_);
      stop_ = true;
    }
    wake_.notify_all();
    for (auto& worker : workers_) worker.join();
  }

  int size() const { return static_cast<int>(workers_.size()) + 1; }

  void run(Job& job) {
    if (workers_.empty() && tracing) return job.traced_work();
    if (workers_.empty() || job.count < 2) return job.work(0);
    std::lock_guard one_at_a_time(submit_);
    job_ = &job;
    gate_ += kStep;
    wake(sleeping_, wake_);
    job.work(0);
    gate_ += kStep;
    if (spin_until([&] { return !inside(); })) return;
    std::unique_lock lock(mutex_);
    waiting_ = 1;
    done_.wait(lock, [&] { return !inside(); });
    waiting_ = 0;
  }

 private:
  static constexpr uint64_t kStep = uint64_t{1} << 32, kShut = kStep;

  bool inside() const { return static_cast<uint32_t>(gate_.load()) != 0; }
  static bool open(uint64_t gate, uint64_t seen) { return !(gate & kShut) && gate >> 32 != seen; }

  // A thread that goes to sleep says so before it looks at the gate for the last time, and this is called after the gate has changed: one sees the other.
  void wake(const std::atomic<int>& asleep, std::condition_variable& of) {
    if (!asleep) return;
    { std::lock_guard lock(mutex_); }
    of.notify_all();
  }

  void loop(int worker) {
    for (uint64_t seen = gate_ >> 32;;) {
      if (!spin_until([&] { return open(gate_, seen); })) {
        std::unique_lock lock(mutex_);
        ++sleeping_;
        wake_.wait(lock, [&] { return stop_ || open(gate_, seen); });
        --sleeping_;
        if (stop_) return;
      }
      uint64_t gate = gate_;
      while (open(gate, seen) && !gate_.compare_exchange_weak(gate, gate + 1)) {}
      if (!open(gate, seen)) continue;  // the job was shut in the meantime
      seen = gate >> 32;
      job_->work(worker);
      const uint64_t left = gate_ -= 1;  // the job may be gone from here on
      if (left & kShut && !static_cast<uint32_t>(left)) wake(waiting_, done_);
    }
  }

  std::vector<std::thread> workers_;
  std::mutex submit_, mutex_;
  std::condition_variable wake_, done_;
  Job* job_ = nullptr;
  bool stop_ = false;
  std::atomic<int> sleeping_{0}, waiting_{0};
  alignas(kLine) std::atomic<uint64_t> gate_{kShut};
};

std::mutex pool_mutex;
std::shared_ptr<Pool> pool;

// Largest size of the pool: many more threads than cores only wait for each other, and a frame takes hundreds of times as long.
constexpr int kAnyCores = 32, kPerCore = 8;

int core_count() {  // that this process may use
#if defined(__linux__)
  cpu_set_t allowed;
  if (sched_getaffinity(0, sizeof allowed, &allowed) == 0) return std::max(1, CPU_COUNT(&allowed));
#endif
  const unsigned n = std::thread::hardware_concurrency();
  return n ? static_cast<int>(n) : 1;
}

std::shared_ptr<Pool> current_pool() {
  std::lock_guard lock(pool_mutex);
  if (!pool) pool = std::make_shared<Pool>(core_count());
  return pool;
}

}  // namespace

void set_threads(int threads) {
  const int cores = core_count(), wanted = threads > 0 ? std::min(threads, std::max(kAnyCores, kPerCore * cores)) : cores;
  if (current_pool()->size() == wanted) return;
  auto fresh = std::make_shared<Pool>(wanted);
  std::lock_guard lock(pool_mutex);
  pool.swap(fresh);
}

int threads() { return current_pool()->size(); }

void trace(bool on) {
  if (on) seconds_of_tasks.clear();
  tracing = on;
}

const std::vector<double>& traced() { return seconds_of_tasks; }

void run_tasks(int64_t count, Task task, void* argument, Prepare prepare) {
  const auto workers = current_pool();
  if (prepare) prepare(argument, workers->size());
  Job job{task, argument, count, kShares * workers->size()};
  workers->run(job);
}

}  // namespace svrgs

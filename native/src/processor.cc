#include "processor.h"

#if defined(__x86_64__)
#include <cpuid.h>

#include <cstdint>
#endif

namespace svrgs {

#if defined(__x86_64__)
namespace {

// By CPUID itself, because not every runtime library fills in what __builtin_cpu_supports reads: zig's says no to everything.
struct Processor {
  uint32_t leaf1 = 0, leaf7 = 0, more7 = 0;  // features in ECX of leaf 1, EBX and ECX of leaf 7
  uint32_t saved = 0;                        // registers that the system saves, XCR0

  Processor() {
    uint32_t a, b, c, d;
    if (__get_cpuid(1, &a, &b, &c, &d)) leaf1 = c;
    if (__get_cpuid_count(7, 0, &a, &b, &c, &d)) leaf7 = b, more7 = c;
    if (leaf1 >> 27 & 1) __asm__("xgetbv" : "=a"(saved), "=d"(d) : "c"(0));  // OSXSAVE
  }
};

constexpr uint32_t kFma = 1u << 12, kAvx = 1u << 28;                                      // leaf 1
constexpr uint32_t kAvx2 = 1u << 5, kAvx512 = 1u << 16 | 1u << 17 | 1u << 30 | 1u << 31;  // leaf 7, EBX: F, DQ, BW, VL
constexpr uint32_t kVbmi2 = 1u << 6;                                                      // leaf 7, ECX
constexpr uint32_t kYmm = 0x6, kZmm = 0xe6;                                               // XCR0

bool all(uint32_t bits, uint32_t of) { return (of & bits) == bits; }

const Processor& processor() {
  static const Processor found;
  return found;
}

}  // namespace

bool has_avx2() {
  const Processor& p = processor();
  return all(kFma | kAvx, p.leaf1) && all(kAvx2, p.leaf7) && all(kYmm, p.saved);
}

bool has_avx512() { return has_avx2() && all(kAvx512, processor().leaf7) && all(kZmm, processor().saved); }
bool has_vbmi2() { return has_avx512() && all(kVbmi2, processor().more7); }
#else
bool has_avx2() { return false; }
bool has_avx512() { return false; }
bool has_vbmi2() { return false; }
#endif

}  // namespace svrgs

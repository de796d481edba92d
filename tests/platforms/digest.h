// Lines of digests: what a call wrote, as 64 bits, the same on two systems if and only if they wrote the same.
#pragma once
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <type_traits>
#include <vector>

#include "svrgs.h"

namespace platforms {

// FNV-1a over bytes, of one call.
class Digest {
 public:
  explicit Digest(bool coarse) : coarse_(coarse) {}

  // Whole bits; of a coarse digest, numbers in steps of a millionth of the largest: they differ by less between libraries of mathematics.
  template <class T>
  Digest& add(const T* from, size_t count) {
    double largest = 0;
    if constexpr (std::is_floating_point_v<T>)
      for (size_t i = 0; coarse_ && i < count; ++i)
        largest = std::isfinite(from[i]) && std::fabs(double(from[i])) > largest ? std::fabs(double(from[i])) : largest;
    for (size_t i = 0; i < count; ++i) {
      if (largest > 0)
        add_number(std::isfinite(from[i]) ? std::floor(double(from[i]) / largest * 1e6 + 0.5) : 0);
      else
        add_number(from[i]);
    }
    return *this;
  }
  template <class T>
  Digest& add(const std::vector<T>& from) {
    return add(from.data(), from.size());
  }

  uint64_t value = 0xcbf29ce484222325ULL;

 private:
  template <class T>
  void add_number(T number) {
    uint8_t bytes[sizeof number];
    std::memcpy(bytes, &number, sizeof number);
    for (const uint8_t byte : bytes) value = (value ^ byte) * 0x100000001b3ULL;
  }
  bool coarse_;
};

// The lines of one level, in order.
struct Lines {
  std::string level;
  std::vector<std::string> all;

  void add(const std::string& call, const Digest& digest, bool rounded) {
    char hex[17];
    std::snprintf(hex, sizeof hex, "%016llx", static_cast<unsigned long long>(digest.value));
    all.push_back(level + " " + call + (rounded ? " rounded " : " exact ") + hex);
  }
  // A call that must be refused.
  void refuse(const std::string& call, int32_t status, int32_t expected) {
    if (status != expected) fail(call + " has status " + std::to_string(status));
    all.push_back(level + " " + call + " says " + svrgs_last_error());
  }
  void require(bool good, const std::string& call) {
    if (!good) fail(call + ": " + svrgs_last_error());
  }
  [[noreturn]] void fail(const std::string& sentence) {
    std::fprintf(stderr, "%s %s\n", level.c_str(), sentence.c_str());
    std::exit(1);
  }
};

}  // namespace platforms

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

namespace digests {

constexpr double kWhole = 0, kMillionths = 1e6, kCoarse = 1e4;  // steps of a digest; kCoarse: of floats that differ in their last bit

// FNV-1a over bytes, of one call.
class Digest {
 public:
  explicit Digest(double steps) : steps_(steps) {}

  // All bits; of a rounded digest, numbers in steps of a share of the largest.
  template <class T>
  Digest& add(const T* from, size_t count) {
    const double largest = rounded() ? largest_of(from, count) : 0;
    for (size_t i = 0; i < count; ++i) {
      if (largest > 0)
        add_number(std::isfinite(double(from[i])) ? std::floor(double(from[i]) / largest * steps_ + 0.5) : 0);
      else
        add_number(from[i]);
    }
    return *this;
  }
  template <class T>
  Digest& add(const std::vector<T>& from) {
    return add(from.data(), from.size());
  }

  bool rounded() const { return steps_ > 0; }

  uint64_t value = 0xcbf29ce484222325ULL;

 private:
  template <class T>
  static double largest_of(const T* from, size_t count) {  // 0: whole numbers are never rounded
    double largest = 0;
    if constexpr (std::is_floating_point_v<T>)
      for (size_t i = 0; i < count; ++i)
        if (std::isfinite(from[i])) largest = std::fmax(largest, std::fabs(double(from[i])));
    return largest;
  }
  template <class T>
  void add_number(T number) {
    uint8_t bytes[sizeof number];
    std::memcpy(bytes, &number, sizeof number);
    for (const uint8_t byte : bytes) value = (value ^ byte) * 0x100000001b3ULL;
  }
  double steps_;  // 0: not rounded
};

// The lines of one level, in order.
struct Lines {
  std::string level;
  std::vector<std::string> all;

  void add(const std::string& call, const Digest& digest) {
    char hex[17];
    std::snprintf(hex, sizeof hex, "%016llx", static_cast<unsigned long long>(digest.value));
    all.push_back(level + " " + call + (digest.rounded() ? " rounded " : " exact ") + hex);
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

}  // namespace digests

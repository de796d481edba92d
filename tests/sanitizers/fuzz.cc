// libFuzzer on the C interface: any scene, camera and options are refused, or drawn with finite images and gradients, alike at
// one and at three threads, bit for bit. Built with -fsanitize=fuzzer,address,undefined (make fuzz).
#include "views.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static svrgs_context* contexts[5] = {};
  views::Bytes bytes{data, size};
  static constexpr int32_t kLevels[] = {SVRGS_SCALAR, SVRGS_BASELINE, SVRGS_AVX2, SVRGS_AVX512};
  const int32_t level = kLevels[bytes.below(4)];
  if (!svrgs_level_supported(level)) return -1;
  if (!contexts[level]) views::require(svrgs_context_create(level, &contexts[level]) == SVRGS_OK, "a context");
  const views::Case c(bytes);
  svrgs_set_threads(1);
  const views::Results one = views::run(c, contexts[level], level);
  views::require(views::finite(one), "finite images and gradients");
  svrgs_set_threads(3);
  const views::Results three = views::run(c, contexts[level], level);
  views::require(one.drawn == three.drawn && one.values.size() == three.values.size(), "the same for any number of threads");
  views::require(one.values.empty() || !std::memcmp(one.values.data(), three.values.data(), one.values.size() * sizeof(float)),
                 "the same bits for any number of threads");
  return 0;
}

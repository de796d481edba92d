// What the processor and the operating system let a program use.
#pragma once

namespace svrgs {

bool has_avx2();    // with FMA
bool has_avx512();  // F, DQ, BW and VL, and has_avx2()

}  // namespace svrgs

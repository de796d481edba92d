// What the processor and the operating system let a program use.
#pragma once

namespace svrgs {

bool has_avx2();    // with FMA
bool has_avx512();  // F, DQ, BW and VL, and has_avx2()
bool has_vbmi2();   // of 512 bits, and has_avx512()

}  // namespace svrgs

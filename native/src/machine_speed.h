// Measures the machine's peaks, from which svrgs bench computes lower bounds of times.
#pragma once
#include "kernels.h"

namespace svrgs {

svrgs_machine measure_machine(const Kernels& kernels);

}  // namespace svrgs

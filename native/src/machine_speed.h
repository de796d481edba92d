// Peaks of the machine, measured: the denominators of svrgs bench's floors.
#pragma once
#include "kernels.h"

namespace svrgs {

svrgs_machine measure_machine(const Kernels& kernels);

}  // namespace svrgs

// The order in which Gaussians are removed or merged in pairs, so that any number of them is left (svrgs_decimate in svrgs.h).
#pragma once
#include <cstdint>

#include "kernels.h"
#include "svrgs.h"

namespace svrgs {

// Returns false if the cancel flag was set.
bool decimate(const Kernels&, const svrgs_decimation&, const int32_t* cancel, const svrgs_merges&, int64_t& steps, int64_t& merges);

}  // namespace svrgs

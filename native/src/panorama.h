// Perspective views as parts of an equirectangular picture.
#pragma once
#include "svrgs.h"

namespace svrgs {

void add_view(const svrgs_view&, const svrgs_panorama&);

}  // namespace svrgs

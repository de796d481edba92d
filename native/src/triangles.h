// Opaque triangles as a camera sees them: up to two layers per pixel, with smooth edges, textures and a fixed light.
#pragma once
#include "svrgs.h"

namespace svrgs {

void draw_triangles(const svrgs_triangles&, const svrgs_camera&, const svrgs_layers&);

}  // namespace svrgs

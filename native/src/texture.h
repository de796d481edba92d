// Textures of triangles: display sRGB with levels of half the size, sampled along the longer side of a pixel's footprint.
#pragma once
#include <cstdint>

#include "svrgs.h"

namespace svrgs {

// Derivatives of the texture coordinates by the pixel coordinates.
struct Footprint {
  double u_x, v_x, u_y, v_y;
};

// Linear colour of the texture around (u, v).
void sample_texture(const svrgs_texture&, double u, double v, const Footprint&, double rgb[3]);

float srgb_of_linear(double value);

}  // namespace svrgs

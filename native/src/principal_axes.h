// The scales and the rotation of a Gaussian from its covariance.
#pragma once

namespace svrgs {

// covariance: xx, xy, xz, yy, yz, zz. Writes log-scales (3) and the quaternion (4) w x y z, of unit length. Scales are at least a
// hundred-thousandth of the largest: float32 covariances hold no smaller ones.
void principal_axes(const double covariance[6], float log_scales[3], float quat[4]);

}  // namespace svrgs

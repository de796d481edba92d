// The thresholds of the model, named once and shared by projection, forward, backward, mask and scores.
#pragma once

namespace svrgs {

constexpr double kNear = 0.2;                   // cull view depth z <= kNear
constexpr double kFar = 1e15;                   // and z >= kFar, whose square float gradients could not hold
constexpr double kBlur = 0.3;                   // low-pass added to the 2-D covariance, pixels^2
constexpr double kAlphaCut = 1.0 / 255.0;       // a Gaussian hits a pixel where alpha >= kAlphaCut
constexpr double kAlphaMax = 0.99;              // alpha is clamped here
constexpr double kColourMax = 1e6;              // brighter Gaussians are not drawn: their gradients would overflow
constexpr double kQuatMax = 1e18;               // nor those whose quaternion is longer than this, or shorter than its inverse
constexpr double kStop = 1e-4;                  // colours stop before transmittance would fall below
constexpr double kLog2Of255 = 7.994353436858858;
constexpr double kFrustumMargin = 0.3;          // x/z is clamped this share of the half field of view outside the image
constexpr double kCompensationFloor = 0.000025; // of det(before blur) / det(after blur), antialiased scenes

constexpr int kTile = 16;                       // pixels per tile side
constexpr int kBlock = 4;                       // pixels per block side; a block is 16 lanes
constexpr int kBlocks = 16;                     // blocks per tile
constexpr int kBlockPixels = 16;

}  // namespace svrgs

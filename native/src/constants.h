// The thresholds of the model, named once and shared by projection, forward, backward, mask and scores. Those with a macro
// can be set when building, to measure other values (svrgs bench).
#pragma once
#include <cmath>
#include <cstdint>
#include <type_traits>

#ifndef SVRGS_ALPHA_CUT
#define SVRGS_ALPHA_CUT (1.0 / 255.0)
#endif
#ifndef SVRGS_STOP
#define SVRGS_STOP 1e-4
#endif
#ifndef SVRGS_TILE
#define SVRGS_TILE 32
#endif
#ifndef SVRGS_BLOCK_WIDTH
#define SVRGS_BLOCK_WIDTH 4
#endif

namespace svrgs {

constexpr double kNear = 0.2;                   // cull view depth z <= kNear
constexpr double kFar = 1e15;                   // and z >= kFar, whose square float gradients could not hold
constexpr double kBlur = 0.3;                   // low-pass added to the 2-D covariance, pixels^2
constexpr double kAlphaCut = SVRGS_ALPHA_CUT;   // a Gaussian hits a pixel where alpha >= kAlphaCut
inline const double kLog2Cut = std::log2(kAlphaCut);
inline const double kLogitCut = std::log(kAlphaCut / (1 - kAlphaCut)) - 1e-4;  // just below; the alpha test decides
constexpr double kAlphaMax = 0.99;              // alpha is clamped here
constexpr double kColourMax = 1e6;              // brighter Gaussians are not drawn: their gradients would overflow
constexpr double kQuatMax = 1e18;               // nor those whose quaternion is longer than this, or shorter than its inverse
constexpr double kStop = SVRGS_STOP;            // colours stop before transmittance would fall below
constexpr double kFrustumMargin = 0.3;          // x/z is clamped this share of the half field of view outside the image
constexpr double kCompensationFloor = 0.000025; // of det(before blur) / det(after blur), antialiased scenes

constexpr int kTile = SVRGS_TILE;               // pixels per tile side
constexpr int kBlockPixels = 16;                // a block is 16 lanes
constexpr int kBlockWidth = SVRGS_BLOCK_WIDTH, kBlockHeight = kBlockPixels / kBlockWidth;
constexpr int kBlockColumns = kTile / kBlockWidth;           // per tile
constexpr int kBlocks = kTile * kTile / kBlockPixels;        // per tile
using BlockMask = std::conditional_t<kBlocks <= 16, uint16_t, uint64_t>;  // a bit for each block of a tile
static_assert(kBlockPixels % kBlockWidth == 0, "a block is a whole rectangle");
static_assert(kTile % kBlockWidth == 0 && kTile % kBlockHeight == 0, "blocks fill a tile");
static_assert(kBlocks <= 64, "a BlockMask has 64 bits");
constexpr int kMaxSide = 32768;                              // pixels of an image side
static_assert(kMaxSide / kTile < 1 << 16, "tile coordinates have 16 bits");

}  // namespace svrgs

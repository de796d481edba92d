// The constants of the model, shared by all stages; Python reads them with svrgs_get_thresholds. Those with a macro can be set when
// building, to measure other values (svrgs bench).
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

constexpr double kNear = 0.2;                    // a Gaussian is drawn where kNear < z < kFar, z its depth; a camera may have another near
constexpr double kFar = 1e15;                    // the square of a larger depth would overflow in float gradients
constexpr double kBlur = 0.3;                    // low-pass added to the 2-D covariance, pixels^2
constexpr double kAlphaCut = SVRGS_ALPHA_CUT;    // a Gaussian hits a pixel where alpha >= kAlphaCut
constexpr double kAlphaMax = 0.99;               // alpha is clamped here
constexpr double kColourMax = 1e6;               // brighter Gaussians are not drawn: their gradients would overflow
constexpr double kQuatMax = 1e18;                // a quaternion may be this long at most, and 1 / kQuatMax long at least
constexpr double kStop = SVRGS_STOP;             // colours stop before transmittance would fall below
constexpr double kFrustumMargin = 0.3;           // share of half the image: x/z, y/z of the Jacobian are clamped this far outside its borders
constexpr double kCompensationFloor = 0.000025;  // of det(before blur) / det(after blur), antialiased scenes

// Not inline: on Windows an inline constant may be set after a constant of another file that needs it.
const double kLog2Cut = std::log2(kAlphaCut);
const double kLogitCut = std::log(kAlphaCut / (1 - kAlphaCut)) - 1e-4;  // a margin below; the alpha test decides

constexpr int kTile = SVRGS_TILE;  // pixels per tile side
constexpr int kBlockPixels = 16;   // a block is 16 lanes
constexpr int kBlockWidth = SVRGS_BLOCK_WIDTH, kBlockHeight = kBlockPixels / kBlockWidth;
constexpr int kBlockColumns = kTile / kBlockWidth;                        // per tile
constexpr int kBlocks = kTile * kTile / kBlockPixels;                     // per tile
using BlockMask = std::conditional_t<kBlocks <= 16, uint16_t, uint64_t>;  // a bit for each block of a tile
static_assert(kBlockPixels % kBlockWidth == 0, "a block is a whole rectangle");
static_assert(kTile % kBlockWidth == 0 && kTile % kBlockHeight == 0, "blocks fill a tile");
static_assert(kBlocks <= 64, "a BlockMask has 64 bits");
constexpr int kMaxSide = 32768;  // pixels of an image side
static_assert(kMaxSide / kTile < 1 << 16, "tile coordinates have 16 bits");
constexpr int kBin = 4, kBinTiles = kBin * kBin;  // tiles per side of a bin and per bin, at most

}  // namespace svrgs

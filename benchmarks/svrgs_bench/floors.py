"""Floors: lower bounds of the time of each stage on this machine.

A floor is the larger of two times: the arithmetic of the stage over the measured FMA peak, and the memory
that it must move over the measured memory peaks.

Memory moves in cache lines of 64 bytes. Visible Gaussians are not adjacent, so the lines that hold their rows
are counted (row_lines). Memory that is written without being read before is first fetched and later written
back, so it counts twice. Non-temporal stores, which the records use, write it only once, but they are hardly
faster: 35-38 GB/s, where updates move 67 GB/s in both directions together (measured once; no command repeats
it).

The unit of arithmetic is the slot: one vector instruction of W lanes that computes. A multiply-add is one
slot (2 W flop at the peak); an addition, comparison, minimum or shift takes the same slot. Loads, moves and
masks are not counted, as if they ran in parallel. The slots of a block hold for its 16 pixels, so each is 16
/ W instructions. The slots of a pair are done once, whatever W is.
"""

from __future__ import annotations

import numpy as np

from svrgs_addon.native.rasterizer import moments_like
from svrgs_addon.scene.gaussians import SH_COEFFICIENTS

LANES = {"scalar": 1, "baseline": 4, "avx2": 8, "avx512": 16, "float64": 1, "neon": 4}  # W of each SIMD level
BLOCK_PIXELS = 16

# Slots per block that is hit, and per (Gaussian, tile) pair that hits a pixel.
ALPHA_BLOCK = 20  # offset 2, exponent 5, 2^x 11, test and clamp
# weight, transmittance, stop, colours 3; per pair: the bounds of its ellipse in rows of blocks
BLEND_BLOCK, BLEND_PAIR = ALPHA_BLOCK + 6, 20
# weight, transmittance, stop, colours 7, dL/dalpha 5, moments 5; per pair: sums over lanes
GRADS_BLOCK, GRADS_PAIR = ALPHA_BLOCK + 20, 30
COUNT_BLOCK = 1  # F: one more sum
GRADS_MASK_BLOCK = 3  # dF/dM
BEHIND_BLOCK = ALPHA_BLOCK + 1  # F behind the stop: transmittance
GRADS_BEHIND_BLOCK = ALPHA_BLOCK + 6  # the same, 1 / (1 - alpha) and dF/dM

# Slots of one lane per visible Gaussian: covariance, projection, SH of degree 3; the derivative takes twice
# as many.
PROJECT_SLOTS, PARAMETER_SLOTS = 450, 900
OVERLAP_SLOTS = 15  # slots of one lane per pair: the bounds of an ellipse in a row of tiles

# Bytes per Gaussian.
LINE = 64  # cache line
CULL = 28  # read of each Gaussian, visible or not: means 12, log_scales 12, opacity 4
MEANS = SCALES = 12
QUATS, OPACITY, SH = 16, 4, 12  # SH: per coefficient
RECORD = 64  # of a projected Gaussian, as blending reads it
LISTED = 8 + 4 + 4  # rectangle of tiles, id and depth of a projected Gaussian
SUMS = 40  # ten float sums over pixels: centre 2, conic 3, opacity 1, colour 3, mask 1
MASK = 4  # existence logit, or dL/dM
# per pair: the pair, its key and the entry of the list are written and read once each; its hit flags are
# written
PAIR = 3 * 2 * 8 + 2
# per visible Gaussian: rectangle and id are read; tiles, id and offset are written
TILE_ENTRY = 8 + 4 + 2 * (12 + 8)

# flop per pixel and channel: four blurs of 11 + 11 taps, three more for the gradient
LOSS_FLOP = 0.25e9 / (640 * 360 * 3)
LOSS_BYTES = 12  # per pixel and channel: image and target are read, the gradient is written


def row_lines(ids: np.ndarray, sh_degree: int) -> dict[str, int]:
    """The number of cache lines that hold rows `ids` (ascending) of the parameters and their moments, by the
    bytes of a row. The arrays start at a cache line."""
    return {str(row): _lines(ids, row) for row in sorted({*_rows(sh_degree), *_moment_rows(sh_degree)})}


def _rows(sh_degree: int) -> tuple[int, ...]:
    """Bytes per row of each parameter, existence logits included."""
    return MEANS, SCALES, QUATS, OPACITY, SH * SH_COEFFICIENTS[sh_degree], MASK


def _moment_rows(sh_degree: int) -> tuple[int, ...]:
    """Bytes per row of the moments of each parameter."""
    (_, words), _ = moments_like((1, SH_COEFFICIENTS[sh_degree], 3), np.float32)
    return MEANS, SCALES, QUATS, OPACITY, 4 * words, MASK


def _lines(ids: np.ndarray, row: int) -> int:
    first = ids.astype(np.int64) * row // LINE
    last = (ids.astype(np.int64) * row + row - 1) // LINE
    return int((last - first + 1).sum() - (first[1:] == last[:-1]).sum())


def stage_floors(work: dict, facts: dict, level: str, peak: dict) -> dict[str, float]:
    """The floor of each stage in seconds. work: measure.work_counts(); facts: Case.facts; peak:
    native.peaks() with the same threads."""
    slot = 2 * LANES[level] / peak["fma"]
    block, lane = 2 * BLOCK_PIXELS / peak["fma"], 2 / peak["fma"]
    read, update = 1 / peak["read"], 1 / peak["update"]
    visible, rows = work["visible"], _rows(facts["sh_degree"])
    values = 3 * facts["width"] * facts["height"]
    in_lines = {row: LINE * work["row_lines"][str(row)] for row in rows}
    # bytes per Gaussian; bytes of the lines of all visible Gaussians
    stored, touched = sum(rows), sum(in_lines[row] for row in rows)
    moments = sum(LINE * work["row_lines"][str(row)] for row in _moment_rows(facts["sh_degree"]))
    behind = max(0, work["hit_blocks_full"] - work["hit_blocks"])
    counters = COUNT_BLOCK * work["hit_blocks"] * block
    grads = (GRADS_BLOCK + GRADS_MASK_BLOCK) * work["hit_blocks"] + GRADS_BEHIND_BLOCK * behind
    projected = (CULL * facts["count"] + in_lines[QUATS] + in_lines[rows[4]]) * read
    projected += 2 * (RECORD + LISTED) * visible * update
    floors = {
        "project": max(PROJECT_SLOTS * visible * lane, projected),
        "tiles": max(OVERLAP_SLOTS * work["pairs"] * lane, TILE_ENTRY * visible * update),
        "sort": PAIR * work["pairs"] * update,
        "blend": max(
            BLEND_BLOCK * work["hit_blocks"] * block + BLEND_PAIR * work["used_pairs"] * slot,
            RECORD * visible * read,
        ),
        "mask": BEHIND_BLOCK * behind * block + counters,
        "mask_visible": counters,
        "raster_grads": max(
            grads * block + GRADS_PAIR * work["used_pairs_full"] * slot, (RECORD + SUMS) * visible * update
        ),
        "parameter_grads": max(
            PARAMETER_SLOTS * visible * lane,
            (touched + (RECORD + SUMS) * visible) * read + 2 * stored * visible * update,
        ),
        "loss": max(LOSS_FLOP * values / peak["fma"], LOSS_BYTES * values * update),
        "adam": (2 * touched + 2 * moments + stored * visible) * update,
    }
    floors["forward"] = sum(floors[name] for name in ("project", "tiles", "sort", "blend", "mask"))
    floors["backward"] = floors["raster_grads"] + floors["parameter_grads"]
    # gradients that are written and read again; a step uses them at once and does not store them
    stored_grads = 3 * stored * visible * update
    floors["step"] = sum(floors[name] for name in ("forward", "loss", "backward", "adam")) - stored_grads
    return floors

"""The least time each stage could take on this machine: operations over the measured FMA peak, or the memory it must move over
the measured memory peaks, whichever is more.

Memory moves in lines of 64 bytes. Visible Gaussians leave gaps, so rows are counted with the lines they lie in (row_lines);
what is stored without having been read is fetched first and written back later: twice its bytes. Stored past the caches, as records are,
they are written once, but hardly faster: at 35-38 GB/s where updates move 67 both ways (measured once; no command repeats it).

An operation is one vector instruction of W lanes that computes: a multiply-add (2 W flop at the peak), and an addition, comparison,
minimum or shift in the place of one. Loads, moves and masks are left out, as if they all ran beside. What a block needs is counted
for all its 16 pixels, so 16 / W instructions a slot; what a pair needs is done once whatever the lanes.
"""

from __future__ import annotations

import numpy as np

from ..native import moments_like
from ..scene import SH_COEFFICIENTS

LANES = {"scalar": 1, "baseline": 4, "avx2": 8, "avx512": 16, "float64": 1}
BLOCK_PIXELS = 16

# Slots per hit block, and per (Gaussian, tile) pair that hits a pixel.
ALPHA_BLOCK = 20  # offset 2, exponent 5, 2^x 11, test and clamp
BLEND_BLOCK, BLEND_PAIR = ALPHA_BLOCK + 6, 20  # weight, transmittance, stop, colours 3; per pair where its ellipse enters and leaves rows of blocks
GRADS_BLOCK, GRADS_PAIR = ALPHA_BLOCK + 20, 30  # weight, transmittance, stop, colours 7, dL/dalpha 5, moments 5; per pair sums over lanes
COUNT_BLOCK = 1  # F: one more sum
GRADS_MASK_BLOCK = 3  # dF/dM
BEHIND_BLOCK = ALPHA_BLOCK + 1  # F behind the stop: transmittance
GRADS_BEHIND_BLOCK = ALPHA_BLOCK + 6  # the same, 1 / (1 - alpha) and dF/dM

# Slots of one lane per visible Gaussian: covariance, projection, SH of degree 3; the derivative takes twice that.
PROJECT_SLOTS, PARAMETER_SLOTS = 450, 900
OVERLAP_SLOTS = 15  # of one lane per pair: where an ellipse enters and leaves a row of tiles

# Bytes per Gaussian.
LINE = 64  # of memory
CULL = 28  # read of each one, visible or not: means 12, log_scales 12, opacity 4
MEANS = SCALES = 12
QUATS, OPACITY, SH = 16, 4, 12  # SH per coefficient
RECORD = 64  # what blending reads of a projected Gaussian
LISTED = 8 + 4 + 4  # its rectangle of tiles, id and depth
SUMS = 40  # ten float sums from the pixels: centre 2, conic 3, opacity 1, colour 3, mask 1
MASK = 4  # of the mask's logit, or dL/dM
PAIR = 3 * 2 * 8 + 2  # a pair, its key and the list's entry are written and read once each, its hit flags are written
FOUND = 8 + 4 + 2 * (12 + 8)  # its rectangle and id read; its tiles, id and place written

LOSS_FLOP = 0.25e9 / (640 * 360 * 3)  # per pixel and channel: four blurs of 11 + 11 taps, three more for the gradient
LOSS_BYTES = 12  # image and target read, gradient written


def row_lines(ids: np.ndarray, sh_degree: int) -> dict[str, int]:
    """Lines of memory that rows `ids` (ascending) of each parameter and its moments lie in, by the bytes of a row, for arrays that begin
    with a line."""
    return {str(row): _lines(ids, row) for row in sorted({*_rows(sh_degree), *_moment_rows(sh_degree)})}


def _rows(sh_degree: int) -> tuple[int, ...]:
    """Bytes of a row of each parameter, mask logits included."""
    return MEANS, SCALES, QUATS, OPACITY, SH * SH_COEFFICIENTS[sh_degree], MASK


def _moment_rows(sh_degree: int) -> tuple[int, ...]:
    """The same of their moments."""
    (_, words), _ = moments_like((1, SH_COEFFICIENTS[sh_degree], 3), np.float32)
    return MEANS, SCALES, QUATS, OPACITY, 4 * words, MASK


def _lines(ids: np.ndarray, row: int) -> int:
    first = ids.astype(np.int64) * row // LINE
    last = (ids.astype(np.int64) * row + row - 1) // LINE
    return int((last - first + 1).sum() - (first[1:] == last[:-1]).sum())


def stage_floors(work: dict, facts: dict, level: str, peak: dict) -> dict[str, float]:
    """Seconds per stage. work: measure.work_counts; facts: Case.facts; peak: native.peaks with the threads measured."""
    slot = 2 * LANES[level] / peak["fma"]
    block, lane = 2 * BLOCK_PIXELS / peak["fma"], 2 / peak["fma"]
    read, update = 1 / peak["read"], 1 / peak["update"]
    visible, rows = work["visible"], _rows(facts["sh_degree"])
    values = 3 * facts["width"] * facts["height"]
    in_lines = {row: LINE * work["row_lines"][str(row)] for row in rows}
    stored, touched = sum(rows), sum(in_lines[row] for row in rows)  # bytes of a Gaussian; of all visible ones in whole lines
    moments = sum(LINE * work["row_lines"][str(row)] for row in _moment_rows(facts["sh_degree"]))
    behind = max(0, work["hit_blocks_full"] - work["hit_blocks"])
    counters = COUNT_BLOCK * work["hit_blocks"] * block
    grads = (GRADS_BLOCK + GRADS_MASK_BLOCK) * work["hit_blocks"] + GRADS_BEHIND_BLOCK * behind
    projected = (CULL * facts["count"] + in_lines[QUATS] + in_lines[rows[4]]) * read + 2 * (RECORD + LISTED) * visible * update
    floors = {
        "project": max(PROJECT_SLOTS * visible * lane, projected),
        "tiles": max(OVERLAP_SLOTS * work["pairs"] * lane, FOUND * visible * update),
        "sort": PAIR * work["pairs"] * update,
        "blend": max(BLEND_BLOCK * work["hit_blocks"] * block + BLEND_PAIR * work["used_pairs"] * slot, RECORD * visible * read),
        "mask": BEHIND_BLOCK * behind * block + counters,
        "mask_visible": counters,
        "raster_grads": max(grads * block + GRADS_PAIR * work["used_pairs_full"] * slot, (RECORD + SUMS) * visible * update),
        "parameter_grads": max(PARAMETER_SLOTS * visible * lane, (touched + (RECORD + SUMS) * visible) * read + 2 * stored * visible * update),
        "loss": max(LOSS_FLOP * values / peak["fma"], LOSS_BYTES * values * update),
        "adam": (2 * touched + 2 * moments + stored * visible) * update,
    }
    floors["forward"] = sum(floors[name] for name in ("project", "tiles", "sort", "blend", "mask"))
    floors["backward"] = floors["raster_grads"] + floors["parameter_grads"]
    passed_on = 3 * stored * visible * update  # gradients written and read again: not in a step, which uses them at once
    floors["step"] = sum(floors[name] for name in ("forward", "loss", "backward", "adam")) - passed_on
    return floors

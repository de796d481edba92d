"""The least time each stage could take on this machine: operations over the measured FMA peak, or bytes over the measured
memory peaks, whichever is more.

An operation is one vector instruction of W lanes that multiplies (and adds): 2 W flop at the peak. Additions, comparisons and
moves are left out, as if they all ran beside: on some processors they do. What a block needs is counted for all its 16 pixels,
so 16 / W instructions a slot; what a pair needs is done once whatever the lanes.
"""

from __future__ import annotations

from ..scene import SH_COEFFICIENTS

LANES = {"scalar": 1, "baseline": 4, "avx2": 8, "avx512": 16, "float64": 1}
BLOCK_PIXELS = 16

# Slots per hit block, and per (Gaussian, tile) pair that hits a pixel.
BLEND_BLOCK, BLEND_PAIR = 15, 20  # exponent 5, 2^x 6, weight 1, colours 3; per pair where its ellipse enters and leaves rows of blocks
GRADS_BLOCK, GRADS_PAIR = 29, 30  # exponent 5, 2^x 6, weight 1, colours 7, dL/dalpha 5, moments 5; per pair sums over lanes
COUNT_BLOCK = 1  # F: one more sum
GRADS_MASK_BLOCK = 3  # dF/dM
BEHIND_BLOCK = 12  # F behind the stop: exponent, 2^x, transmittance
GRADS_BEHIND_BLOCK = 17  # the same, 1 / (1 - alpha) and dF/dM

# Slots of one lane per visible Gaussian: covariance, projection, SH of degree 3; the derivative takes twice that.
PROJECT_SLOTS, PARAMETER_SLOTS = 450, 900
OVERLAP_SLOTS = 15  # of one lane per pair: where an ellipse enters and leaves a row of tiles

# Bytes per Gaussian.
GEOMETRY = 44  # means 12, log_scales 12, quats 16, opacity 4
SH_BYTES = 12  # per coefficient
RECORD = 64  # what blending reads of a projected Gaussian
SUMS = 40  # ten float sums from the pixels: centre 2, conic 3, opacity 1, colour 3, mask 1
MASK_GRAD = 4
SORT = 3 * 2 * 8  # three radix passes read and write key and id, 4 B each
PAIR = 8 + 8 + 2  # a tile entry is written and read once, its hit flags are written
EXTENT = 2 * 16  # first tile, rows and tiles of a Gaussian, read and written
ADAM = 28  # per parameter: value and two moments read and written, gradient read

LOSS_FLOP = 0.25e9 / (640 * 360 * 3)  # per pixel and channel: four blurs of 11 + 11 taps, three more for the gradient
LOSS_BYTES = 12  # image and target read, gradient written


def stage_floors(work: dict, facts: dict, level: str, peak: dict) -> dict[str, float]:
    """Seconds per stage. work: measure.work_counts; facts: Case.facts; peak: native.peaks with the threads measured."""
    slot = 2 * LANES[level] / peak["fma"]
    block, lane = 2 * BLOCK_PIXELS / peak["fma"], 2 / peak["fma"]
    read, update = 1 / peak["read"], 1 / peak["update"]
    visible, coefficients = work["visible"], SH_COEFFICIENTS[facts["sh_degree"]]
    values = 3 * facts["width"] * facts["height"]
    stored = GEOMETRY + SH_BYTES * coefficients
    behind = max(0, work["hit_blocks_full"] - work["hit_blocks"])
    counters = COUNT_BLOCK * work["hit_blocks"] * block
    grads = (GRADS_BLOCK + GRADS_MASK_BLOCK) * work["hit_blocks"] + GRADS_BEHIND_BLOCK * behind
    floors = {
        "project": max(
            PROJECT_SLOTS * visible * lane,
            (GEOMETRY * facts["count"] + (SH_BYTES * coefficients + RECORD) * visible) * read,
        ),
        "tiles": max(OVERLAP_SLOTS * work["pairs"] * lane, EXTENT * visible * update),
        "sort": (SORT * visible + PAIR * work["pairs"]) * update,
        "blend": max(BLEND_BLOCK * work["hit_blocks"] * block + BLEND_PAIR * work["used_pairs"] * slot, RECORD * visible * read),
        "mask": BEHIND_BLOCK * behind * block + counters,
        "mask_visible": counters,
        "raster_grads": max(grads * block + GRADS_PAIR * work["used_pairs_full"] * slot, (RECORD + SUMS) * visible * update),
        "parameter_grads": max(PARAMETER_SLOTS * visible * lane, (2 * stored + RECORD + SUMS + MASK_GRAD) * visible * update),
        "loss": max(LOSS_FLOP * values / peak["fma"], LOSS_BYTES * values * update),
        "adam": ADAM * (stored / 4 + 1) * visible * update,
    }
    floors["forward"] = sum(floors[name] for name in ("project", "tiles", "sort", "blend", "mask"))
    floors["backward"] = floors["raster_grads"] + floors["parameter_grads"]
    passed_on = 2 * stored * visible * update  # gradients written and read again: not in a step, which uses them at once
    floors["step"] = sum(floors[name] for name in ("forward", "loss", "backward", "adam")) - passed_on
    return floors

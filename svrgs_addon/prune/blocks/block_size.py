"""The largest number of Gaussians of a block for which the available memory suffices."""

from __future__ import annotations

from collections.abc import Sequence

from ...scene.camera import Camera
from ...system import memory
from .divided import MAX_BLOCK_COUNT, MaxBlockCount
from .learning import AROUND_SHARE
from .merging import CELL

# of the available memory, for fine-tuning; the rest is for scores, for reading, and for freed memory that the
# system does not get back
SHARE = 0.5


def as_memory_allows(cameras: Sequence[Camera], kept_photographs: int) -> MaxBlockCount:
    """A function that gives the largest number of Gaussians of a block: MAX_BLOCK_COUNT; or less, but at
    least CELL, where SHARE of the available memory is too little to fine-tune a block and the Gaussians
    around it. cameras, kept_photographs (bytes): as for memory.tuning()."""

    def fitting(count: int, coefficients: int) -> int:
        most = min(MAX_BLOCK_COUNT, count)
        while most >= 2 * CELL:
            # of a level of detail of the others, at most as many as the block has
            tuned = most + min(most, round(AROUND_SHARE * (count - most)))
            needed = memory.tuning(tuned, coefficients, cameras, kept_photographs) / SHARE
            if not memory.shortage("", int(needed)):
                break
            most = -(-most // 2)
        return most

    return fitting

"""The largest number of Gaussians of a block for which the available memory suffices."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

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
    return partial(_fitting, cameras=cameras, kept_photographs=kept_photographs)


def _fitting(count: int, coefficients: int, cameras: Sequence[Camera], kept_photographs: int) -> int:
    most = min(MAX_BLOCK_COUNT, count)
    while most >= 2 * CELL and memory.shortage(
        "", int(memory.tuning(_tuned(most, count), coefficients, cameras, kept_photographs) / SHARE)
    ):
        most = -(-most // 2)
    return most


def _tuned(most: int, count: int) -> int:
    """Gaussians in the fine-tuning of a block: its own, and around it a level of detail of the others, with
    at most as many."""
    return most + min(most, round(AROUND_SHARE * (count - most)))

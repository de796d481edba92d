"""How many Gaussians a block may have, so that memory holds what is done with it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from .. import memory
from ..camera import Camera
from .blocks import MOST, Most
from .learning import AROUND_SHARE
from .merging import CELL

SHARE = 0.5  # of the available memory that fine-tuning may take; sums, readings and what was freed but not returned take the rest


def as_memory_allows(cameras: Sequence[Camera], kept_photographs: int) -> Most:
    """Gives the size of the blocks of a scene: MOST, or less, but not less than CELL, if memory is too short to fine-tune so many with what is around them.
    cameras, kept_photographs: as for memory.tuning()."""
    return partial(_fitting, cameras=cameras, kept_photographs=kept_photographs)


def _fitting(count: int, coefficients: int, cameras: Sequence[Camera], kept_photographs: int) -> int:
    most = min(MOST, count)
    while most >= 2 * CELL and memory.shortage("", int(memory.tuning(_tuned(most, count), coefficients, cameras, kept_photographs) / SHARE)):
        most = -(-most // 2)
    return most


def _tuned(most: int, count: int) -> int:
    """The Gaussians that are tuned with a block: its own, and of a level of detail of the others at most as many."""
    return most + min(most, round(AROUND_SHARE * (count - most)))

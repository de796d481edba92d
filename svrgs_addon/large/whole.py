"""All steps of pruning by blocks, one after the other, on this machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..camera import Camera
from ..files.atomic import check_writable, reserved
from ..files.registry import format_to_write, refuse_input
from .blocks import MOST, Tell, divide
from .folder import measured_views, prepare, refuse_foreign, remove, scored_views
from .merging import merge, reduce
from .pruning import finish
from .scoring import score
from .tuning import EPOCHS, cut, tune

Told = Callable[[str], Tell]  # of the name of a step


def check_out(out: Path, source: Path):
    """Raises SplatError if the output cannot be written, or is the scene itself."""
    format_to_write(out)
    check_writable(out)
    refuse_input(out, source)


def prune_by_blocks(
    source: Path, out: Path, views: Callable[[], tuple[Sequence[Camera], Sequence[Camera]]], wanted: Callable[[int], int], steps: int | None, told: Told,
    work: Path | None = None, block: int = MOST,
) -> dict[str, Any]:  # fmt: skip
    """Removes and merges Gaussians, fine-tunes what is left, writes and measures it.

    views: gives the views that are scored and tuned on, and those on which the result is measured; it is called after the outputs are checked. wanted: how many
    Gaussians stay of so many. steps: of fine-tuning; None: EPOCHS for each view. work: folder for the blocks, which are removed at the end; None:
    beside the output. block: Gaussians of a block, at most. Returns the JSON result. Raises SplatError, and what `told` raises.
    """
    work = work or out.with_name(out.name + ".blocks")
    check_out(out, source)
    with reserved(out):
        refuse_foreign(work)
        try:
            prepare(work, *views())
            divided, scored = divide(source.absolute(), work, block, told("divide")), scored_views(work)
            score(divided, scored, 0, 1, told("score"))
            reduce(divided, scored)
            for number in range(len(divided.blocks)):
                told("merge")(f"block {number}", number / len(divided.blocks))
                merge(divided, number)
            left = cut(divided, scored, wanted(divided.count), told("cut"))
            steps = EPOCHS * len(scored) if steps is None else steps
            for number in range(len(left.blocks) if steps else 0):
                tune(divided, number, scored, steps, told("tune"))
            return finish(divided, measured_views(work), out, told)
        finally:
            remove(work)

"""As few Gaussians as an allowed drop in PSNR leaves (--max-drop)."""

from __future__ import annotations

import contextlib
import math
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from ...files.registry import format_to_write
from ...finetune.methods.removal import floor_of_drop
from ...finetune.plan import Plan
from ...finetune.quality import MIN_SHARE, fewest, squared_error
from ...render.metrics.allowed_loss import ASSUMED, refuse_loss
from ...scene.camera import Camera
from ..likeness import Likeness, assumed_psnr
from .divided import Divided, ProgressOf, divide
from .folder import HELD
from .merging import most_needed
from .pruning import write_joined
from .tuning import CUT, cut, written


def errors_of_format(
    divided: Divided, likeness: Likeness, allowed: float, out: Path, progress_of: ProgressOf
) -> list[float]:
    """The mean squared error in each view of the whole scene as the format of the output holds it. Raises
    SplatError; SceneError if the format alone loses the allowed drop in dB, or without views."""
    likeness.refuse_without_views()
    if format_to_write(out).lossless:
        return [0.0] * len(likeness.views)
    with _held(divided, out, progress_of) as stored:
        errors = [squared_error(value) for value in likeness.psnrs(stored, "try")]
    refuse_loss(out, ASSUMED - assumed_psnr([math.inf] * len(errors), errors), allowed)
    return errors


def fewest_within(
    divided: Divided,
    scored: Sequence[Camera],
    likeness: Likeness,
    allowed: float,
    errors: Sequence[float],
    progress_of: ProgressOf,
) -> int:
    """The fewest Gaussians, at least MIN_SHARE of them, that hold the allowed drop in dB before fine-tuning,
    which wins a part of it back. scored: the views that were scored. errors: from errors_of_format(). Raises
    SplatError."""

    def within(count: int) -> bool:
        left = cut(divided, scored, count, progress_of("try"))
        return assumed_psnr(likeness.psnrs(left, "try"), errors) >= ASSUMED - allowed

    return fewest(math.ceil(MIN_SHARE * divided.count), divided.count, within)


def floor_on_photographs(
    divided: Divided, likeness: Likeness, allowed: float, plan: Plan, out: Path, progress_of: ProgressOf
) -> float:
    """The PSNR in dB against photographs that a removal may leave without any learning, for an allowed drop
    at the end of the plan. What the format of the output loses of the whole scene counts. Raises SplatError;
    SceneError if the format alone loses the allowed drop."""
    before, loss = likeness.psnr(divided), 0.0
    if not format_to_write(out).lossless:
        with _held(divided, out, progress_of) as stored:
            loss = max(0.0, before - likeness.psnr(stored))
        refuse_loss(out, loss, allowed)
    return floor_of_drop(before, replace(plan, max_loss=allowed - loss))


def fewest_above(divided: Divided, likeness: Likeness, floor: float, progress_of: ProgressOf) -> int:
    """The fewest Gaussians of highest removal error, at least MIN_SHARE of all, with this PSNR in dB. Raises
    SplatError."""

    def within(count: int) -> bool:
        left = written(divided, most_needed(divided, count, progress_of("try")), CUT)
        return likeness.psnr(left) >= floor

    return fewest(math.ceil(MIN_SHARE * divided.count), divided.count, within)


@contextlib.contextmanager
def _held(divided: Divided, out: Path, progress_of: ProgressOf) -> Iterator[Divided]:
    """The scene as the format of the output holds it, divided as long as the context lasts."""
    progress_of("try")("writes the scene in the format of the output", 0.0)
    folder = divided.folder / HELD
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        write_joined(divided, folder / out.name)
        yield divide(folder / out.name, folder / "blocks")
    finally:
        shutil.rmtree(folder, ignore_errors=True)

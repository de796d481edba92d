"""As few Gaussians as an allowed drop in PSNR leaves (--max-drop)."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import fmean

from ..camera import Camera
from ..errors import SceneError
from ..files.registry import format_to_write
from ..finetune.quality import LEAST, bisected, squared_error
from ..metrics.format_loss import ASSUMED, refuse_loss
from ..metrics.psnr import with_error
from ..photographs.rendered import PHOTOGRAPHED
from .blocks import Divided, Tell, divide
from .folder import HELD
from .likeness import EQUAL, Likeness
from .pruning import write_joined
from .tuning import cut

STEP = 0.01  # share of the Gaussians to which the number is found


def errors_of_format(divided: Divided, likeness: Likeness, allowed: float, out: Path, told: Callable[[str], Tell]) -> list[float]:
    """The mean squared error in each view of the whole scene as the format of the output holds it. Raises SplatError; SceneError if the format alone loses
    the allowed drop in dB, or without views."""
    if not likeness.views:
        raise SceneError("--max-drop is measured in views that are held out, and there are none: give more cameras, or --target")
    if format_to_write(out).lossless:
        return [0.0] * len(likeness.views)
    told("try")("writes the scene in the format of the output", 0.0)
    folder = divided.folder / HELD
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    write_joined(divided, folder / out.name)
    errors = [squared_error(value) for value in likeness.psnrs(divide(folder / out.name, folder / "blocks"), "try")]
    shutil.rmtree(folder, ignore_errors=True)
    refuse_loss(out, ASSUMED - _psnr([EQUAL] * len(errors), errors), allowed)
    return errors


def fewest_within(divided: Divided, scored: Sequence[Camera], likeness: Likeness, allowed: float, errors: Sequence[float], told: Callable[[str], Tell]) -> int:
    """The fewest Gaussians, at least LEAST of them, that hold the allowed drop in dB before fine-tuning, which wins a part of it back. As if PHOTOGRAPHED were
    the error of the original. scored: the views that were scored. errors: from errors_of_format(). Raises SplatError."""

    def within(count: int) -> bool:
        left = cut(divided, scored, count, told("try"))
        return _psnr(likeness.psnrs(left, "try"), errors) >= ASSUMED - allowed

    return bisected(math.ceil(LEAST * divided.count) - 1, divided.count, int(STEP * divided.count), within)


def drop(psnr: float) -> float:
    """The drop in dB of a result with this PSNR against the original."""
    return ASSUMED - with_error(psnr, PHOTOGRAPHED)


def _psnr(values: Sequence[float], errors: Sequence[float]) -> float:
    """Mean PSNR in dB, of each view with PHOTOGRAPHED and a further mean squared error."""
    return fmean(with_error(value, PHOTOGRAPHED + error) for value, error in zip(values, errors, strict=True))

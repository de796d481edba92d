"""An allowed drop in PSNR (--max-drop): what the format of the output takes of it, because it stores values
in few bits, and whether the result holds it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from ...files.registry import as_stored, format_to_write
from ...scene.gaussians import Scene
from ...system.errors import SceneError
from ...views.rendered import PHOTOGRAPHED
from .measures import with_error

HALF = 3.01  # dB: half of the squared error
CLEARLY = 1.2  # times the allowed drop: a larger one is reported
EQUAL = 100.0  # dB: the PSNR of equal pictures counts as this
# PSNR of a scene in dB, where a drop is allowed and there are no photographs
ASSUMED = with_error(math.inf, PHOTOGRAPHED)


def format_loss(out: Path, scene: Scene, psnr_of: Callable[[Scene], float], allowed: float) -> float:
    """dB that the scene loses in the format of the output; 0 if every value is stored as it is. psnr_of: PSNR
    in dB of a scene. Raises SceneError if that alone is not less than what is allowed."""
    splat_format = format_to_write(out)
    if splat_format.lossless:
        return 0.0
    loss = max(0.0, psnr_of(scene) - psnr_of(as_stored(scene, splat_format)))
    refuse_loss(out, loss, allowed)
    return loss


def refuse_loss(out: Path, loss: float, allowed: float):
    """Raises SceneError if the format loses so many dB that nothing is left of what is allowed."""
    if loss >= allowed:
        raise SceneError(
            f"{out}: the format alone loses {loss:.2f} dB, not less than --max-drop allows: write another"
            " format"
        )


def loss_notes(values: float, stored: float) -> list[str]:
    """A sentence if the format of the output loses more of a result than pruning does. values, stored: PSNR
    in dB against the original before and after the result was written."""
    if not values - stored > HALF:
        return []
    if values >= EQUAL:
        return [
            f"all that is lost, the format of the output loses: PSNR {stored:.1f} dB against the original;"
            " another one may lose less"
        ]
    return [
        f"the format of the output loses more than pruning: {values:.1f} dB before it was written,"
        f" {stored:.1f} dB after; another one may lose less"
    ]


def missed_drop(lost: float | None, allowed: float) -> list[str]:
    """A sentence if a result has lost clearly more PSNR than was allowed, both in dB: what the steps will win
    back is estimated before them. lost: None where no drop is allowed."""
    if lost is None or not lost > CLEARLY * allowed:
        return []
    return [
        f"the result loses {lost:.2f} dB, more than the {allowed:g} dB that were allowed; allow less, or set"
        " a number of Gaussians that keeps more of them"
    ]

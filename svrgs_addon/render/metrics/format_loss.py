"""What the format of an output loses in PSNR: the values that it stores in few bits. It counts in an allowed
drop (--max-drop)."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from ...files.registry import as_held, format_to_write
from ...scene.gaussians import Scene
from ...system.errors import SceneError
from ...views.rendered import PHOTOGRAPHED
from .psnr import with_error

HALF = 3.01  # dB: half of the squared error
EQUAL = 100.0  # dB: the PSNR of equal pictures counts as this
# PSNR of a scene in dB, where a drop is allowed and there are no photographs
ASSUMED = with_error(math.inf, PHOTOGRAPHED)


def format_loss(out: Path, scene: Scene, psnr_of: Callable[[Scene], float], allowed: float) -> float:
    """dB that the scene loses in the format of the output; 0 if every value is stored as it is. psnr_of: PSNR
    in dB of a scene. Raises SceneError if that alone is not less than what is allowed."""
    splat_format = format_to_write(out)
    if splat_format.lossless:
        return 0.0
    loss = max(0.0, psnr_of(scene) - psnr_of(as_held(scene, splat_format)))
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

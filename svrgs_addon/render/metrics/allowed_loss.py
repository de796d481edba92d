"""An allowed loss of quality (--max-drop, --max-flip, --max-lpips): what it is counted in, what the format of
the output takes of it, because it stores values in few bits, and whether the result holds it.

Quality is what an allowed loss is taken from, the higher the better: PSNR in dB, or minus FLIP or LPIPS.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from ...files.registry import format_to_write, round_trip
from ...files.sh_rounding import SeenFrom
from ...scene.gaussians import Scene
from ...system.errors import SceneError
from ...views.rendered import PHOTOGRAPHED
from .measures import with_error


class Measure(NamedTuple):
    """What a loss is counted in."""

    option: str
    unit: str
    deepest: float  # how far a cut in the recovery may go below what is allowed


MEASURES = {
    "psnr": Measure("--max-drop", "dB", 2.0),
    "flip": Measure("--max-flip", "FLIP", 0.03),
    "lpips": Measure("--max-lpips", "LPIPS", 0.06),
}
HALF = 3.01  # dB: half of the squared error
CLEARLY = 1.2  # times the allowed loss: a larger one is reported
EQUAL = 100.0  # dB: the PSNR of equal pictures counts as this
# PSNR of a scene in dB, where a drop is allowed and there are no photographs
ASSUMED = with_error(math.inf, PHOTOGRAPHED)


def format_loss(
    out: Path,
    scene: Scene,
    quality_of: Callable[[Scene], float],
    allowed: float,
    measure: str,
    seen: SeenFrom | None = None,
) -> float:
    """What the scene loses in the format of the output; 0 if it is lossless. quality_of: of a scene. seen: as
    of write_scene(). Raises SceneError if that alone is not less than what is allowed."""
    splat_format = format_to_write(out)
    if splat_format.lossless:
        return 0.0
    stored, _ = round_trip(scene, splat_format, seen=seen)
    loss = max(0.0, quality_of(scene) - quality_of(stored))
    refuse_loss(out, loss, allowed, measure)
    return loss


def refuse_loss(out: Path, loss: float, allowed: float, measure: str = "psnr"):
    """Raises SceneError if the format loses so much that nothing is left of what is allowed."""
    if loss >= allowed:
        option, unit, _ = MEASURES[measure]
        raise SceneError(
            f"{out}: the format alone loses {loss:.3g} {unit}, not less than {option} allows: write another"
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


def rounding_notes(out: Path, psnr: float, stored: float) -> list[str]:
    """A sentence on what the format of the output costs, if that shows in the figures. psnr, stored: in dB
    against photographs, before and after the result was written."""
    cost, label = f"{stored - psnr:+.2f}", format_to_write(out).label
    if not float(cost):
        return []
    return [f"{label} stores values in few bits: {cost} dB; a .ply keeps every value"]


def missed_loss(lost: float | None, allowed: float, measure: str = "psnr") -> list[str]:
    """A sentence if a result has lost clearly more than was allowed: what the steps will win back is
    estimated before them. lost: None where no loss is allowed."""
    if lost is None or not lost > CLEARLY * allowed:
        return []
    unit = MEASURES[measure].unit
    return [
        f"the result loses {lost:.3g} {unit}, more than the {allowed:g} {unit} that were allowed; allow less,"
        " or set a number of Gaussians that keeps more of them"
    ]

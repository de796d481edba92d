"""The smallest file within an allowed loss (--quick with --max-drop, --max-flip or --max-lpips): how many
Gaussians stay and how exactly they are stored, decided together."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ..files.registry import format_to_write, round_trip
from ..finetune.decimate.order import Order
from ..finetune.quality import fewest
from ..render.metrics.allowed_loss import ASSUMED, MEASURES, refuse_loss
from ..scene.affine import scaled
from ..scene.gaussians import Scene
from ..system.errors import SceneError
from .door import Allowed

FACTORS = (1.0, 2.0, 4.0)  # on the error in SH, for formats that take one


def refuse_bands(order: Order, quality_of: Callable[[Scene], float], out: Path, allowed: Allowed):
    """Raises SceneError if leaving out SH bands costs all of the allowed loss, before a Gaussian is removed.
    quality_of: as of smallest_file()."""
    measure, degree = MEASURES[allowed.measure], order.scene.sh_degree
    loss = (ASSUMED if allowed.measure == "psnr" else 0.0) - quality_of(order.scene)
    if degree == format_to_write(out).most_degree:
        refuse_loss(out, loss, *allowed)
    if loss >= allowed.loss:
        raise SceneError(
            f"{out}: SH of degree {degree} alone lose {loss:.3g} {measure.unit}, not less than"
            f" {measure.option} allows: keep a higher degree"
        )


def smallest_file(
    order: Order, least: int, quality_of: Callable[[Scene], float], out: Path, allowed: Allowed, unit: float
) -> tuple[int, float]:
    """(count, quantise) of the smallest file that holds the allowed loss before the steps of
    fine-tuning, which win a part of it back. At least `least` Gaussians. A coarser factor is tried as long as
    it makes a smaller file.

    quality_of: of a scene (Likeness.quality()). unit: length of a unit of the order's scene in the file.
    Raises SceneError if the format alone loses so much.
    """
    total, best_of_all = order.scene.count, ASSUMED if allowed.measure == "psnr" else 0.0
    floor = best_of_all - allowed.loss
    splat_format, best, smallest = format_to_write(out), (total, 1.0), math.inf
    if splat_format.lossless:
        return fewest(least, total, lambda count: quality_of(order.at(count)) >= floor), 1.0

    def tried_with(count: int, factor: float) -> tuple[float, int]:
        held, size = round_trip(scaled(order.at(count), unit), splat_format, factor)
        return quality_of(scaled(held, 1 / unit)), size

    def holds(factor: float, count: int) -> bool:
        return tried_with(count, factor)[0] >= floor

    for factor in FACTORS if splat_format.quantises and order.scene.sh_degree else FACTORS[:1]:
        loss = best_of_all - tried_with(total, factor)[0]
        if factor == FACTORS[0]:
            refuse_loss(out, loss, *allowed)
        elif loss >= allowed.loss:
            break
        count = fewest(least, total, partial(holds, factor))
        size = tried_with(count, factor)[1]
        if size >= smallest:
            break
        best, smallest = (count, factor), size
    return best

"""The smallest file within an allowed drop (--quick --max-drop): how many Gaussians stay and how exactly they
are stored, decided together."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ..files.registry import format_to_write, round_trip
from ..finetune.decimate.order import Order
from ..finetune.quality import fewest
from ..render.metrics.max_drop import ASSUMED, refuse_loss
from ..scene.affine import scaled
from ..scene.gaussians import Scene

FACTORS = (1.0, 2.0, 4.0)  # on the error in SH, for formats that take one


def smallest_file(
    order: Order, least: int, psnr_of: Callable[[Scene], float], out: Path, allowed: float, unit: float
) -> tuple[int, float]:
    """(count, quantise) of the smallest file that holds the allowed drop in dB before the steps of
    fine-tuning, which win a part of it back. At least `least` Gaussians. A coarser factor is tried as long as
    it makes a smaller file.

    psnr_of: PSNR in dB of a scene. unit: length of a unit of the order's scene in the file. Raises SceneError
    if the format alone loses so much.
    """
    total, floor = order.scene.count, ASSUMED - allowed
    splat_format, best, smallest = format_to_write(out), (total, 1.0), math.inf
    if splat_format.lossless:
        return fewest(least, total, lambda count: psnr_of(order.at(count)) >= floor), 1.0

    def tried_with(count: int, factor: float) -> tuple[float, int]:
        held, size = round_trip(scaled(order.at(count), unit), splat_format, factor)
        return psnr_of(scaled(held, 1 / unit)), size

    def holds(factor: float, count: int) -> bool:
        return tried_with(count, factor)[0] >= floor

    for factor in FACTORS if splat_format.quantises and order.scene.sh_degree else FACTORS[:1]:
        loss = ASSUMED - tried_with(total, factor)[0]
        if factor == FACTORS[0]:
            refuse_loss(out, loss, allowed)
        elif loss >= allowed:
            break
        count = fewest(least, total, partial(holds, factor))
        size = tried_with(count, factor)[1]
        if size >= smallest:
            break
        best, smallest = (count, factor), size
    return best

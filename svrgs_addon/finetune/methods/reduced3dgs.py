"""Reduced-3DGS (arXiv 2406.17074): its pruning removes faint Gaussians where many cover the same place, every
1000 steps until 3000 before the end, and invisible ones after densification. A penalty lowers the opacity of
the Gaussians that the view sees.

Redundancy says how many Gaussians cover the places that a Gaussian covers. Each Gaussian has a sphere at its
centre, as large as a pixel there: its radius is half the diagonal of a cube whose side is the smallest
footprint that a pixel has at the centre, over all views. A sphere meets another Gaussian if it meets its
ellipsoid, whose semi-axes are the scales. The sphere's count is the number of Gaussians that it meets among
its 30 nearest neighbours, and itself. The redundancy of a Gaussian is the smallest count of all spheres that
meet it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...native.library import near_depth
from ...scene.camera import Camera
from ...scene.neighbours import nearest_rows
from ...scene.rotations import rotation_matrices
from ..model import Model
from ..penalties import MeanSeenOpacity, sigmoid
from ..run_view import Keep, RunView
from ..scores import top
from ..settings import Phase, Settings
from .stepwise import Stepwise

# opacity below which Gaussians are removed, every so many steps; ten times as many lie between two events
INVISIBLE, EVERY = 1 / 255, 100
NEIGHBOURS = 30
UNSEEN = 10_000.0  # footprint where no view sees the centre: everything near is met
BLOCK = 8_192  # spheres that are tested at a time


@dataclass
class Reduced3DGS(Stepwise):
    EVENTS: ClassVar = tuple(k / 15 for k in range(13))
    lambda_m: float = 1e-3

    def ranking_passes(self, settings: Settings, steps: int, share: float) -> list[tuple[float, float]]:
        return []  # its events render nothing

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        return {"penalties": (MeanSeenOpacity(run.plan.lambda_m),)}

    def after_densification(self, run: RunView, phase: Phase, number: int) -> Keep:
        due = phase.densify and number % (10 * EVERY) == 0 and number % phase.densify.reset_every
        return survivors(run.model, run.viewed.cameras) if due else None

    def event(self, run: RunView, done: int) -> Keep:
        # with a target what the rule keeps comes first, then what has a higher opacity
        keep = survivors(run.model, run.viewed.cameras)
        return (
            top(keep + sigmoid(run.model.opacity_logits, np), self.falling(run, done)) if run.target else keep
        )

    def after_step(self, run: RunView, phase: Phase, number: int) -> Keep:
        keep, logits = super().after_step(run, phase, number), run.model.opacity_logits
        if keep is not None or number % EVERY:
            return keep
        return (sigmoid(logits, np) >= INVISIBLE) | top(logits, run.target)


def redundancy(model: Model, cameras: Sequence[Camera]) -> np.ndarray:
    """The redundancy of each Gaussian, (N,) int64, at least 1."""
    n, counts = model.count, np.ones(model.count, np.int64)
    if n < 2:
        return counts
    neighbours = nearest_rows(model.means, min(NEIGHBOURS, n - 1))
    radii = pixel_footprints(model.means, cameras) * np.sqrt(3) / 2
    met = np.empty(neighbours.shape, bool)
    for start in range(0, n, BLOCK):
        rows = slice(start, start + BLOCK)
        met[rows] = _meets(model, np.arange(n)[rows], neighbours[rows], radii[rows])
    counts += met.sum(axis=1)
    lowest = counts.copy()
    np.minimum.at(lowest, neighbours[met], np.repeat(counts, met.sum(axis=1)))
    return lowest


def _meets(model: Model, rows: np.ndarray, others: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """(A, K) bool: whether spheres of `rows` (A,), radii (A,), meet ellipsoids of `others` (A, K)."""
    offsets = model.means[rows, None].astype(np.float64) - model.means[others]
    R = rotation_matrices(model.quats[others.ravel()]).reshape(*others.shape, 3, 3)
    local = np.einsum("akji,akj->aki", R, offsets)
    reach = np.exp(model.log_scales[others].astype(np.float64)) + radii[:, None, None]
    return ((local / reach) ** 2).sum(axis=2) < 1


def pixel_footprints(points: np.ndarray, cameras: Sequence[Camera]) -> np.ndarray:
    """(N,) float64: the smallest side of a pixel, world units, at points (N, 3), over all views with it."""
    smallest = np.full(len(points), UNSEEN)
    for camera in cameras:
        x, y, z = camera.local(points.astype(np.float64)).T
        seen = z > near_depth(camera.unit)
        z = np.where(seen, z, 1)
        u, v = camera.K[0, 0] * x / z + camera.K[0, 2], camera.K[1, 1] * y / z + camera.K[1, 2]
        seen &= (u >= 0) & (u <= camera.width) & (v >= 0) & (v <= camera.height)
        # published: of the longer side's pixels
        side = z / camera.K[0, 0] if camera.width > camera.height else z / camera.K[1, 1]
        smallest = np.where(seen, np.minimum(smallest, side), smallest)
    return smallest


def survivors(model: Model, cameras: Sequence[Camera]) -> np.ndarray:
    """(N,) bool: the Gaussians that stay by the published rule."""
    return stays(redundancy(model, cameras), sigmoid(model.opacity_logits, np))


def stays(redundancies: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    """(N,) bool by the published rule, from the redundancies (N,) and opacities (N,).

    Two kinds are removed: of the Gaussians whose redundancy is above the mean plus one standard deviation,
    and above 3, those with less than the median opacity among them; and those with an opacity below its 3 %
    quantile, and below 0.05.
    """
    deviation = redundancies.std(ddof=1) if len(opacity) > 1 else 0
    redundant = redundancies > max(redundancies.mean() + deviation, 3)
    of_those = np.sort(opacity[redundant])
    median = of_those[(len(of_those) - 1) // 2] if len(of_those) else 0.0  # of an even number the lower one
    return ~(redundant & (opacity < median)) & (opacity >= min(np.quantile(opacity, 0.03), 0.05))


METHODS = (
    Reduced3DGS(
        "reduced3dgs",
        "removes faint Gaussians from places that many Gaussians cover",
        24,
        "Reduced-3DGS",
        source="Reduced-3DGS, arXiv 2406.17074",
    ),
)

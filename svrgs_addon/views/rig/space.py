"""Where a splat has matter and where it is free: a grid of optical depths over the whole of space.

The grid is fine around the middle of the splat and coarser outside, so that a sky a thousand times as far
away has its cells too: the coordinates u = (x - centre) / half are kept inside the cube |u| <= 1 (largest
component), and contracted outside, to u (2 - 1/|u|) / |u|.

The optical depth of a cell is the sum over its Gaussians of opacity times projected area, divided by the area
of the cell's side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...files.registry import invisible
from ...native.library import near_depth
from ...scene.bounds import robust_box, weighted_quantiles
from ...scene.camera import unit_of
from ...scene.gaussians import Scene
from ...scene.rotations import rotated
from ...system.errors import SceneError

SAMPLES = 100_000  # Gaussians that count, at most, evenly spaced in the list
# the cube |u| <= 1 is WIDER times as wide as that which holds this share of the opacity
MIDDLE, WIDER = 0.4, 1.5
CELLS = 64  # along each axis
PIECES = 64  # points, at most, by which a Gaussian larger than a cell is spread over cells
# optical depths: below, a cell is free; above, it is matter; a ray that has met so much is blocked
FREE, SOLID, OPAQUE = 0.05, 0.5, 1.0
CLEARANCE = 1.25  # a camera keeps this multiple of the nearest rendered depth from matter
RAYS, MARCH = 32, 128  # directions in which the enclosure of a place is measured; steps of a ray
LARGEST_LOG, SMALLEST_LOG = 40.0, -40.0  # of log-scales that are taken as they are
# middle_and_radius() of a usual capture, and the least that counts as one
USUAL_RADIUS, LEAST_RADIUS = 3.3, 0.8


@dataclass(frozen=True)
class Matter:
    """The Gaussians that can be seen at all, at most SAMPLES of them, in the world of the scene. float64."""

    means: np.ndarray  # (P, 3)
    scales: np.ndarray  # (P, 3) standard deviations
    quats: np.ndarray  # (P, 4)
    opacities: np.ndarray  # (P,)
    step: int  # each stands for this many Gaussians
    unit: float  # of cameras that see it (Camera.unit)

    @property
    def areas(self) -> np.ndarray:
        """(P,) mean projected area, in the sense of the integral of exp(-q/2) over the picture plane."""
        a, b, c = self.scales.T
        return 2 * np.pi / 3 * (a * b + b * c + c * a)

    @property
    def widths(self) -> np.ndarray:
        """(P,) the width in a picture: twice the geometric mean of the two larger deviations."""
        largest = self.scales.max(axis=1)
        middle = self.scales.sum(axis=1) - largest - self.scales.min(axis=1)
        return 2 * np.sqrt(largest * middle)


def usable_rows(scene: Scene) -> np.ndarray:
    """(N,) bool: finite Gaussians with an opacity of at least 1/255. Raises SceneError if there are none."""
    good = np.isfinite(scene.opacity_logits) & np.isfinite(scene.sh[:, 0]).all(axis=1)
    for array in (scene.means, scene.log_scales, scene.quats):
        good &= np.isfinite(array).all(axis=1)
    if not good.any():
        raise SceneError(
            "the splat has no Gaussian with finite values, so there is nothing that cameras could look at"
        )
    good &= ~invisible(scene)
    if not good.any():
        raise SceneError(
            "all Gaussians of the splat are transparent, so there is nothing that cameras could look at"
        )
    return good


def middle_and_radius(scene: Scene) -> tuple[np.ndarray, float]:
    """Middle (3,) and half diagonal of the box around the scene's mass. Raises SceneError without mass."""
    opacities = 1 / (1 + np.exp(-np.clip(scene.opacity_logits.astype(np.float64), -80, 80)))
    box = robust_box(scene.means, opacities)
    if box is None:
        raise SceneError("the scene has no Gaussian with a position and an opacity")
    largest = float(np.exp(np.clip(np.median(scene.log_scales.max(axis=1).astype(np.float64)), -80, 80)))
    # one Gaussian is as large as its scale
    return box.mean(axis=0), max(float(np.linalg.norm(box[1] - box[0])) / 2, 3 * largest)


def unit_around(scene: Scene) -> float:
    """Camera.unit of cameras that see the scene, if they do not know it, by at most SAMPLES of its Gaussians.
    1 without mass."""
    try:
        _, radius = middle_and_radius(scene.select(slice(None, None, scene.count // SAMPLES + 1)))
    except SceneError:
        return 1.0
    return unit_of(radius, USUAL_RADIUS, LEAST_RADIUS)


def matter_of(scene: Scene) -> Matter:
    """The matter of a scene. Raises SceneError if nothing of it can be seen."""
    rows = np.flatnonzero(usable_rows(scene))
    step = -(-len(rows) // SAMPLES)
    rows = rows[::step]
    quats = scene.quats[rows].astype(np.float64)
    quats[np.linalg.norm(quats, axis=1) == 0] = (1, 0, 0, 0)
    scales = np.exp(np.clip(scene.log_scales[rows].astype(np.float64), SMALLEST_LOG, LARGEST_LOG))
    opacities = 1 / (1 + np.exp(-scene.opacity_logits[rows].astype(np.float64)))
    unit = unit_around(scene)
    return Matter(scene.means[rows].astype(np.float64), scales, quats, opacities, step, unit)


@dataclass(frozen=True)
class Space:
    """The grid, and where it lies in the world."""

    centre: np.ndarray  # (3,)
    half: float  # half the side of the cube that is not contracted
    depth: np.ndarray  # (CELLS, CELLS, CELLS) float64, optical depth
    near: float  # nothing that is nearer to a camera is drawn

    @classmethod
    def of(cls, matter: Matter) -> Space:
        """The space around the matter."""
        weights = matter.opacities
        centre = np.array([weighted_quantiles(axis, weights, 0.5) for axis in matter.means.T])
        half = WIDER * weighted_quantiles(np.abs(matter.means - centre).max(axis=1), weights, MIDDLE)
        least = max(weighted_quantiles(matter.widths, weights, 0.5), 1e-6 * np.abs(centre).max(), 1e-6)
        space = cls(centre, float(max(half, least)), np.zeros((CELLS,) * 3), near_depth(matter.unit))
        space._fill(matter)
        return space

    def _fill(self, matter: Matter):
        """Adds the optical depths. A Gaussian that is larger than its cell is spread over several points."""
        masses, cell = matter.opacities * matter.areas * matter.step, self.cell_size(matter.means)
        wanted = np.clip(np.ceil(2 * matter.areas / cell**2), 1, PIECES)
        wanted *= min(1.0, 4 * SAMPLES / wanted.sum())
        pieces = np.maximum(1, wanted).astype(np.int64)
        rows = np.repeat(np.arange(len(pieces)), pieces)
        several = np.flatnonzero(pieces[rows] > 1)
        points = matter.means[rows]
        noise = np.random.default_rng(0).standard_normal((len(several), 3))
        points[several] += rotated(matter.quats[rows[several]], noise * matter.scales[rows[several]])
        depths = masses[rows] / pieces[rows] / self.cell_size(points) ** 2
        self.depth.reshape(-1)[:] = np.bincount(self.cells(points), depths, CELLS**3)

    def cells(self, points: np.ndarray) -> np.ndarray:
        """(P,) int64: the number of the cell of each point (P, 3)."""
        u = (points - self.centre) / self.half
        m = np.abs(u).max(axis=1, keepdims=True)
        u *= np.where(m > 1, (2 - 1 / np.maximum(m, 1)) / np.maximum(m, 1), 1)
        place = np.clip(((u + 2) * (CELLS / 4)).astype(np.int64), 0, CELLS - 1)
        return (place[:, 0] * CELLS + place[:, 1]) * CELLS + place[:, 2]

    def cell_size(self, points: np.ndarray) -> np.ndarray:
        """(P,) the width of the cells at the points (P, 3), across the direction from the centre."""
        m = np.maximum(np.abs(points - self.centre).max(axis=1) / self.half, 1)
        return 4 / CELLS * self.half * m / (2 - 1 / m)

    def places(self, cells: np.ndarray) -> np.ndarray:
        """(P, 3) the middle of each cell, by its number (P,)."""
        v = (np.stack(np.unravel_index(cells, self.depth.shape), axis=1) + 0.5) * (4 / CELLS) - 2
        m = np.abs(v).max(axis=1, keepdims=True)
        return self.centre + self.half * v * np.where(
            m > 1, 1 / np.maximum(2 - m, 1e-9) / np.maximum(m, 1), 1
        )

    def free(self) -> np.ndarray:
        """(CELLS, CELLS, CELLS) bool: cells in which a camera may stand: no matter is in them or nearer than
        a camera can see. Where no cell has such a clearance, less of it is asked for, step by step."""
        empty, solid = self.depth < FREE, self.depth >= SOLID
        cell = 4 / CELLS * self.half
        most = 1 + min(CELLS // 16, int(np.ceil(CLEARANCE * self.near / cell)))
        grown = [solid]
        for _ in range(most):
            grown.append(_grown(grown[-1]))
        for solid in reversed(grown):
            found = empty & ~solid
            if found[CELLS // 4 : -CELLS // 4, CELLS // 4 : -CELLS // 4, CELLS // 4 : -CELLS // 4].any():
                return found
        return empty

    def enclosure(self, points: np.ndarray) -> np.ndarray:
        """(P,) the share of rays from the point (P, 3) that end in matter: 1 in a closed room."""
        blocked = np.array(
            [self.blocked(points, np.broadcast_to(direction, points.shape)) for direction in sphere(RAYS)]
        )
        return blocked.mean(axis=0)

    def blocked(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(P,) bool: whether the ray from each point (P, 3) in its direction (P, 3) meets matter."""
        depth, flat, at = np.zeros(len(points)), self.depth.reshape(-1), np.zeros(len(points))
        for _ in range(MARCH):
            m = np.maximum(np.abs(points + at[:, None] * directions - self.centre).max(axis=1) / self.half, 1)
            at = at + 4 / CELLS * self.half * np.minimum(m * m, 1e6)
            depth += flat[self.cells(points + at[:, None] * directions)]
            if (m > CELLS / 2).all():
                break
        return depth >= OPAQUE


def sphere(count: int, turn: float = 0.0) -> np.ndarray:
    """(count, 3) unit vectors evenly over the sphere (Fibonacci). turn: of all around z, radians."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = turn + np.pi * (3 - np.sqrt(5)) * np.arange(count)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def connected(free: np.ndarray, start: int) -> np.ndarray:
    """(n, n, n) bool: free cells connected, side by side, to the free cell with the number `start`."""
    n = len(free)
    padded = np.zeros((n + 2,) * 3, bool)
    padded[1:-1, 1:-1, 1:-1] = free
    left, found = padded.reshape(-1), np.zeros(padded.size, bool)
    steps = [sign * stride for stride in ((n + 2) ** 2, n + 2, 1) for sign in (1, -1)]
    place = np.array(np.unravel_index(start, free.shape)) + 1
    front = np.array([(place[0] * (n + 2) + place[1]) * (n + 2) + place[2]])
    while len(front):
        found[front], left[front] = True, False
        near = np.concatenate([front + step for step in steps])
        front = np.unique(near[left[near]])
    return found.reshape(padded.shape)[1:-1, 1:-1, 1:-1]


def _grown(solid: np.ndarray) -> np.ndarray:
    """The cells of a mask (n, n, n) and their neighbours, also those across an edge or a corner."""
    out = solid
    for axis in range(3):
        wide = out.copy()
        ahead, behind = [slice(None)] * 3, [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        wide[tuple(ahead)] |= out[tuple(behind)]
        wide[tuple(behind)] |= out[tuple(ahead)]
        out = wide
    return out

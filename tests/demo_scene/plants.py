"""Plants: leaves on stems, grass, trees. Seeds decide what each looks like."""

import math

import bpy
import numpy as np
from mathutils import Vector

from demo_scene import materials as mat
from demo_scene.shapes import again, bar, lift, mould, patch, rock

GREENS = [
    [(0.02, 0.09, 0.01), (0.07, 0.22, 0.03), (0.20, 0.42, 0.06)],
    [(0.01, 0.06, 0.02), (0.05, 0.16, 0.05), (0.50, 0.55, 0.22)],
    [(0.05, 0.10, 0.01), (0.16, 0.26, 0.03), (0.35, 0.45, 0.10)],
]


def leaf(solid) -> None:
    """1 long along y from the origin, 0.5 wide, folded along its rib, its tip hanging."""

    def place(u: float, v: float) -> Vector:
        side = (2 * u - 1) * 0.27 * math.sin(math.pi * min(v, 0.985) ** 0.8) ** 0.8
        return Vector((side, v * (1 - 0.12 * v), 0.35 * abs(side) + 0.25 * v - 0.45 * v * v))

    patch(4, 7, place)(solid)


def leaves() -> list[bpy.types.Object]:
    """One leaf of each kind, to be copied."""
    kinds = [
        mat.patterned("Noise", greens, roughness=0.45, Scale=5, Detail=6, Roughness=0.8) for greens in GREENS
    ]
    colours = [(0.03, 0.14, 0.03), (0.45, 0.55, 0.20)]
    striped = mat.patterned("Wave", colours, 0.4, Scale=3.5, Distortion=2, bands_direction="Y")
    return [mould("leaf", leaf, kind) for kind in (*kinds, striped)]


def stem(
    root: Vector,
    tip: Vector,
    hang: float,
    count: int,
    size: float,
    kinds: list[bpy.types.Object],
    rng: np.random.Generator,
) -> Vector:
    """A stem with leaves on both sides from `root` to `tip`, which hangs by `hang`. Returns where it ends."""
    if (bark := bpy.data.materials.get("stem")) is None:
        bark = mat.patterned("Noise", [(0.10, 0.20, 0.04), (0.30, 0.22, 0.10)], Scale=20)
        bark.name = "stem"
    points = [root.lerp(tip, t) + lift(hang * (t - t * t) * 2) for t in np.linspace(0, 1, 7)]
    for start, end in zip(points, points[1:], strict=False):
        bar(bark, start, end, 0.05 * size)
    for k in range(count):
        t = (k + 1) / count
        at = points[0].lerp(points[-1], t) + lift(hang * (t - t * t) * 2)
        heading = (
            math.degrees(math.atan2(tip.y - root.y, tip.x - root.x))
            - 90
            + (70 if k % 2 else -70) * (1 - 0.8 * t)
            + rng.uniform(-25, 25)
        )
        turn = (rng.uniform(-25, 35), rng.uniform(-20, 20), heading)
        again(kinds[rng.integers(len(kinds))], at, turn, size * rng.uniform(0.7, 1.2))
    return points[-1]


def bush(
    at: Vector,
    stems: int,
    reach: tuple[float, float],
    height: tuple[float, float],
    size: float,
    kinds: list[bpy.types.Object],
    rng,
) -> list[Vector]:
    """Stems that spread from one place, to all sides. `reach` and `height` (m) are ranges. Returns their
    ends."""
    ends = []
    for k in range(stems):
        angle, away, up = 2.4 * k, rng.uniform(*reach), rng.uniform(*height)
        away *= 1.15 - 0.6 * (up - height[0]) / max(height[1] - height[0], 1e-6)
        tip = at + Vector((away * math.cos(angle), away * math.sin(angle), up))
        ends.append(
            stem(
                at + Vector((0.05 * math.cos(angle), 0.05 * math.sin(angle), 0)),
                tip,
                0.12,
                9,
                size,
                kinds,
                rng,
            )
        )
    return ends


def tuft(blades: int, seed: int):
    """Grass of height 1 on the origin, in a circle of radius 0.6."""

    def shape(solid) -> None:
        rng = np.random.default_rng(seed)
        for _ in range(blades):
            angle, away, lean, height, heading = rng.uniform((0, 0, 0.1, 0.4, 0), (6.28, 0.6, 0.6, 1.0, 6.28))
            root = Vector((away * math.cos(angle), away * math.sin(angle), 0))
            along = Vector((math.cos(heading), math.sin(heading), 0))
            across = Vector((-math.sin(heading), math.cos(heading), 0)) * 0.035
            middle = root + along * lean * 0.3 + lift(0.6 * height)
            tip = root + along * lean + lift(height)
            foot, knee = [
                [solid.verts.new(point + side) for side in (-across, across)] for point in (root, middle)
            ]
            solid.faces.new((foot[0], foot[1], knee[1], knee[0]))
            solid.faces.new((knee[0], knee[1], solid.verts.new(tip)))

    return shape


def crown(clumps: int, seed: int):
    """Clumps of leaves around a ball of radius 1: flat shapes with five corners, on end."""

    def shape(solid) -> None:
        rng = np.random.default_rng(seed)
        for _ in range(clumps):
            out = Vector(rng.normal(size=3)).normalized()
            at = out * rng.uniform(0.62, 1.08)
            turn = Vector(rng.normal(size=3)).normalized().lerp(out, 0.4).to_track_quat("Z", "Y").to_matrix()
            size = rng.uniform(0.10, 0.24)
            corners = [
                at + turn @ Vector((size * math.cos(a) * rng.uniform(0.5, 1), size * math.sin(a), 0))
                for a in np.arange(5) * 1.257
            ]
            solid.faces.new([solid.verts.new(corner) for corner in corners])

    return shape


def trees(seed: int, places: list[tuple[float, float, float, float]]) -> None:
    """Broad trees at (x, y, z, height in metres)."""
    rng = np.random.default_rng(seed)
    bark = mat.patterned("Noise", [(0.05, 0.04, 0.03), (0.28, 0.22, 0.16)], Scale=3, Detail=5)
    autumn = [(0.10, 0.05, 0.01), (0.35, 0.20, 0.03), (0.60, 0.42, 0.10)]
    looks = [
        mat.patterned("Noise", colours, Scale=4, Detail=5, Roughness=0.9) for colours in (*GREENS, autumn)
    ]
    crowns = [mould("crown", crown(360, k), look) for k, look in enumerate(looks)]
    core = mould("core", rock, mat.plain((0.015, 0.03, 0.01)))
    for x, y, z, height in places:
        wide = height * rng.uniform(0.30, 0.42)
        at, turn = (x, y, z + 0.66 * height), (0, 0, rng.uniform(0, 360))
        size = Vector((wide, wide, 0.36 * height))
        again(crowns[rng.integers(len(crowns))], at, turn, size)
        again(core, at, turn, 0.7 * size)
        bar(bark, (x, y, z - 0.3), (x, y, z + 0.6 * height), 0.03 * height)

"""A paved yard with things on it, a meadow and hills around, a sky dome over all.

Metres, z up. Everything is placed by constants or fixed seeds.
"""

import math
from itertools import pairwise

import bmesh
import bpy
import numpy as np
from mathutils import Vector

from demo_scene import lights
from demo_scene import materials as mat
from demo_scene.shapes import add, bar, cone, cube, lift, rock, sheet, smooth, sphere
from demo_scene.views import Pose, look_at

DOME_RADIUS = 60.0
PAVING = 0.06  # height of the yard's floor
# A ball on the column, striped yellow and red. It is unshaded and both colours are as red as can be without
# any blue, so that a test can find the whole ball in an image.
MARKER = {"centre": [1.3, -0.6, 1.82], "radius": 0.12, "rgb": [[255, 210, 0], [255, 50, 0]]}
NOTES = {"marker": MARKER}  # for the stamp
STRIPES = 12  # like a beach ball's, from pole to pole

MIDDLE = np.array([0.0, 0.0, 0.75])  # metres; what every camera looks at, give or take

# Share of the views, distance from the axis (m), height (m), both with their jitter.
RINGS = (
    (0.40, (4.6, 0.25), (1.25, 0.25)),
    (0.33, (4.1, 0.25), (2.75, 0.25)),
    (0.27, (2.95, 0.15), (1.45, 0.45)),
)


def build(scene: bpy.types.Scene) -> None:
    lights.sun(scene, 3.2, 4, (1.0, 0.93, 0.82), (48, 0, 35))
    lights.sky(scene, (0.45, 0.60, 0.85), 0.75)
    _surroundings()
    _monument()
    _column()
    _clutter()
    _toys()
    _crates()
    _railing()
    _trellis()


def _hill_height(x: float, y: float) -> float:
    distance, angle = math.hypot(x, y), math.atan2(y, x)
    rise = min(max((distance - 12) / 33, 0), 1)
    waves = 3.2 + 2 * math.sin(3 * angle + 1) + math.sin(7 * angle) + 0.5 * math.sin(13 * angle)
    # No terrain below 12 m, all of it beyond 45 m.
    return rise * rise * (3 - 2 * rise) * max(waves, 0.6)


def _surroundings() -> None:
    def ground(u: float, v: float) -> Vector:
        distance = 0.5 + (DOME_RADIUS + 2) * v * v
        x, y = distance * math.cos(2 * math.pi * u), distance * math.sin(2 * math.pi * u)
        return Vector((x, y, _hill_height(x, y)))

    grass = [(0.0, 0.02, 0.0), (0.02, 0.08, 0.01), (0.10, 0.20, 0.03), (0.42, 0.36, 0.12), (0.7, 0.6, 0.3)]
    meadow = mat.patterned("Noise", grass, Scale=2.3, Detail=5, Roughness=0.85)
    smooth(add("ground", sheet(96, 48, ground, closed=False), meadow))
    dome = add("sky", sphere, mat.sky(1.0), size=DOME_RADIUS)
    # The dome is only looked at: light comes from the lamp and the world behind it.
    dome.visible_shadow = dome.visible_diffuse = False

    floor = mat.bricks([(0.42, 0.17, 0.10), (0.62, 0.36, 0.22), (0.55, 0.53, 0.48)], Scale=3.2)
    add("yard", cone(2.5, 2.5, 64), floor, (0, 0, PAVING / 2), size=(1, 1, PAVING))
    _pines_and_rocks()


def _pines_and_rocks() -> None:
    rng = np.random.default_rng(3)
    needles = mat.patterned("Noise", [(0.01, 0.03, 0.01), (0.03, 0.10, 0.03), (0.10, 0.22, 0.06)], Scale=9)
    stone = mat.patterned("Voronoi", [(0.10, 0.10, 0.11), (0.45, 0.42, 0.38)], Scale=3)
    for index in range(48):
        angle, away, size = rng.uniform((0, 7.5, 0.7), (2 * math.pi, 30, 1.3))
        x, y = away * math.cos(angle), away * math.sin(angle)
        base = _hill_height(x, y) - 0.1
        if index % 4 == 0:
            size *= 0.5
            add("rock", rock, stone, (x, y, base), turn=rng.uniform(0, 360, 3), size=size)
        else:
            tall = (0.8 * size, 0.8 * size, 3.2 * size)
            smooth(add("pine", cone(1, 0.02, 12), needles, (x, y, base + tall[2] / 2), size=tall))


def _monument() -> None:
    colours = [(0.75, 0.72, 0.66), (0.55, 0.50, 0.46), (0.16, 0.14, 0.15)]
    marble = mat.patterned("Wave", colours, 0.4, Scale=1.6, Distortion=9, Detail=4)
    add("pedestal", cube, marble, (0, 0, PAVING + 0.35), turn=(0, 0, 20), size=(0.8, 0.8, 0.7))
    colours = [(0.02, 0.10, 0.16), (0.05, 0.35, 0.40), (0.80, 0.55, 0.15), (0.5, 0.08, 0.04)]
    glaze = mat.patterned("Noise", colours, 0.35, Scale=4, Detail=6, Distortion=0.5)
    monkey = add("monkey", bmesh.ops.create_monkey, glaze, (0, 0, PAVING + 1.19), turn=(-6, 0, 70), size=0.52)
    monkey.modifiers.new("rounder", "SUBSURF").levels = 2
    finished = monkey.evaluated_get(bpy.context.evaluated_depsgraph_get())
    monkey.data = bpy.data.meshes.new_from_object(finished)
    monkey.modifiers.clear()
    smooth(monkey)


def _column() -> None:
    """The occluder: it stands in front of the clutter."""
    bands = mat.patterned("Wave", [(0.06, 0.10, 0.30), (0.85, 0.80, 0.62)], Scale=3.2, Distortion=7, Detail=3)
    x, y, z = MARKER["centre"]
    top = z - MARKER["radius"]
    smooth(add("column", cone(0.17, 0.14), bands, (x, y, top / 2), size=(1, 1, top)))
    ball = add("marker", sphere, None, MARKER["centre"], turn=(25, 15, 0), size=MARKER["radius"])
    for rgb in MARKER["rgb"]:
        ball.data.materials.append(mat.glowing(mat.linear(rgb)))
    for face in ball.data.polygons:
        angle = math.atan2(face.center.y, face.center.x)
        face.material_index = int(angle / (2 * math.pi) % 1 * STRIPES) % 2


def _clutter() -> None:
    rng = np.random.default_rng(11)
    shapes = (cube, rock, cone(0.6, 0.0), cone(0.4, 0.4))
    finishes = [
        mat.cells(7),
        mat.patterned("Checker", [(0.9, 0.85, 0.7), (0.6, 0.04, 0.03)], Scale=4),
        mat.patterned("Magic", [(0.9, 0.5, 0.05), (0.1, 0.05, 0.3)], Scale=3, Distortion=2),
        mat.patterned("Noise", [(0.02, 0.08, 0.02), (0.5, 0.7, 0.2)], Scale=5, Detail=6),
    ]
    for index in range(34):
        x, y, size = rng.uniform((0.55, -1.25, 0.09), (1.15, 0.95, 0.20))
        add(
            "clutter",
            shapes[index % 4],
            finishes[(index // 4) % 4],
            (x, y, PAVING + size * 0.5),
            turn=(0, 0, rng.uniform(0, 360)),
            size=size,
        )


def _toys() -> None:
    ball = add("ball", sphere, mat.cells(5), (-1.15, 0.75, PAVING + 0.4), size=0.4)
    smooth(ball).rotation_euler = (0.4, 0.2, 0)
    brass = mat.patterned("Noise", [(0.55, 0.30, 0.08), (0.95, 0.75, 0.40)], 0.12, 1, Scale=2)
    smooth(add("glossy ball", sphere, brass, (-0.95, -0.95, PAVING + 0.36), size=0.36))

    def ring(u: float, v: float) -> Vector:
        out = 0.42 + 0.15 * math.cos(2 * math.pi * v)
        return Vector(
            (
                out * math.cos(2 * math.pi * u),
                out * math.sin(2 * math.pi * u),
                0.15 * math.sin(2 * math.pi * v),
            )
        )

    stripes = mat.patterned("Wave", [(0.8, 0.1, 0.05), (0.95, 0.85, 0.7)], 0.3, Scale=2.5, Distortion=1)
    smooth(add("ring", sheet(64, 24, ring, closed=True), stripes, (0.1, -1.45, 0.52), turn=(62, 0, 15)))


def _crates() -> None:
    colours = [(0.16, 0.07, 0.02), (0.42, 0.22, 0.08), (0.55, 0.34, 0.14)]
    wood = mat.patterned("Wave", colours, Scale=3, Distortion=6, Detail=3)
    add("crate", cube, wood, (0.15, 1.45, PAVING + 0.28), turn=(0, 0, 12), size=0.56)
    add("crate", cube, wood, (-0.42, 1.6, PAVING + 0.17), turn=(0, 0, 50), size=0.34)
    add("crate", cube, wood, (0.18, 1.42, PAVING + 0.75), turn=(0, 0, 41), size=0.38)
    wall = mat.plain((0.08, 0.42, 0.42))  # the one surface without texture
    add("wall", cube, wall, (1.35, 1.3, PAVING + 0.5), turn=(0, 0, -44), size=(1.1, 0.09, 1.0))


def _railing() -> None:
    paint = mat.patterned("Noise", [(0.02, 0.02, 0.03), (0.30, 0.10, 0.04)], roughness=0.5, Scale=3)
    posts = [
        Vector((2.2 * math.cos(angle), 2.2 * math.sin(angle), PAVING))
        for angle in np.radians(np.linspace(140, 245, 16))
    ]
    for post in posts:
        bar(paint, post, post + lift(0.7))
    for here, there in pairwise(posts):
        for height in (0.15, 0.7):
            bar(paint, here + lift(height), there + lift(height))


def _trellis() -> None:
    lath = mat.patterned("Noise", [(0.55, 0.50, 0.42), (0.85, 0.82, 0.75)], Scale=6)
    corner, across, up = Vector((0.55, -2.0, PAVING)), Vector((1.0, 0.45, 0)), lift(1.1)
    for step in np.linspace(0, 1, 6):
        bar(lath, corner + across * step, corner + across * step + up)
        bar(lath, corner + up * step, corner + up * step + across)


def cameras(count: int) -> list[Pose]:
    """`count` poses on three rings around the middle.

    Names run around each ring in turn, so every 8th one, the test split, falls all round the
    scene at every height.
    """
    rng = np.random.default_rng(20)
    shares = np.cumsum([0.0] + [share for share, _, _ in RINGS])
    edges = np.rint(shares / shares[-1] * count).astype(int)
    poses = []
    for ring, (_, radius, height) in enumerate(RINGS):
        size = edges[ring + 1] - edges[ring]
        for step in range(size):
            jitter = rng.uniform(-1, 1, 6)
            angle = 2 * np.pi * (step + 0.2 * jitter[0] + 0.37 * ring) / size
            away = radius[0] + radius[1] * jitter[1]
            eye = [away * np.cos(angle), away * np.sin(angle), height[0] + height[1] * jitter[2]]
            target = MIDDLE + 0.15 * jitter[3:]
            poses.append(Pose(f"{len(poses):04d}.png", look_at(np.array(eye), target)))
    return poses

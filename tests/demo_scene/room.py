"""A furnished room, seen by somebody who walks through it; houses and trees behind its windows.

Metres, z up, the floor at 0. Everything is placed by constants or fixed seeds.
"""

import math

import bpy
import numpy as np
from mathutils import Vector

from demo_scene import furniture, lights
from demo_scene import materials as mat
from demo_scene.houses import row_of_houses
from demo_scene.plants import bush, leaves, trees
from demo_scene.shapes import add, again, bar, block, cone, mould, moved, patch, slab, sphere
from demo_scene.views import Pose, pose

LENGTH, DEPTH, HEIGHT = 6.0, 4.6, 2.7  # x, y, z
WINDOWS = [(-2.1, -0.7, 0.85, 2.25), (0.7, 2.1, 0.85, 2.25)]  # in the wall at +y: left, right, bottom, top
DOME_RADIUS = 60.0


def build(scene: bpy.types.Scene) -> None:
    lights.sun(scene, 6.0, 1, (1.0, 0.88, 0.70), (-52, 0, 24))
    lights.sky(scene, (0.80, 0.86, 1.0), 0.9)
    # m; light of further bounces reaches what is this far from the next thing
    scene.world.light_settings.distance = 1.2
    _lamps(scene)
    _shell()
    _windows()
    _outside()
    _rug_and_table()
    _furnish()


def cameras(count: int) -> list[Pose]:
    """Three fifths on a walk around the table, looking ahead and outwards; the others lower, on a smaller
    round, towards the far wall."""
    rng = np.random.default_rng(22)
    walk = round(0.6 * count)
    poses = []
    for number in range(count):
        hand = rng.uniform(-1, 1, 5)
        first = number < walk
        angle = 2 * math.pi * (number / walk if first else (number - walk) / (count - walk) + 0.04)
        along, across, height = (1.45, 0.95, 1.5) if first else (0.95, 0.75, 1.15)
        eye = np.array(
            [
                along * math.cos(angle),
                across * math.sin(angle),
                height + 0.12 * math.sin(3 * angle) + 0.05 * hand[0],
            ]
        )
        gaze = angle + (0.75 if first else math.pi) + 0.15 * hand[1]
        ahead = np.array(
            [math.cos(gaze), math.sin(gaze), -0.16 + 0.10 * math.sin(5 * angle) + 0.05 * hand[2]]
        )
        poses.append(pose(number, eye, eye + ahead, roll=0.015 * hand[3]))
    return poses


def _lamps(scene: bpy.types.Scene) -> None:
    """What comes in through the windows, and two lamps."""

    def area(energy: float, colour: tuple[float, float, float], size: tuple[float, float], at, turn) -> None:
        light = bpy.data.lights.new("area", "AREA")
        light.energy, light.color, light.shape, light.size, light.size_y = energy, colour, "RECTANGLE", *size
        lamp = bpy.data.objects.new("area", light)
        lamp.location, lamp.rotation_euler = at, [math.radians(angle) for angle in turn]
        lamp.visible_camera = lamp.visible_glossy = False
        scene.collection.objects.link(lamp)

    for left, right, bottom, top in WINDOWS:
        at = ((left + right) / 2, DEPTH / 2 + 0.02, (bottom + top) / 2)
        area(38, (0.82, 0.90, 1.0), (right - left, top - bottom), at, (-90, 0, 0))
    area(16, (1.0, 0.80, 0.58), (0.5, 0.5), (0.9, -0.3, 2.2), (0, 0, 0))
    area(9, (1.0, 0.72, 0.45), (0.3, 0.3), (2.5, -1.85, 1.75), (180, 0, 0))


def _shell() -> None:
    oak = [(0.30, 0.15, 0.06), (0.52, 0.31, 0.14), (0.10, 0.05, 0.02)]
    planks = mat.bricks(oak, Scale=1, Brick_Width=0.7, Row_Height=0.12, Mortar_Size=0.006)
    add("floor", block(LENGTH + 0.4, DEPTH + 0.4, 0.2), mat.weathered(planks, 0.45, 9), (0, 0, -0.2))
    plaster = mat.weathered(
        mat.patterned("Noise", [(0.55, 0.52, 0.46), (0.82, 0.79, 0.72)], Scale=5, Detail=8, Roughness=0.8),
        0.7,
        0.8,
    )
    add("ceiling", block(LENGTH + 0.4, DEPTH + 0.4, 0.2), plaster, (0, 0, HEIGHT))
    wood = furniture.wood(0.5)
    for x in np.linspace(-2.4, 2.4, 5):
        add("beam", block(0.16, DEPTH, 0.18), wood, (x, 0, HEIGHT - 0.17))
    colours = [(0.62, 0.55, 0.38), (0.40, 0.48, 0.36), (0.70, 0.66, 0.52)]
    striped = mat.patterned("Wave", colours, Scale=1.6, Distortion=0.6, Detail=2)
    colours = [(0.70, 0.22, 0.12), (0.72, 0.62, 0.42), (0.60, 0.52, 0.36), (0.42, 0.50, 0.46)]
    dotted = mat.patterned("Voronoi", colours, Scale=6, Randomness=0.35)
    red = mat.bricks([(0.42, 0.16, 0.09), (0.62, 0.33, 0.21), (0.66, 0.62, 0.54)], Scale=3)
    colours = [(0.16, 0.26, 0.34), (0.40, 0.52, 0.55), (0.66, 0.62, 0.48)]
    swirls = mat.patterned("Magic", colours, Scale=5, Distortion=1.6, turbulence_depth=3)
    trim = mat.weathered(mat.plain((0.70, 0.66, 0.56), 0.4), 0.6, 6)
    walls = [
        (striped, 180, LENGTH, DEPTH, WINDOWS),
        (red, 0, LENGTH, DEPTH, []),
        (dotted, 90, DEPTH, LENGTH, []),
        (swirls, 270, DEPTH, LENGTH, []),
    ]
    for paper, turn, length, away, holes in walls:
        wall = add(
            "wall", slab(length + 0.4, HEIGHT, 0.2, holes), mat.weathered(paper, 0.7, 2), turn=(90, 0, 0)
        )
        skirting = add("skirting", block(length, 0.02, 0.12), trim, (0, 0.01, 0))
        moved([wall, skirting], _against(turn, away), turn)


def _against(turn: float, away: float) -> Vector:
    """The middle of the foot of a wall whose room looks along +y when it is turned by `turn` degrees."""
    angle = math.radians(turn)
    return Vector((math.sin(angle), -math.cos(angle), 0)) * (away / 2)


def _windows() -> None:
    paint = mat.weathered(mat.plain((0.75, 0.73, 0.68), 0.4), 0.7, 8)
    cloth = mat.patterned("Checker", [(0.55, 0.12, 0.08), (0.72, 0.60, 0.42)], Scale=9)
    rust = mat.patterned("Noise", [(0.50, 0.48, 0.42), (0.72, 0.70, 0.64)], roughness=0.3, Scale=12)

    def folds(u: float, v: float) -> Vector:
        return Vector(
            (0.42 * (u - 0.5) * (1.1 - 0.25 * v), 0.05 * math.sin(22 * u) * (1.2 - 0.5 * v), 1.85 * v)
        )

    curtain = mould("curtain", patch(44, 6, folds), mat.weathered(cloth, 0.6, 6))
    rib = mould("rib", block(0.05, 0.1, 0.5), rust)
    y = DEPTH / 2
    for left, right, bottom, top in WINDOWS:
        middle = (left + right) / 2
        for x in (left, middle, right):
            add("frame", block(0.06, 0.08, top - bottom), paint, (x, y + 0.06, bottom))
        for z in (bottom, bottom + 0.95, top - 0.05):
            add("frame", block(right - left, 0.07, 0.05), paint, (middle, y + 0.06, z))
        add("sill", block(right - left + 0.2, 0.26, 0.04), paint, (middle, y - 0.02, bottom - 0.045))
        bar(rust, (left - 0.4, y - 0.1, 2.4), (right + 0.4, y - 0.1, 2.4), 0.015)
        for x in (left - 0.1, right + 0.1):
            again(curtain, (x, y - 0.1, 0.55))
        for x in np.arange(left + 0.2, right - 0.15, 0.075):
            again(rib, (x, y - 0.12, 0.14))


def _outside() -> None:
    grass = [(0.06, 0.12, 0.02), (0.16, 0.28, 0.05), (0.40, 0.42, 0.15)]
    add(
        "lawn",
        cone(DOME_RADIUS, DOME_RADIUS, 64),
        mat.patterned("Noise", grass, Scale=1.5, Detail=8, Roughness=0.8),
        (0, 0, -2.55),
    )
    dome = add("sky", sphere, mat.sky(1.0), size=DOME_RADIUS)
    dome.visible_shadow = dome.visible_diffuse = False  # only looked at
    row_of_houses(5, [(-14, 24, -2.1, 20), (1, 27, -2.1, 0), (16, 23, -2.1, -25)])
    trees(
        6,
        [
            (-5, 14, -2.1, 5.5),
            (4, 17, -2.1, 6.0),
            (9, 12, -2.1, 5.0),
            (-10, 18, -2.1, 6.5),
            (-1, 40, -2, 12),
            (12, 38, -2, 13),
            (-15, 36, -2, 12),
        ],
    )


def _rug_and_table() -> None:
    border = mat.patterned("Checker", [(0.42, 0.05, 0.05), (0.70, 0.55, 0.25)], Scale=14)
    colours = [(0.10, 0.10, 0.30), (0.55, 0.08, 0.06), (0.75, 0.60, 0.32), (0.08, 0.25, 0.22)]
    weave = mat.patterned("Magic", colours, Scale=1.6, Distortion=2.2)
    add("rug", block(2.9, 2.0, 0.008), mat.weathered(border, 0.6, 12))
    add("rug", block(2.6, 1.7, 0.014), mat.weathered(weave, 0.55, 16))
    furniture.low_table()


def _furnish() -> None:
    def stand(
        things: list[bpy.types.Object], turn: float, away: float, aside: float, gap: float = 0.03
    ) -> None:
        angle = math.radians(turn)
        right = Vector((math.cos(angle), math.sin(angle), 0))
        moved(things, _against(turn, away - 2 * gap) + aside * right, turn)

    stand(furniture.bookcase(2.7, 2.25, 5, seed=3), 90, LENGTH, 0.75)
    stand(furniture.lamp_and_armchair(), 90, LENGTH, -1.45)
    stand(furniture.sofa(), 270, LENGTH, 0.1)
    stand(furniture.pictures(), 270, LENGTH, 0.1, 0.005)
    stand(furniture.wardrobe(), 270, LENGTH, 1.75)
    stand(furniture.desk(), 0, DEPTH, 0.35)
    stand(furniture.pinboard(), 0, DEPTH, 0.35, 0.005)
    stand(furniture.door(), 0, DEPTH, -1.55, 0.005)
    stand(furniture.sideboard(), 180, DEPTH, 0.0)
    stand(furniture.boxes(), 0, DEPTH, 1.62, 0.03)
    colours = [(0.45, 0.18, 0.08), (0.70, 0.45, 0.25)]
    clay = mat.patterned("Wave", colours, Scale=4, Distortion=3, bands_direction="Z")
    add("pot", cone(0.17, 0.22), clay, (-2.55, 1.85, 0.2), size=(1, 1, 0.4))
    rng = np.random.default_rng(4)
    bush(Vector((-2.55, 1.85, 0.38)), 12, (0.15, 0.38), (0.5, 1.2), 0.22, leaves(), rng)

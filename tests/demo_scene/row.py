"""A row of shops, seen from across the street by cameras that all look forward: goods, stalls, an alley
between the houses.

Metres, z up; the street runs along x, the fronts stand at y = 0 and look along -y. Everything is placed by
constants or fixed seeds.
"""

import math

import bpy
import numpy as np
from mathutils import Vector

from demo_scene import lights, shopping
from demo_scene import materials as mat
from demo_scene.furniture import wood
from demo_scene.houses import WALLS, row_of_houses
from demo_scene.plants import bush, leaves, stem, trees
from demo_scene.shapes import (
    add,
    again,
    bar,
    block,
    cone,
    lettering,
    mould,
    patch,
    rock,
    slab,
    smooth,
    sphere,
)
from demo_scene.views import Pose, pose

DOME_RADIUS = 60.0
STOREY, WALL, INSIDE = 3.3, 0.25, 1.7  # m: height of a storey, thickness of the fronts, depth of the shops
SHOPS = (  # middle of the front (m), width (m), sign, colour of the woodwork
    (-3.65, 3.9, "BAKERY", (0.05, 0.16, 0.13)),
    (0.25, 3.9, "FRUIT & FLOWERS", (0.35, 0.05, 0.04)),
    (6.15, 3.9, "BOOKS", (0.05, 0.08, 0.22)),
)
COLUMNS = 6  # of the grid of cameras


def build(scene: bpy.types.Scene) -> None:
    lights.sun(scene, 3.6, 2, (1.0, 0.92, 0.80), (46, 0, -32))
    lights.sky(scene, (0.55, 0.66, 0.85), 0.9)
    _street()
    for index, (x, width, sign, paint) in enumerate(SHOPS):
        _front(index, x, width, sign, paint)
        _upstairs(index, x, width)
        _awning(index, x, width)
        _lit(scene, x)
    shopping.bakery(SHOPS[0][0], WALL)
    shopping.greengrocer(SHOPS[1][0], WALL)
    shopping.bookshop(SHOPS[2][0], WALL)
    _alley()
    _pavement()
    _bunting()


def cameras(count: int) -> list[Pose]:
    """A grid of `COLUMNS` columns, 2.6 m wide and 1.3 m high, row by row, to and fro, held by hand."""
    rng = np.random.default_rng(23)
    rows = max(math.ceil(count / COLUMNS), 2)
    poses = []
    for number in range(count):
        row, column = divmod(number, COLUMNS)
        hand = rng.uniform(-1, 1, 6)
        across = column / (COLUMNS - 1) - 0.5
        eye = (
            np.array([0.8 + 2.6 * (-across if row % 2 else across), -8.3, 1.25 + 1.3 * row / (rows - 1)])
            + np.array([0.08, 0.2, 0.06]) * hand[:3]
        )
        target = [0.6 * eye[0] + 0.3, 0.0, 2.15 + 0.3 * (eye[2] - 1.8)] + 0.08 * hand[3:]
        poses.append(pose(number, eye, target, roll=0.01 * hand[5]))
    return poses


def _lit(scene: bpy.types.Scene, x: float) -> None:
    """The lamp of a shop."""
    light = bpy.data.lights.new("lamp", "AREA")
    light.energy, light.color, light.shape, light.size = 45, (1.0, 0.82, 0.60), "RECTANGLE", 2.6
    light.size_y = 0.6
    lamp = bpy.data.objects.new("lamp", light)
    lamp.location = (x, WALL + 0.5, STOREY - 0.25)
    lamp.visible_camera = lamp.visible_glossy = False
    scene.collection.objects.link(lamp)


def _street() -> None:
    stones = [(0.16, 0.15, 0.15), (0.36, 0.34, 0.32), (0.08, 0.075, 0.07)]
    cobbles = mat.weathered(
        mat.bricks(stones, Scale=1, Brick_Width=0.2, Row_Height=0.12, Mortar_Size=0.012), 0.45, 5
    )
    add("street", block(60, 50, 0.3), cobbles, (0, -10, -0.42))
    colours = [(0.40, 0.37, 0.33), (0.55, 0.52, 0.46), (0.16, 0.15, 0.14)]
    flags = mat.bricks(colours, Scale=1, Brick_Width=0.6, Row_Height=0.45, Mortar_Size=0.012)
    add("pavement", block(60, 3.4, 0.12), mat.weathered(flags, 0.5, 4), (0, -1.4, -0.12))
    kerb = mat.weathered(
        mat.bricks(
            [(0.5, 0.48, 0.44), (0.6, 0.58, 0.54), (0.2, 0.2, 0.2)], Scale=1, Brick_Width=0.9, Row_Height=9
        ),
        0.5,
        8,
    )
    add("kerb", block(60, 0.16, 0.15), kerb, (0, -3.18, -0.14))
    dome = add("sky", sphere, mat.sky(1.0), size=DOME_RADIUS)
    dome.visible_shadow = dome.visible_diffuse = False  # only looked at


def _front(index: int, x: float, width: float, sign: str, paint) -> None:
    """The ground floor: a wall with a wide window and a door, panelled woodwork, the sign, the shop
    behind."""
    wall = mat.weathered(mat.bricks(WALLS[index], Scale=2.4), 0.5, 2)
    door = (width / 2 - 1.15, width / 2 - 0.2, 0, 2.25)
    window = (-width / 2 + 0.25, width / 2 - 1.4, 0.62, 2.25)
    add("front", slab(width, STOREY, WALL, [window, door]), wall, (x, WALL, 0), turn=(90, 0, 0))
    varnish = mat.weathered(mat.plain(paint, 0.35), 0.45, 7)
    for left, right, bottom, top in (window, door):
        for side in (left, right):
            add("jamb", block(0.09, 0.34, top - bottom + 0.1), varnish, (x + side, 0.1, bottom))
        add("lintel", block(right - left + 0.2, 0.36, 0.1), varnish, (x + (left + right) / 2, 0.1, top))
    middle = x + (window[0] + window[1]) / 2
    add("sill", block(window[1] - window[0] + 0.2, 0.5, 0.06), varnish, (middle, 0.06, 0.58))
    for k in range(4):
        add("panel", block(0.46, 0.05, 0.4), varnish, (middle + 0.56 * (k - 1.5), -0.01, 0.1))
    for k in (1, 2):
        bar(
            varnish,
            (x + window[0] + k * (window[1] - window[0]) / 3, 0.05, 0.62),
            (x + window[0] + k * (window[1] - window[0]) / 3, 0.05, 2.25),
            0.025,
        )
    add("fascia", block(width - 0.1, 0.12, 0.44), varnish, (x, -0.05, 2.82))
    gold = mat.weathered(mat.plain((0.85, 0.65, 0.25), 0.3), 0.7, 9)
    lettering(sign, gold, (x, -0.13, 3.03), (90, 0, 0), 0.34)
    _inside(index, x, width)


def _inside(index: int, x: float, width: float) -> None:
    tints = [(0.62, 0.48, 0.30), (0.38, 0.50, 0.30), (0.50, 0.30, 0.20)]
    darker = tuple(0.6 * c for c in tints[index])
    paper = mat.weathered(
        mat.patterned(("Checker", "Voronoi", "Wave")[index], [tints[index], darker], Scale=(6, 5, 3)[index]),
        0.55,
        4,
    )
    add("back", block(width, 0.1, STOREY), paper, (x, WALL + INSIDE + 0.05, 0))
    for side in (-1, 1):
        add("side", block(0.1, INSIDE, STOREY), paper, (x + side * (width / 2 - 0.05), WALL + INSIDE / 2, 0))
    add("floor", block(width, INSIDE, 0.05), wood(0.6), (x, WALL + INSIDE / 2, -0.04))
    add("ceiling", block(width, INSIDE, 0.05), paper, (x, WALL + INSIDE / 2, STOREY - 0.06))


def _upstairs(index: int, x: float, width: float) -> None:
    wall = mat.weathered(mat.bricks(WALLS[(index + 1) % 4], Scale=2.4), 0.5, 1.5)
    holes = [(c - 0.5, c + 0.5, 0.55, 2.1) for c in (-width / 4, width / 4)]
    add("upstairs", slab(width, STOREY, WALL, holes), wall, (x, WALL, STOREY), turn=(90, 0, 0))
    stone = mat.weathered(mat.plain((0.62, 0.57, 0.48)), 0.5, 9)
    add("cornice", block(width, 0.4, 0.16), stone, (x, 0.05, STOREY - 0.02))
    add("gutter", block(width, 0.5, 0.2), stone, (x, 0.0, 2 * STOREY))
    tiles = mat.weathered(
        mat.bricks([(0.30, 0.09, 0.05), (0.48, 0.20, 0.12), (0.12, 0.05, 0.04)], Scale=3), 0.5
    )
    add("roof", block(width, 4.0, 0.1), tiles, (x, 1.9, 2 * STOREY + 1.0), turn=(32, 0, 0))
    paint = mat.plain((0.75, 0.72, 0.65), 0.4)
    pane = mat.patterned("Noise", [(0.02, 0.03, 0.04), (0.30, 0.26, 0.20)], 0.12, Scale=2)
    shutter = mat.weathered(
        mat.plain(((0.10, 0.25, 0.22), (0.12, 0.18, 0.34), (0.30, 0.14, 0.06))[index]), 0.5, 9
    )
    rng, kinds = np.random.default_rng(40 + index), leaves()
    slat = mould("slat", block(0.42, 0.03, 0.055), shutter)
    for left, right, bottom, top in holes:
        middle, low = x + (left + right) / 2, STOREY + bottom
        add("pane", block(1.0, 0.02, top - bottom), pane, (middle, 0.17, low))
        for dx in (-0.47, 0, 0.47):
            add("frame", block(0.06, 0.06, top - bottom), paint, (middle + dx, 0.14, low))
        for dz in (0, 0.95, top - bottom - 0.06):
            add("frame", block(1.0, 0.05, 0.06), paint, (middle, 0.14, low + dz))
        for side in (-1, 1):
            for k in range(18):
                again(slat, (middle + side * 0.74, -0.02, low + 0.086 * k), (18, 0, 0))
        add("box", block(1.0, 0.2, 0.18), wood(0.5), (middle, -0.12, low - 0.1))
        for k in range(3):
            shopping.blossoms(
                bush(
                    Vector((middle + 0.32 * (k - 1), -0.12, low + 0.06)),
                    5,
                    (0.08, 0.2),
                    (0.1, 0.28),
                    0.1,
                    kinds,
                    rng,
                )[:3],
                int(rng.integers(4)),
            )


def _awning(index: int, x: float, width: float) -> None:
    def cloth(u: float, v: float) -> Vector:
        drop = (
            0.55 * v if v < 0.85 else 0.4675 + 1.0 * (v - 0.85) * (1 + 0.5 * abs(math.sin(12 * math.pi * u)))
        )
        return Vector((width * 0.94 * (u - 0.5), -1.25 * min(v / 0.85, 1), -drop))

    colours = [
        [(0.62, 0.10, 0.06), (0.82, 0.76, 0.64)],
        [(0.08, 0.30, 0.14), (0.85, 0.80, 0.66)],
        [(0.80, 0.50, 0.06), (0.30, 0.12, 0.05)],
    ][index]
    striped = mat.patterned("Wave", [colours[0], colours[0], colours[1], colours[1]], Scale=1.1)
    add("awning", patch(96, 20, cloth), mat.weathered(striped, 0.6, 4), (x, -0.02, 2.84))


def _alley() -> None:
    """Between the second and the third shop one sees far back."""
    row_of_houses(8, [(6, 26, -0.1, 0), (-3, 30, -0.1, 10), (15, 28, -0.1, -10)])
    trees(9, [(3.4, 13, 0, 4.0), (6.0, 20, 0, 6.0), (1.8, 19, 0, 5.0)])
    brick = mat.weathered(mat.bricks(WALLS[0], Scale=2.4), 0.45, 2)
    for x, turn in ((2.2, 90), (4.2, -90)):  # the walls of the alley look at each other
        add("alley", slab(8.0, 2 * STOREY, 0.2), brick, (x, 4.0, 0), turn=(90, 0, turn))
    lantern = mat.weathered(mat.plain((0.85, 0.70, 0.35), 0.2), 0.7, 9)
    iron = mat.patterned("Noise", [(0.02, 0.02, 0.03), (0.10, 0.09, 0.08)], 0.5, Scale=9)
    bar(iron, (2.1, -0.02, 3.9), (2.1, -0.6, 4.0), 0.02)
    add("lantern", cone(0.12, 0.17, 6), lantern, (2.1, -0.6, 3.75), size=(1, 1, 0.34))
    rng, kinds = np.random.default_rng(44), leaves()
    for _ in range(16):  # ivy
        root = Vector((rng.uniform(2.05, 2.2), -0.05, rng.uniform(0.0, 2.6)))
        stem(
            root,
            root + Vector((rng.uniform(-0.5, 0.05), -0.06, rng.uniform(0.5, 1.1))),
            0.05,
            10,
            0.11,
            kinds,
            rng,
        )


def _pavement() -> None:
    """What stands before the shops, out to the kerb."""
    iron = mat.patterned("Noise", [(0.02, 0.03, 0.03), (0.14, 0.12, 0.10)], 0.45, Scale=12)
    shopping.cafe(-3.9, -1.9)
    shopping.bicycle(Vector((3.25, -1.0, 0)))
    shopping.notice("FRESH BREAD", (-2.2, -2.2, 0), 12)
    shopping.notice("OLD BOOKS", (4.55, -1.7, 0), -14)
    for x in (-4.9, -1.6, 1.7, 5.0):
        smooth(add("bollard", cone(0.08, 0.06, 16), iron, (x, -2.95, 0.42), size=(1, 1, 0.84)))
        add("knob", rock, iron, (x, -2.95, 0.88), size=0.075)
    bar(iron, (-1.75, -2.5, 0), (-1.75, -2.5, 4.2), 0.05)
    bar(iron, (-1.75, -2.5, 3.9), (-1.1, -2.5, 4.15), 0.025)
    glass = mat.patterned("Voronoi", [(0.75, 0.70, 0.55), (0.95, 0.92, 0.82)], 0.15, Scale=5)
    smooth(add("globe", sphere, glass, (-1.1, -2.5, 3.95), size=0.18))


def _bunting() -> None:
    """Small flags on two lines."""
    rng = np.random.default_rng(46)
    red, yellow, blue = (0.70, 0.06, 0.05), (0.85, 0.65, 0.08), (0.06, 0.22, 0.50)
    colours = [red, yellow, blue, (0.10, 0.40, 0.18), (0.80, 0.76, 0.68)]
    looks = [mat.weathered(mat.plain(colour), 0.6, 20) for colour in colours]
    flags = [
        mould("flag", patch(1, 1, lambda u, v: Vector(((u - 0.5) * (1 - 0.9 * v), 0, -1.3 * v))), look)
        for look in looks
    ]
    cord = mat.plain((0.15, 0.12, 0.10))
    for y, high, sag in ((-1.7, 5.0, 0.4), (-2.9, 5.5, 0.6)):
        points = [
            Vector((x, y, high - sag * math.sin(1.1 * (x + 6)) ** 2)) for x in np.arange(-6, 6.01, 0.25)
        ]
        for here, there in zip(points, points[1:], strict=False):
            bar(cord, here, there, 0.006)
            again(
                flags[rng.integers(5)],
                here.lerp(there, 0.5),
                (rng.uniform(-20, 20), 0, rng.uniform(-15, 15)),
                0.2,
            )

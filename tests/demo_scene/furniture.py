"""Furniture and what stands on it. Each function models one piece with its back at y = 0, its front towards
+y, and returns its objects."""

import math

import bmesh
import bpy
import numpy as np
from mathutils import Vector

from demo_scene import materials as mat
from demo_scene.shapes import add, again, bar, block, cone, cube, lift, mould, rock, smooth, sphere, turned

Things = list[bpy.types.Object]


def wood(light: float, roughness: float = 0.5) -> bpy.types.Material:
    """Grained wood; `light` scales its colour."""
    colours = [(0.34, 0.17, 0.07), (0.58, 0.34, 0.16), (0.66, 0.43, 0.22)]
    colours = [tuple(light * c for c in colour) for colour in colours]
    grain = mat.patterned("Wave", colours, roughness, Scale=4, Distortion=14, Detail=5, Detail_Scale=1.2)
    return mat.weathered(grain, 0.6, 14)


def cloth(colours: list[mat.Colour], scale: float) -> bpy.types.Material:
    return mat.weathered(mat.patterned("Checker", colours, Scale=scale), 0.55, 30)


def covers() -> list[bpy.types.Material]:
    """What books are bound in."""
    rng = np.random.default_rng(31)
    leathers = [
        (0.20, 0.03, 0.02), (0.03, 0.07, 0.18), (0.02, 0.09, 0.05), (0.30, 0.16, 0.06), (0.07, 0.05, 0.05),
        (0.45, 0.36, 0.22), (0.35, 0.08, 0.03),
    ]  # fmt: skip
    found = []
    for ground in leathers + leathers:
        gold = rng.uniform((0.45, 0.38, 0.15), (0.75, 0.65, 0.50))
        bands = [ground, ground, tuple(0.7 * c for c in ground), ground, tuple(gold)]
        look = mat.patterned(
            "Wave", bands, 0.4, bands_direction="Z", Scale=rng.uniform(2, 5), Distortion=rng.uniform(0, 1.5)
        )
        found.append(mat.weathered(look, 0.5, 12))
    return found


def ornament(kind: int, size: float, at) -> bpy.types.Object:
    """A small thing that stands at `at`: vase, ball, box, head, cup."""
    rng = np.random.default_rng(kind + 77)
    first, second = tuple(rng.uniform(0.01, 0.25, 3)), tuple(rng.uniform((0.3, 0.2, 0.1), (0.8, 0.6, 0.5)))
    look = mat.patterned(
        ("Wave", "Noise", "Voronoi", "Magic")[kind % 4],
        [first, second],
        roughness=(0.15, 0.6)[kind % 2],
        Scale=4,
    )
    at = Vector(at)

    if kind % 5 == 0:
        vase = turned(lambda v: (0.22 + 0.16 * math.sin(3.6 * v + 0.4) + 0.05 * v * v, v), 24, 12)
        return smooth(add("vase", vase, look, at, size=size))
    if kind % 5 == 1:
        return smooth(add("ball", sphere, look, at + lift(size / 2), size=size / 2))
    if kind % 5 == 2:
        return add("box", cube, look, at + lift(0.35 * size), turn=(0, 0, 30), size=0.7 * size)
    if kind % 5 == 3:
        return add(
            "head", bmesh.ops.create_monkey, look, at + lift(0.45 * size), turn=(0, 0, 180), size=size / 2
        )
    return add("cup", cone(0.35, 0.45, 24), look, at + lift(0.4 * size), size=(size, size, 0.8 * size))


def books(
    left: float, right: float, tall: float, at_y: float, z: float, bindings: list, rng: np.random.Generator
) -> Things:
    """Books side by side from x = left to right, some of them leaning, with a few ornaments between."""
    things, x = [], left
    while x < right - 0.06:
        thick, height, deep = rng.uniform((0.018, 0.62, 0.14), (0.055, 0.93, 0.20))
        if rng.uniform() < 0.07 and x < right - 0.2:
            size = rng.uniform(0.10, 0.17)
            things.append(ornament(int(rng.integers(20)), size, (x + 0.09, at_y + 0.12, z)))
            x += 0.19
            continue
        look = bindings[rng.integers(len(bindings))]
        lean = rng.uniform(4, 11) if rng.uniform() < 0.08 else 0.0
        x += thick / 2 + height * tall * math.sin(math.radians(lean))
        things.append(
            add("book", block(thick, deep, height * tall), look, (x, at_y + deep / 2, z), turn=(0, -lean, 0))
        )
        x += thick / 2 + 0.002
    return things


def bookcase(width: float, height: float, shelves: int, seed: int) -> Things:
    rng = np.random.default_rng(seed)
    board, bindings = wood(0.6), covers()
    things = [add("back", block(width, 0.02, height), board, (0, 0.01, 0))]
    for x in (-width / 2, -width / 6, width / 6, width / 2):
        things.append(add("side", block(0.03, 0.31, height), board, (x, 0.165, 0)))
    room = height / shelves
    for k in range(shelves + 1):
        things.append(
            add("shelf", block(width + 0.04, 0.32, 0.028), board, (0, 0.175, min(k * room, height - 0.001)))
        )
        if k == shelves:
            break
        for column in (-1, 0, 1):
            left = column * width / 3 - width / 6 + 0.03
            things += books(left, left + width / 3 - 0.07, room - 0.06, 0.05, k * room + 0.029, bindings, rng)
    for k in range(7):
        things.append(ornament(k + 3, 0.22, (-1.1 + 0.36 * k, 0.17, height + 0.03)))
    return things


def sofa() -> Things:
    tweed = cloth([(0.10, 0.20, 0.20), (0.24, 0.36, 0.34)], 32)
    things = [
        add("seat", block(2.0, 0.85, 0.36), tweed, (0, 0.45, 0.04)),
        add("back", block(2.0, 0.24, 0.55), tweed, (0, 0.13, 0.38)),
    ]
    for x in (-1.09, 1.09):
        things.append(add("arm", block(0.2, 0.88, 0.64), tweed, (x, 0.46, 0.02)))
    colours = [
        [(0.75, 0.30, 0.05), (0.85, 0.70, 0.40)],
        [(0.50, 0.04, 0.08), (0.80, 0.62, 0.55)],
        [(0.06, 0.12, 0.40), (0.70, 0.68, 0.58)],
    ]
    for k, (pattern, x) in enumerate(
        (("Checker", -0.72), ("Magic", -0.30), ("Voronoi", 0.35), ("Wave", 0.75))
    ):
        look = mat.weathered(mat.patterned(pattern, colours[k % 3], Scale=4 + k), 0.6, 20)
        things.append(
            smooth(
                add(
                    "cushion",
                    sphere,
                    look,
                    (x, 0.36, 0.60),
                    turn=(-68, 0, 14 * k - 20),
                    size=(0.24, 0.22, 0.10),
                )
            )
        )
    blanket = cloth([(0.70, 0.62, 0.40), (0.20, 0.30, 0.12)], 14)
    things.append(add("blanket", block(0.5, 0.7, 0.03), blanket, (0.62, 0.54, 0.402), turn=(0, 0, 8)))
    return things


def pictures() -> Things:
    """Framed pictures in a loose group."""
    frame = wood(0.35, 0.3)
    motifs = [
        mat.patterned("Magic", [(0.9, 0.5, 0.05), (0.1, 0.05, 0.3), (0.1, 0.4, 0.5)], Scale=7, Distortion=3),
        mat.patterned("Voronoi", [(0.75, 0.60, 0.30), (0.15, 0.32, 0.30), (0.05, 0.08, 0.12)], Scale=16),
        mat.patterned(
            "Wave",
            [(0.05, 0.15, 0.30), (0.60, 0.70, 0.75), (0.85, 0.75, 0.45)],
            Scale=5,
            Distortion=9,
            Detail=3,
        ),
        mat.patterned(
            "Noise",
            [(0.05, 0.15, 0.04), (0.5, 0.6, 0.2), (0.85, 0.8, 0.6), (0.2, 0.35, 0.6)],
            Scale=8,
            Detail=8,
        ),
        mat.patterned("Voronoi", [(0.05, 0.04, 0.04), (0.75, 0.15, 0.05), (0.9, 0.8, 0.5)], Scale=9),
    ]
    things = []
    for k, (x, z, w, h) in enumerate(
        (
            (-0.75, 1.35, 0.62, 0.78),
            (0.02, 1.30, 0.72, 0.52),
            (0.02, 1.92, 0.50, 0.40),
            (0.78, 1.45, 0.56, 0.70),
            (-0.35, 1.98, 0.16, 0.3),
        )
    ):
        things.append(add("frame", block(w, 0.03, h), frame, (x, 0.016, z)))
        things.append(add("picture", block(w - 0.09, 0.03, h - 0.09), motifs[k], (x, 0.022, z + 0.045)))
    return things


def desk() -> Things:
    top = wood(0.9, 0.25)
    steel = mat.patterned("Noise", [(0.20, 0.20, 0.22), (0.50, 0.50, 0.52)], 0.3, 1.0, Scale=15)
    things = [add("top", block(1.7, 0.7, 0.04), top, (0, 0.36, 0.72))]
    for x in (-0.8, 0.8):
        for y in (0.06, 0.66):
            things.append(bar(steel, (x, y, 0), (x, y, 0.72), 0.022))
    things.append(add("drawers", block(0.42, 0.6, 0.5), top, (0.55, 0.36, 0.2)))
    for k in range(3):
        things.append(add("drawer", block(0.38, 0.02, 0.13), wood(0.7), (0.55, 0.668, 0.23 + 0.155 * k)))
    things += _monitor() + _papers() + _chair()
    for k, x in enumerate((-0.72, 0.52, 0.64, 0.73)):
        things.append(ornament((0, 4, 9, 14)[k], (0.3, 0.11, 0.10, 0.13)[k], (x, 0.2 + 0.1 * k, 0.76)))
    shade = mat.weathered(mat.plain((0.70, 0.10, 0.04), 0.25), 0.6, 9)
    things += [
        bar(steel, (-0.5, 0.15, 0.76), (-0.62, 0.2, 1.12), 0.01),
        bar(steel, (-0.62, 0.2, 1.12), (-0.40, 0.36, 1.26), 0.01),
    ]
    things.append(add("shade", cone(0.09, 0.04), shade, (-0.38, 0.38, 1.22), size=(1, 1, 0.12)))
    return things


def _monitor() -> Things:
    black = mat.weathered(mat.plain((0.03, 0.03, 0.035), 0.15), 0.4, 8)
    colours = [(0.02, 0.05, 0.12), (0.12, 0.30, 0.42), (0.50, 0.55, 0.55)]
    screen = mat.bricks(colours, Scale=7, Mortar_Size=0.05)
    colours = [(0.06, 0.06, 0.07), (0.12, 0.12, 0.13), (0.45, 0.45, 0.45)]
    keys = mat.bricks(colours, Scale=22, Brick_Width=0.5, Row_Height=0.45)
    return [
        add("foot", block(0.24, 0.18, 0.015), black, (0, 0.25, 0.76)),
        add("neck", block(0.05, 0.03, 0.15), black, (0, 0.2, 0.77)),
        add("monitor", block(0.62, 0.03, 0.38), black, (0, 0.22, 0.88)),
        add("screen", block(0.58, 0.03, 0.33), screen, (0, 0.223, 0.905)),
        add("keyboard", block(0.42, 0.14, 0.02), keys, (0, 0.5, 0.76)),
    ]


def _papers() -> Things:
    rng = np.random.default_rng(9)
    colours = [(0.80, 0.79, 0.74), (0.84, 0.82, 0.78), (0.15, 0.15, 0.18)]
    page = mat.bricks(colours, Scale=12, Brick_Width=1.2, Row_Height=0.22)
    things = []
    for k in range(7):
        x, y, turn = rng.uniform((-0.45, 0.42, -40), (0.45, 0.60, 40))
        if abs(x) < 0.24:
            x += 0.32
        things.append(
            add("page", block(0.15, 0.21, 0.002), page, (x, y, 0.7605 + 0.0022 * k), turn=(0, 0, turn))
        )
    for k, look in enumerate(covers()[:6]):
        things.append(
            add(
                "book",
                block(0.24, 0.17, 0.035),
                look,
                (0.56, 0.24, 0.761 + 0.0352 * k),
                turn=(0, 0, rng.uniform(-15, 15)),
            )
        )
    return things


def _chair() -> Things:
    frame, seat = wood(0.45), cloth([(0.55, 0.35, 0.08), (0.70, 0.55, 0.25)], 22)
    at = Vector((-0.25, 0.98, 0))
    things = [add("seat", block(0.42, 0.42, 0.05), seat, at + lift(0.44), turn=(0, 0, 12))]
    for dx, dy in ((-0.17, -0.17), (0.17, -0.17), (-0.17, 0.17), (0.17, 0.17)):
        foot = at + Vector((dx, dy, 0))
        things.append(bar(frame, foot, foot + lift(0.92 if dy > 0 else 0.45), 0.018))
    for z in (0.62, 0.74, 0.86):
        things.append(bar(frame, at + Vector((-0.17, 0.17, z)), at + Vector((0.17, 0.17, z)), 0.014))
    return things


def pinboard() -> Things:
    cork = mat.patterned("Voronoi", [(0.28, 0.15, 0.06), (0.60, 0.40, 0.20)], Scale=60)
    things = [
        add("board", block(1.4, 0.03, 0.8), cork, (0, 0.016, 1.35)),
        add("rim", block(1.46, 0.02, 0.86), wood(0.5), (0, 0.011, 1.32)),
    ]
    rng = np.random.default_rng(10)
    for k in range(26):
        x = -0.58 + 0.13 * (k % 10) + rng.uniform(-0.02, 0.02)
        z = 1.42 + 0.25 * (k // 10) + rng.uniform(-0.03, 0.05)
        colour = tuple(rng.uniform(0.15, 0.85, 3))
        colours = [colour, colour, tuple(0.2 * c for c in colour)]
        note = mat.bricks(colours, Scale=14, Brick_Width=2, Row_Height=0.25)
        lying = add(
            "note",
            block(rng.uniform(0.08, 0.12), rng.uniform(0.09, 0.16), 0.003),
            note,
            (x, 0.034 + 0.0006 * k, z),
            turn=(90, rng.uniform(-9, 9), 0),
        )
        things.append(lying)
    return things


def door() -> Things:
    leaf, trim = wood(0.75, 0.35), wood(0.4, 0.35)
    things = [
        add("frame", block(1.02, 0.06, 2.1), trim, (0, 0.03, 0)),
        add("door", block(0.88, 0.06, 2.02), leaf, (0, 0.045, 0)),
    ]
    for x in (-0.21, 0.21):
        for z, h in ((0.2, 0.75), (1.1, 0.75)):
            things.append(add("panel", block(0.3, 0.03, h), trim, (x, 0.072, z)))
    brass = mat.patterned("Noise", [(0.55, 0.30, 0.08), (0.95, 0.75, 0.40)], 0.12, 1.0, Scale=2)
    things.append(smooth(add("knob", sphere, brass, (0.37, 0.12, 1.02), size=0.035)))
    return things


def wardrobe() -> Things:
    """The dark thing in the dark corner."""
    dark, brass = wood(0.28, 0.3), mat.plain((0.8, 0.6, 0.3), 0.3)
    things = [add("wardrobe", block(1.0, 0.55, 2.0), dark, (0, 0.28, 0))]
    for x in (-0.245, 0.245):
        things.append(add("door", block(0.46, 0.03, 1.8), wood(0.4, 0.3), (x, 0.56, 0.12)))
        things.append(add("handle", block(0.02, 0.03, 0.16), brass, (0.2 * x, 0.59, 1.0)))
    for k in range(4):
        look = mat.weathered(
            mat.patterned("Checker", [(0.30, 0.18, 0.08), (0.5, 0.42, 0.30)], Scale=5 + 3 * k), 0.5, 8
        )
        things.append(
            add(
                "case",
                block(0.7 - 0.12 * k, 0.42, 0.14),
                look,
                (0.05 * (-1) ** k, 0.28, 2.001 + 0.1405 * k),
                turn=(0, 0, 6 * k),
            )
        )
    return things


def sideboard() -> Things:
    """Between the windows, with a plant, glossy vases and a clock over it."""
    board = wood(0.8, 0.2)
    things = [
        add("sideboard", block(1.1, 0.42, 0.72), board, (0, 0.22, 0.08)),
        add("plinth", block(1.0, 0.36, 0.09), board, (0, 0.22, 0)),
    ]
    for x in (-0.36, 0.0, 0.36):
        things.append(add("door", block(0.33, 0.02, 0.62), wood(0.55, 0.2), (x, 0.436, 0.13)))
    for k, (x, size) in enumerate(((-0.44, 0.32), (-0.22, 0.22), (0.02, 0.27), (0.24, 0.18), (0.43, 0.36))):
        things.append(ornament((5, 6, 10, 13, 0)[k], size, (x, 0.22, 0.8)))
    gold = mat.patterned("Noise", [(0.55, 0.34, 0.10), (0.95, 0.78, 0.42)], 0.15, 1.0, Scale=9)
    colours = [(0.85, 0.83, 0.76), (0.10, 0.10, 0.12)]
    face = mat.patterned("Wave", colours, wave_type="RINGS", rings_direction="Z", Scale=2.6)
    things.append(
        add("clock", cone(0.24, 0.22, 32), gold, (0, 0.03, 1.75), turn=(-90, 0, 0), size=(1, 1, 0.05))
    )
    things.append(
        add("dial", cone(0.19, 0.19, 32), face, (0, 0.045, 1.75), turn=(-90, 0, 0), size=(1, 1, 0.05))
    )
    return things


def lamp_and_armchair() -> Things:
    """An armchair in the corner and a lamp on a stand beside it."""
    plush = cloth([(0.35, 0.06, 0.08), (0.50, 0.16, 0.14)], 26)
    things = [
        add("seat", block(0.7, 0.7, 0.38), plush, (0, 0.5, 0.03)),
        add("back", block(0.74, 0.2, 0.9), plush, (0, 0.14, 0.1), turn=(-6, 0, 0)),
    ]
    for x in (-0.4, 0.4):
        things.append(add("arm", block(0.14, 0.72, 0.62), plush, (x, 0.5, 0.01)))
    cushion = mat.weathered(mat.patterned("Voronoi", [(0.1, 0.2, 0.3), (0.8, 0.7, 0.4)], Scale=7), 0.6, 20)
    things.append(
        smooth(add("cushion", sphere, cushion, (0, 0.38, 0.58), turn=(-65, 0, 10), size=(0.22, 0.2, 0.09)))
    )
    steel = mat.patterned("Noise", [(0.30, 0.22, 0.10), (0.70, 0.55, 0.30)], 0.25, 1.0, Scale=15)
    things += [
        bar(steel, (-0.65, 0.3, 0), (-0.65, 0.3, 1.5), 0.014),
        add("foot", cone(0.15, 0.13), steel, (-0.65, 0.3, 0.012), size=(1, 1, 0.024)),
    ]
    paper = mat.patterned("Wave", [(0.80, 0.60, 0.30), (0.92, 0.82, 0.58)], Scale=9, Distortion=1)
    things.append(
        smooth(add("shade", turned(lambda v: (0.22 - 0.08 * v, 0.3 * v)), paper, (-0.65, 0.3, 1.45)))
    )
    return things


def boxes() -> Things:
    """Crates and boxes, stacked in a corner."""
    card = mat.weathered(
        mat.patterned("Noise", [(0.38, 0.24, 0.12), (0.58, 0.40, 0.22)], Scale=5, Detail=5), 0.7, 25
    )
    tape = mat.patterned("Checker", [(0.65, 0.08, 0.05), (0.8, 0.75, 0.65)], Scale=14)
    things, z = [], 0.0
    for k, (w, d, h) in enumerate(
        ((0.56, 0.5, 0.4), (0.46, 0.42, 0.32), (0.38, 0.3, 0.28), (0.3, 0.24, 0.16))
    ):
        turn = (0, 0, (4, -9, 13, 30)[k])
        things += [
            add("box", block(w, d, h), card, (0, 0.3, z), turn=turn),
            add("tape", block(0.06, d + 0.004, h + 0.003), tape, (0, 0.3, z + 0.0005), turn=turn),
        ]
        z += h + 0.004
    return things


def low_table() -> None:
    """In the middle of the room: a round lacquered table, laid."""
    lacquer = wood(0.55, 0.08)
    add("top", cone(0.48, 0.48, 64), lacquer, (0, 0, 0.43), size=(1, 1, 0.035))
    for k in range(3):
        out = Vector((math.cos(2.1 * k), math.sin(2.1 * k), 0))
        bar(lacquer, 0.40 * out, 0.30 * out + lift(0.42), 0.022)
    z = 0.4476
    cloths = cloth([(0.75, 0.70, 0.58), (0.15, 0.25, 0.45)], 24)
    add("runner", block(0.66, 0.26, 0.004), cloths, (0, 0, z), turn=(0, 0, 35))
    for kind, size, x, y in (
        (0, 0.26, 0.02, 0.04),
        (4, 0.10, 0.22, 0.10),
        (9, 0.10, -0.20, -0.16),
        (6, 0.12, 0.12, -0.2),
        (13, 0.14, -0.14, 0.24),
    ):
        ornament(kind, size, (x, y, z + 0.0045))
    glaze = mat.patterned("Wave", [(0.05, 0.2, 0.35), (0.8, 0.75, 0.6)], 0.12, Scale=6, bands_direction="Z")
    smooth(add("bowl", turned(lambda v: (0.05 + 0.09 * v, 0.07 * v * v)), glaze, (-0.27, 0.06, z + 0.004)))
    peel = [
        mat.patterned("Noise", [a, b], 0.35, Scale=6)
        for a, b in (((0.6, 0.05, 0.02), (0.85, 0.5, 0.1)), ((0.8, 0.35, 0.02), (0.9, 0.6, 0.1)))
    ]
    fruit = mould("fruit", rock, peel[0]), mould("fruit", sphere, peel[1])
    for k in range(5):
        again(
            fruit[k % 2],
            (-0.27 + 0.055 * math.cos(1.3 * k), 0.06 + 0.055 * math.sin(1.3 * k), z + 0.07),
            (40 * k, 0, 0),
            0.038,
        )

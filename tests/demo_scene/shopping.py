"""What the shops of the row sell, and what stands before them."""

import math

import numpy as np
from mathutils import Matrix, Vector

from demo_scene import materials as mat
from demo_scene.furniture import books, cloth, covers, ornament, wood
from demo_scene.plants import bush, leaves
from demo_scene.shapes import (
    add,
    again,
    bar,
    block,
    cone,
    lettering,
    lift,
    mould,
    moved,
    rock,
    sheet,
    smooth,
    sphere,
)

PETALS = [(0.80, 0.06, 0.08), (0.90, 0.62, 0.05), (0.75, 0.20, 0.50), (0.85, 0.80, 0.72)]
FRUIT = [
    [(0.55, 0.03, 0.02), (0.85, 0.45, 0.12)],
    [(0.85, 0.38, 0.03), (0.92, 0.58, 0.10)],
    [(0.20, 0.45, 0.05), (0.62, 0.70, 0.15)],
    [(0.16, 0.03, 0.14), (0.40, 0.12, 0.30)],
    [(0.85, 0.70, 0.10), (0.70, 0.45, 0.08)],
    [(0.35, 0.20, 0.09), (0.58, 0.40, 0.20)],
]


def blossoms(places: list[Vector], colour: int) -> None:
    red = mat.patterned("Noise", [PETALS[colour], tuple(0.55 * c for c in PETALS[colour])], Scale=4)
    head = mould("petals", rock, red)
    for k, at in enumerate(places):
        again(head, at, (30 * k, 0, 50 * k), (0.045, 0.045, 0.03))


def crate(kind: int, at: Vector, turn: float, width: float = 0.6) -> None:
    """An open crate, tilted towards the street, full of fruit."""
    lath, rng = wood(0.85), np.random.default_rng(60 + kind)
    things = [add("bottom", block(width, 0.44, 0.02), lath, (0, 0, 0))]
    for y in (-0.22, 0.22):
        things += [add("lath", block(width, 0.02, 0.07), lath, (0, y, 0.02 + 0.085 * k)) for k in (0, 1)]
    for x in (-width / 2, width / 2):
        things.append(add("lath", block(0.02, 0.44, 0.16), lath, (x, 0, 0.02)))
    size = (0.042, 0.048, 0.04, 0.03, 0.05, 0.045)[kind]
    one = smooth(
        add(
            "fruit",
            sphere,
            mat.patterned("Noise", FRUIT[kind], 0.35, Scale=3, Detail=5),
            (0, 0, 0.1),
            size=size,
        )
    )
    things.append(one)
    for x in np.arange(-width / 2 + size, width / 2 - size / 2, 1.9 * size):
        for y in np.arange(-0.22 + size, 0.22 - size / 2, 1.9 * size):
            up = 0.13 + rng.uniform(0, 0.05) + 0.04 * math.cos(8 * y)
            things.append(again(one, (x, y, up), rng.uniform(0, 360, 3), size * rng.uniform(0.9, 1.1)))
    for thing in things:  # tilted around the lower edge
        thing.matrix_basis = Matrix.Rotation(math.radians(24), 4, "X") @ thing.matrix_basis
    moved(things, at, turn)


def greengrocer(x: float, y: float) -> None:
    board = wood(0.7)
    for row, (out, up) in enumerate(((-1.25, 0.30), (-0.72, 0.62))):
        add("stall", block(2.5, 0.1, up), board, (x - 0.55, out + 0.2, 0))
        for k in range(4):
            crate((k + 3 * row) % 6, Vector((x - 1.48 + 0.62 * k, out, up)), 0)
    rng, kinds = np.random.default_rng(51), leaves()
    zinc = mat.patterned("Noise", [(0.25, 0.27, 0.28), (0.55, 0.56, 0.56)], 0.3, 1.0, Scale=7)
    for k in range(5):  # buckets of flowers by the door
        at = Vector((x + 0.95 + 0.27 * k, -0.5 - 0.38 * (k % 2), 0))
        add("bucket", cone(0.10, 0.14, 20), zinc, at + lift(0.16), size=(1, 1, 0.32))
        blossoms(bush(at + lift(0.26), 8, (0.06, 0.2), (0.25, 0.55), 0.11, kinds, rng), k % 4)
    shelves(x, y + 1.45, 3.4, 3, 70)
    add("display", block(2.2, 0.5, 0.08), board, (x - 0.55, y + 0.32, 0.62))
    for k in range(3):
        crate((k + 2) % 6, Vector((x - 1.25 + 0.68 * k, y + 0.36, 0.72)), 0)


def shelves(x: float, y: float, width: float, count: int, seed: int) -> None:
    """Shelves at the back of a shop, with jars and boxes."""
    rng, board = np.random.default_rng(seed), wood(0.55)
    for k in range(count):
        z = 0.75 + 0.55 * k
        add("shelf", block(width, 0.3, 0.03), board, (x, y, z))
        for place in np.arange(-width / 2 + 0.12, width / 2 - 0.05, 0.21):
            ornament(int(rng.integers(20)), rng.uniform(0.15, 0.3), (x + place, y, z + 0.031))


def bakery(x: float, y: float) -> None:
    colours = [(0.25, 0.09, 0.02), (0.60, 0.33, 0.10), (0.85, 0.66, 0.38)]
    crust = mat.patterned("Noise", colours, Scale=3, Detail=6)
    loaf, cake_board = mould("loaf", sphere, crust), wood(0.8)
    rng = np.random.default_rng(52)
    for depth, up in ((0.2, 0.66), (0.45, 0.95), (0.7, 1.24)):
        add("step", block(2.3, 0.26, 0.03), cake_board, (x - 0.57, y + depth, up))
        for place in np.arange(-1.05, 1.06, 0.19):
            again(
                loaf,
                (x - 0.57 + place, y + depth, up + 0.09),
                (0, 0, rng.uniform(-30, 30)),
                (0.075, rng.uniform(0.06, 0.15), 0.06),
            )
    icing = [
        mat.patterned("Wave", [a, b], 0.3, Scale=3, Distortion=3)
        for a, b in (((0.8, 0.35, 0.42), (0.9, 0.85, 0.8)), ((0.12, 0.05, 0.02), (0.85, 0.7, 0.5)))
    ]
    for k in range(5):
        add(
            "cake",
            cone(0.15, 0.14, 24),
            icing[k % 2],
            (x - 1.45 + 0.42 * k, y + 0.98, 1.62),
            size=(1, 1, 0.16),
        )
    add("step", block(2.3, 0.34, 0.03), cake_board, (x - 0.57, y + 0.98, 1.51))
    shelves(x, y + 1.5, 3.4, 4, 71)


def bookshop(x: float, y: float) -> None:
    rng, bindings, board = np.random.default_rng(53), covers(), wood(0.6)
    for k in range(5):
        z = 0.3 + 0.42 * k
        add("shelf", block(3.6, 0.3, 0.03), board, (x, y + 1.5, z))
        moved(books(-1.7, 1.7, 0.36, -0.1, z + 0.031, bindings, rng), (x, y + 1.45, 0), 0)
    for depth, up in ((0.18, 0.64), (0.45, 0.92)):
        add("step", block(2.3, 0.28, 0.03), board, (x - 0.57, y + depth, up))
        moved(books(-1.1, 1.1, 0.3, -0.1, up + 0.031, bindings, rng), (x - 0.57, y + depth, 0), 0)
    add("table", block(1.3, 0.5, 0.05), board, (x - 0.9, -0.75, 0.7))
    for k in range(4):
        bar(
            board,
            (x - 1.5 + 1.2 * (k % 2), -0.95 + 0.4 * (k // 2), 0),
            (x - 1.5 + 1.2 * (k % 2), -0.95 + 0.4 * (k // 2), 0.7),
            0.03,
        )
    moved(books(-0.6, 0.6, 0.28, -0.1, 0.751, bindings, rng), (x - 0.9, -0.78, 0), 0)


def cafe(x: float, y: float) -> None:
    """Two small tables with chairs, laid."""
    iron = mat.patterned("Noise", [(0.02, 0.08, 0.05), (0.08, 0.20, 0.13)], 0.4, Scale=12)
    seat = wood(0.9)
    for k in range(2):
        at = Vector((x + 1.35 * k, y + 0.35 * k, 0))
        add(
            "top",
            cone(0.36, 0.36, 40),
            cloth([(0.80, 0.76, 0.66), (0.55, 0.10, 0.08)], 14),
            at + lift(0.72),
            size=(1, 1, 0.03),
        )
        bar(iron, at, at + lift(0.7), 0.03)
        add("foot", cone(0.22, 0.18, 24), iron, at + lift(0.015), size=(1, 1, 0.03))
        for j, (dx, dy) in enumerate(((-0.1, -0.1), (0.14, 0.02), (-0.02, 0.16))):
            ornament(
                4 + 5 * ((j + k) % 3) if j else 15 * k, (0.2, 0.11, 0.11)[j], at + Vector((dx, dy, 0.736))
            )
        for turn in (25 + 40 * k, 205 + 15 * k):
            moved(
                _stool(iron, seat),
                at + 0.62 * Vector((math.cos(math.radians(turn)), math.sin(math.radians(turn)), 0)),
                turn - 90,
            )


def _stool(iron, seat) -> list:
    """A chair whose back is away from the table, which lies at -y."""
    things = [add("seat", block(0.38, 0.36, 0.03), seat, (0, 0, 0.44))]
    for dx in (-0.16, 0.16):
        for dy in (-0.15, 0.15):
            things.append(bar(iron, (dx, dy, 0), (dx, dy, 0.86 if dy > 0 else 0.45), 0.013))
    return things + [bar(iron, (-0.16, 0.15, z), (0.16, 0.15, z), 0.012) for z in (0.6, 0.7, 0.8, 0.86)]


def bicycle(at: Vector) -> None:
    """It leans on its stand before the alley, along x."""
    tyre = mat.plain((0.03, 0.03, 0.03))
    paint = mat.weathered(mat.plain((0.05, 0.30, 0.38), 0.25), 0.6, 9)
    steel = mat.patterned("Noise", [(0.4, 0.4, 0.4), (0.7, 0.7, 0.7)], 0.3, 1.0, Scale=9)

    def ring(u: float, v: float) -> Vector:
        out = 0.33 + 0.02 * math.cos(2 * math.pi * v)
        return Vector(
            (
                out * math.cos(2 * math.pi * u),
                0.02 * math.sin(2 * math.pi * v),
                out * math.sin(2 * math.pi * u),
            )
        )

    hubs = [at + Vector((dx, 0, 0.35)) for dx in (-0.52, 0.52)]
    for hub in hubs:
        smooth(add("tyre", sheet(48, 8, ring, closed=True), tyre, hub))
        for angle in np.arange(0, 2 * math.pi, math.pi / 8):
            bar(steel, hub, hub + 0.32 * Vector((math.cos(angle), 0, math.sin(angle))), 0.004)
    saddle, pedals = at + Vector((-0.22, 0, 0.86)), at + Vector((-0.08, 0, 0.32))
    head = at + Vector((0.38, 0, 0.82))
    for start, end in (
        (hubs[0], saddle),
        (hubs[0], pedals),
        (pedals, saddle),
        (pedals, head),
        (saddle - lift(0.1), head),
        (hubs[1], head),
    ):
        bar(paint, start, end, 0.018)
    bar(steel, head, head + Vector((-0.04, 0, 0.18)), 0.014)
    bar(steel, head + Vector((-0.04, -0.28, 0.18)), head + Vector((-0.04, 0.28, 0.18)), 0.013)
    add("saddle", block(0.26, 0.14, 0.05), wood(0.35), saddle)
    add(
        "basket",
        block(0.26, 0.34, 0.24),
        cloth([(0.55, 0.36, 0.15), (0.30, 0.17, 0.06)], 28),
        head + Vector((0.2, 0, -0.02)),
    )


def notice(text: str, at, turn: float) -> None:
    """A board on the pavement."""
    slate = mat.patterned("Noise", [(0.03, 0.04, 0.04), (0.10, 0.11, 0.11)], Scale=9, Detail=6)
    frame = wood(0.7)
    chalk = mat.weathered(mat.plain((0.85, 0.83, 0.75)), 0.5, 30)
    things = [
        add("board", block(0.62, 0.03, 0.95), frame, (0, 0, 0)),
        add("slate", block(0.54, 0.03, 0.82), slate, (0, -0.006, 0.08)),
    ]
    for k, word in enumerate(text.split()):
        things.append(lettering(word, chalk, (0, -0.024, 0.72 - 0.2 * k), (90, 0, 0), 0.15))
    for k in range(3):
        things.append(add("line", block(0.36 - 0.06 * k, 0.005, 0.025), chalk, (0, -0.022, 0.33 - 0.08 * k)))
    moved(things, at, turn)

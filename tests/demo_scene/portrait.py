"""A potted plant on a stump, close up, before houses and trees that stand 20 to 60 m behind it.

Metres, z up. Everything is placed by constants or fixed seeds.
"""

import math

import bpy
import numpy as np
from mathutils import Vector

from demo_scene import lights
from demo_scene import materials as mat
from demo_scene.houses import row_of_houses
from demo_scene.plants import bush, leaf, leaves, stem, trees, tuft
from demo_scene.shapes import (
    add,
    again,
    bar,
    block,
    cone,
    cube,
    lift,
    mould,
    rock,
    sheet,
    smooth,
    sphere,
    turned,
)
from demo_scene.views import Pose, pose

DOME_RADIUS = 75.0
STUMP = 0.5  # m, its height
POT = 0.27
HEART = np.array([0.0, 0.0, 0.95])  # what the phone is held towards


def build(scene: bpy.types.Scene) -> None:
    lights.sun(scene, 4.2, 2, (1.0, 0.90, 0.76), (52, 0, 20))
    lights.sky(scene, (0.48, 0.62, 0.85), 0.9)
    _ground()
    _grass()
    _litter()
    _stump()
    _potted_plant()
    _gnome()
    _far()
    _fence()
    _strollers()


def cameras(count: int) -> list[Pose]:
    """Half around the plant at arm's length, from left to right, the phone held a little differently in each
    view."""
    rng = np.random.default_rng(21)
    poses = []
    for number, along in enumerate(np.linspace(0, 1, count)):
        hand = rng.uniform(-1, 1, 6)
        angle = math.pi * (along - 0.5) + 0.02 * hand[0]
        away = 1.32 + 0.12 * math.sin(5 * along) + 0.04 * hand[1]
        height = 1.18 + 0.22 * math.sin(9 * along + 0.5) + 0.04 * hand[2]
        eye = [away * math.cos(angle), away * math.sin(angle), height]
        poses.append(
            pose(number, eye, HEART + 0.04 * hand[3:], roll=0.04 * math.sin(7 * along) + 0.01 * hand[5])
        )
    return poses


def _height(x: float, y: float) -> float:
    distance, angle = math.hypot(x, y), math.atan2(y, x)
    rise = min(max((distance - 16) / 50, 0), 1)
    near = min(max((distance - 0.6) / 2, 0), 1)
    bumps = 0.05 * math.sin(1.9 * x + 0.4) * math.sin(1.6 * y) * near
    return bumps + rise * rise * (3 + 1.5 * math.sin(3 * angle) + 0.6 * math.sin(8 * angle + 1))


def _ground() -> None:
    def place(u: float, v: float) -> Vector:
        away = 0.1 + (DOME_RADIUS + 2) * v**2.5
        x, y = away * math.cos(2 * math.pi * u), away * math.sin(2 * math.pi * u)
        return Vector((x, y, _height(x, y)))

    grass = [(0.05, 0.09, 0.02), (0.08, 0.20, 0.03), (0.22, 0.36, 0.07), (0.46, 0.44, 0.17), (0.6, 0.5, 0.25)]
    lawn = mat.patterned("Noise", grass, Scale=0.35, Detail=12, Roughness=0.9)
    lawn = mat.weathered(mat.weathered(lawn, 0.35, 1.7, 0.9), 0.4, 16)
    smooth(add("ground", sheet(128, 64, place, closed=False), lawn))
    dome = add("sky", sphere, mat.sky(1.0), size=DOME_RADIUS)
    dome.visible_shadow = dome.visible_diffuse = False  # only looked at


def _grass() -> None:
    rng = np.random.default_rng(5)
    looks = [
        mat.patterned(
            "Noise", [(0.03, 0.10, 0.01), (0.12, 0.26, 0.03), (0.40, 0.48, 0.12)], Scale=3, Detail=3
        ),
        mat.patterned("Noise", [(0.16, 0.18, 0.04), (0.50, 0.44, 0.18)], Scale=3),
    ]
    tufts = [mould("tuft", tuft(26, seed), looks[seed % 3 == 2]) for seed in range(6)]
    for _ in range(900):
        away, angle, size, turn = rng.uniform((0, -math.pi, 0.10, 0), (1, math.pi, 0.20, 360))
        away = 0.42 + 12 * away**2
        x, y = away * math.cos(angle), away * math.sin(angle)
        again(tufts[rng.integers(6)], (x, y, _height(x, y) - 0.01), (0, 0, turn), size)
    daisy, dandelion, clover = (0.85, 0.82, 0.75), (0.85, 0.60, 0.02), (0.60, 0.12, 0.40)
    heads = [mould("flower", rock, mat.plain(petals)) for petals in (daisy, dandelion, clover)]
    for _ in range(420):
        away, angle, up = rng.uniform((0.5, -math.pi, 0.06), (9, math.pi, 0.15))
        x, y = away * math.cos(angle), away * math.sin(angle)
        again(heads[rng.integers(3)], (x, y, _height(x, y) + up), (0, 0, 0), (0.016, 0.016, 0.009))


def _litter() -> None:
    """Fallen leaves and stones on the lawn, and a path of flags that leads to the houses."""
    rng = np.random.default_rng(6)
    fallen = [
        mat.patterned("Noise", [(0.25, 0.08, 0.02), (0.60, 0.32, 0.05), (0.75, 0.60, 0.20)], Scale=s)
        for s in (2, 5)
    ]
    dry = [mould("dry leaf", leaf, look) for look in fallen]
    for _ in range(380):
        away, angle, size = rng.uniform((0.6, -math.pi, 0.08), (11, math.pi, 0.2))
        x, y = away * math.cos(angle), away * math.sin(angle)
        again(
            dry[rng.integers(2)],
            (x, y, _height(x, y) + 0.04),
            rng.uniform((-20, -20, 0), (20, 20, 360)),
            size,
        )
    stone = mat.patterned("Voronoi", [(0.14, 0.13, 0.13), (0.50, 0.46, 0.40)], Scale=3)
    boulder, flag = mould("boulder", rock, stone), mould("flag", cone(0.32, 0.30, 9), stone)
    for _ in range(60):
        away, angle, size = rng.uniform((0.7, -math.pi, 0.02), (9, math.pi, 0.09))
        x, y = away * math.cos(angle), away * math.sin(angle)
        again(boulder, (x, y, _height(x, y)), rng.uniform(0, 360, 3), size)
    for k in range(24):
        x, y = -1.0 - 0.75 * k, 1.5 * math.sin(0.35 * k) + 0.2 * (-1) ** k
        again(flag, (x, y, _height(x, y) + 0.01), (0, 0, 70 * k), (1, 1, 0.06))


def _stump() -> None:
    def side(u: float, v: float) -> Vector:
        angle = 2 * math.pi * u
        flare = 0.30 + 0.16 * (1 - v) ** 3 * (1 + 0.5 * math.sin(5 * angle))
        out = flare + 0.012 * math.sin(17 * angle + 3 * v) + 0.008 * math.sin(31 * angle + 1)
        return Vector((out * math.cos(angle), out * math.sin(angle), STUMP * 0.3 * v))

    bark = [(0.04, 0.025, 0.015), (0.16, 0.10, 0.06), (0.34, 0.25, 0.17), (0.20, 0.24, 0.10)]
    rough = mat.weathered(mat.patterned("Noise", bark, Scale=16, Detail=6, Roughness=0.8), 0.4, 40)
    # Modelled low and stretched, so that the bark's pattern runs upwards.
    smooth(add("stump", sheet(120, 8, side, closed=False), rough, size=(1, 1, 1 / 0.3)))
    cut = [(0.26, 0.15, 0.07), (0.60, 0.42, 0.23), (0.46, 0.30, 0.15)]
    rings = mat.patterned(
        "Wave", cut, wave_type="RINGS", rings_direction="Z", Scale=11, Distortion=2.5, Detail=3
    )
    add("cut", cone(0.315, 0.30, 48), mat.weathered(rings, 0.5, 6), (0, 0, STUMP - 0.008), size=(1, 1, 0.02))


def _potted_plant() -> None:
    def wall(v: float) -> tuple[float, float]:
        outside = min(v / 0.8, 1)
        up = POT * outside if v <= 0.8 else POT * (1 - 0.25 * (v - 0.8) / 0.2)
        out = 0.095 + 0.055 * outside**1.3 + (0.012 if 0.64 < v <= 0.8 else 0) - (0.02 if v > 0.8 else 0)
        return out, up

    clay = [(0.06, 0.16, 0.26), (0.55, 0.50, 0.38), (0.62, 0.22, 0.08), (0.07, 0.20, 0.30)]
    glaze = mat.patterned("Wave", clay, roughness=0.25, Scale=7, Distortion=7, Detail=3, bands_direction="Z")
    smooth(add("pot", turned(wall, 64, 40), glaze, (-0.02, 0.02, STUMP)))
    soil = mat.patterned("Noise", [(0.02, 0.012, 0.008), (0.10, 0.065, 0.04)], Scale=40)
    middle = Vector((-0.02, 0.02, STUMP + POT))
    add("soil", cone(0.135, 0.135), soil, middle - lift(0.03), size=(1, 1, 0.02))
    rng = np.random.default_rng(17)
    kinds = leaves()
    ends = bush(middle - lift(0.03), 21, (0.12, 0.36), (0.20, 0.70), 0.155, kinds, rng)
    for k in range(7):  # hanging over the rim
        angle = 0.9 * k + 0.3
        out = Vector((math.cos(angle), math.sin(angle), 0))
        stem(
            middle + 0.09 * out, middle + 0.24 * out - lift(rng.uniform(0.1, 0.3)), 0.16, 7, 0.075, kinds, rng
        )
    _blossoms(ends[::2])


def _blossoms(places: list[Vector]) -> None:
    red = mat.patterned("Noise", [(0.75, 0.03, 0.06), (0.90, 0.25, 0.30), (0.95, 0.75, 0.70)], 0.5, Scale=2)
    gold = mat.patterned("Noise", [(0.35, 0.15, 0.01), (0.90, 0.60, 0.05)], Scale=3)
    petal, heart = mould("petal", sphere, red), mould("heart", rock, gold)
    for index, at in enumerate(places):
        again(heart, at, (0, 0, 0), 0.016)
        for k in range(6):
            angle = math.pi * k / 3 + index
            out = Vector((math.cos(angle), math.sin(angle), 0.15))
            again(petal, at + 0.034 * out, (0, -25, math.degrees(angle)), (0.026, 0.016, 0.005))


def _gnome() -> None:
    at = Vector((0.16, -0.20, STUMP))
    coat = mat.patterned("Checker", [(0.05, 0.12, 0.40), (0.75, 0.70, 0.55)], Scale=9)
    skin = mat.weathered(mat.plain((0.72, 0.42, 0.30), 0.5), 0.7, 9)
    beard = mat.patterned("Wave", [(0.55, 0.52, 0.48), (0.9, 0.88, 0.84)], Scale=6, Distortion=4)
    colours = [(0.62, 0.03, 0.03), (0.85, 0.70, 0.10)]
    hat = mat.patterned("Wave", colours, 0.3, Scale=2.2, Distortion=2, bands_direction="Z")
    smooth(add("coat", cone(0.065, 0.035), coat, at + lift(0.06), size=(1, 1, 0.12)))
    smooth(add("head", sphere, skin, at + lift(0.145), size=0.042))
    smooth(add("beard", sphere, beard, at + Vector((0.028, -0.02, 0.115)), size=(0.03, 0.03, 0.045)))
    smooth(add("nose", sphere, skin, at + Vector((0.038, -0.025, 0.15)), size=0.012))
    smooth(
        add(
            "hat", cone(0.05, 0.004), hat, at + Vector((-0.006, 0, 0.215)), turn=(0, -8, 0), size=(1, 1, 0.12)
        )
    )
    brass = mat.patterned("Noise", [(0.55, 0.30, 0.08), (0.95, 0.75, 0.40)], 0.15, 1, Scale=2)
    smooth(add("ball", sphere, brass, (0.17, 0.17, STUMP + 0.05), size=0.05))
    can = mat.weathered(mat.plain((0.10, 0.32, 0.30), 0.35), 0.45, 9)
    smooth(add("can", cone(0.06, 0.05), can, (0.03, 0.23, STUMP + 0.055), size=(1, 1, 0.11)))
    bar(can, (0.06, 0.25, STUMP + 0.03), (0.17, 0.30, STUMP + 0.13), 0.008)


def _ring(count: int, seed: int, away: tuple[float, float], first: float = 0.0, last: float = 2 * math.pi):
    """Places (x, y, z, angle) around the plant, evenly spread over an arc, with jitter."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        angle = first + (last - first) * (k + rng.uniform(0.2, 0.8)) / count
        out = rng.uniform(*away)
        x, y = out * math.cos(angle), out * math.sin(angle)
        yield x, y, _height(x, y), angle


def _far() -> None:
    rng = np.random.default_rng(12)
    row_of_houses(
        2,
        [
            (x, y, z - 0.3, math.degrees(angle) - 90 + rng.uniform(-25, 25))
            for x, y, z, angle in _ring(9, 31, (30, 46), 1.2, 5.1)
        ],
    )
    near = [(x, y, z, rng.uniform(4, 6)) for x, y, z, _ in _ring(9, 32, (20, 27))]
    trees(1, near + [(x, y, z, rng.uniform(7, 12)) for x, y, z, _ in _ring(56, 33, (42, 62))])


def _fence() -> None:
    """White pales, 20 m behind the plant."""
    paint = mat.weathered(mat.plain((0.80, 0.78, 0.72)), 0.6, 2)
    pale = mould("pale", block(0.16, 0.04, 1.0), paint)
    posts = []
    for angle in np.arange(1.7, 4.6, 0.3 / 19):
        x, y = 19 * math.cos(angle), 19 * math.sin(angle)
        posts.append(Vector((x, y, _height(x, y))))
        again(pale, posts[-1], (0, 0, math.degrees(angle) + 90))
    for here, there in zip(posts[::6], posts[6::6], strict=False):
        bar(paint, here + lift(0.75), there + lift(0.75), 0.04)


def _strollers() -> None:
    """People and cars between the fence and the houses."""
    rng = np.random.default_rng(14)
    tyre = mat.plain((0.02, 0.02, 0.02))
    for x, y, z, _ in _ring(9, 41, (20.5, 27), 1.6, 4.7):
        colours = [tuple(rng.uniform(0.02, 0.7, 3)), tuple(rng.uniform(0.02, 0.7, 3))]
        coat = mat.patterned("Checker", colours, Scale=3)
        add("coat", cone(0.32, 0.18, 12), coat, (x, y, z + 0.75), size=(1, 1, 1.5))
        add("head", rock, mat.plain((0.6, 0.38, 0.27)), (x, y, z + 1.64), size=0.15)
    for x, y, z, angle in _ring(5, 42, (24, 29), 1.5, 4.9):
        paint = mat.weathered(mat.plain(tuple(rng.uniform(0.03, 0.6, 3)), 0.2), 0.7, 1)
        turn = (0, 0, math.degrees(angle) + 90 + rng.uniform(-20, 20))
        add("body", block(4.2, 1.7, 0.75), paint, (x, y, z + 0.3), turn=turn)
        add(
            "cabin",
            cube,
            mat.plain((0.03, 0.05, 0.07), 0.1),
            (x, y, z + 1.3),
            turn=turn,
            size=(2.2, 1.5, 0.55),
        )
        ahead = Vector((math.cos(math.radians(turn[2])), math.sin(math.radians(turn[2])), 0))
        for end in (-1.3, 1.3):
            add(
                "wheels",
                cone(0.33, 0.33, 16),
                tyre,
                Vector((x, y, z + 0.33)) + end * ahead,
                turn=(90, 0, turn[2]),
                size=(1, 1, 1.8),
            )

"""The scene: a paved yard with things on it, a meadow and hills around, a sky dome over all.

Metres, z up. Everything is placed by constants or fixed seeds.
"""

import math

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector
from mathutils.bvhtree import BVHTree

from . import materials as mat

DOME_RADIUS = 60.0
PAVING = 0.06  # height of the yard's floor
# A magenta ball on the column: the one thing of its colour, so a test can find it in an image.
MARKER = {"centre": [1.3, -0.6, 1.82], "radius": 0.12, "rgb": [255, 0, 255]}


def build_scene() -> bpy.types.Scene:
    """Replace whatever is open by the demo scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    _light(scene)
    _surroundings()
    _monument()
    _column()
    _clutter()
    _toys()
    _crates()
    _railing()
    _trellis()
    return scene


def world_surface(scene: bpy.types.Scene) -> BVHTree:
    """Every visible surface, in world coordinates, as one tree for ray casts."""
    vertices, polygons = [], []
    for thing in scene.objects:
        if thing.type != "MESH":
            continue
        first = len(vertices)
        vertices += [thing.matrix_world @ vertex.co for vertex in thing.data.vertices]
        polygons += [[first + k for k in face.vertices] for face in thing.data.polygons]
    return BVHTree.FromPolygons(vertices, polygons)


def _add(name, shape, material, at=(0, 0, 0), turn=(0, 0, 0), size=1.0) -> bpy.types.Object:
    """A new object; `shape` fills an empty bmesh, `turn` is in degrees, `size` scales."""
    solid = bmesh.new()
    shape(solid)
    mesh = bpy.data.meshes.new(name)
    solid.to_mesh(mesh)
    solid.free()
    mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(thing)
    thing.location = at
    thing.rotation_euler = [math.radians(angle) for angle in turn]
    thing.scale = (size, size, size) if isinstance(size, float | int) else size
    bpy.context.view_layer.update()
    return thing


def _smooth(thing: bpy.types.Object) -> bpy.types.Object:
    """Shade smoothly, with normals of our own.

    Those that Blender derives sum faces in an order that varies between runs: the last bits of
    some pixels vary with it, and the denoiser spreads them.
    """
    mesh = thing.data
    mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
    normals = np.zeros((len(mesh.vertices), 3))
    for face in mesh.polygons:
        normals[list(face.vertices)] += np.array(face.normal) * face.area
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    attribute = mesh.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT")
    attribute.data.foreach_set("vector", normals.astype(np.float32).ravel())
    return thing


def _cube(solid) -> None:
    bmesh.ops.create_cube(solid, size=1)


def _sphere(solid) -> None:
    bmesh.ops.create_uvsphere(solid, u_segments=48, v_segments=24, radius=1)


def _rock(solid) -> None:
    bmesh.ops.create_icosphere(solid, subdivisions=2, radius=1)


def _cone(bottom: float, top: float, segments: int = 32):
    """A frustum of height 1 around the z axis, its middle at the origin."""

    def shape(solid) -> None:
        bmesh.ops.create_cone(
            solid, cap_ends=True, segments=segments, radius1=bottom, radius2=top, depth=1
        )

    return shape


def _grid(columns: int, rows: int, place, closed: bool):
    """A sheet of quads, round in u; `place` takes u and v in 0..1 to a point."""

    def shape(solid) -> None:
        height = rows if closed else rows + 1
        points = [
            [solid.verts.new(place(column / columns, row / rows)) for column in range(columns)]
            for row in range(height)
        ]
        for row in range(rows):
            for column in range(columns):
                here, above = points[row], points[(row + 1) % height]
                right = (column + 1) % columns
                solid.faces.new((here[column], here[right], above[right], above[column]))

    return shape


def _light(scene: bpy.types.Scene) -> None:
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy = 3.2
    sun.angle = math.radians(4)
    sun.color = (1.0, 0.93, 0.82)
    lamp = bpy.data.objects.new("sun", sun)
    lamp.rotation_euler = (math.radians(48), 0, math.radians(35))
    scene.collection.objects.link(lamp)
    scene.world = bpy.data.worlds.new("world")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    background = next(n for n in scene.world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs["Color"].default_value = (0.45, 0.60, 0.85, 1)
    background.inputs["Strength"].default_value = 0.75


def _hill_height(x: float, y: float) -> float:
    distance, angle = math.hypot(x, y), math.atan2(y, x)
    rise = min(max((distance - 12) / 33, 0), 1)
    waves = 3.2 + 2 * math.sin(3 * angle + 1) + math.sin(7 * angle) + 0.5 * math.sin(13 * angle)
    return rise * rise * (3 - 2 * rise) * max(waves, 0.6)


def _surroundings() -> None:
    def ground(u: float, v: float) -> Vector:
        distance = 0.5 + (DOME_RADIUS + 2) * v * v
        x, y = distance * math.cos(2 * math.pi * u), distance * math.sin(2 * math.pi * u)
        return Vector((x, y, _hill_height(x, y)))

    grass = [(0.0, 0.02, 0.0), (0.02, 0.08, 0.01), (0.10, 0.20, 0.03), (0.42, 0.36, 0.12), (0.7, 0.6, 0.3)]
    meadow = mat.patterned("meadow", "Noise", grass, Scale=2.3, Detail=5, Roughness=0.85)
    _smooth(_add("ground", _grid(96, 48, ground, closed=False), meadow))
    dome = _add("sky", _sphere, mat.sky("sky", 1.0), size=DOME_RADIUS)
    # The dome is only looked at: light comes from the lamp and the world behind it.
    dome.visible_shadow = dome.visible_diffuse = False

    floor = mat.bricks(
        "floor", [(0.42, 0.17, 0.10), (0.62, 0.36, 0.22), (0.55, 0.53, 0.48)], Scale=3.2
    )
    _add("yard", _cone(2.5, 2.5, 64), floor, at=(0, 0, PAVING / 2), size=(1, 1, PAVING))
    _pines_and_rocks()


def _pines_and_rocks() -> None:
    rng = np.random.default_rng(3)
    needles = mat.patterned(
        "pine", "Noise", [(0.01, 0.03, 0.01), (0.03, 0.10, 0.03), (0.10, 0.22, 0.06)], Scale=9
    )
    stone = mat.patterned("rock", "Voronoi", [(0.10, 0.10, 0.11), (0.45, 0.42, 0.38)], Scale=3)
    for index in range(48):
        angle, away, size = rng.uniform((0, 7.5, 0.7), (2 * math.pi, 30, 1.3))
        x, y = away * math.cos(angle), away * math.sin(angle)
        base = _hill_height(x, y) - 0.1
        if index % 4 == 0:
            size *= 0.5
            _add("rock", _rock, stone, at=(x, y, base), turn=rng.uniform(0, 360, 3), size=size)
        else:
            tall = (0.8 * size, 0.8 * size, 3.2 * size)
            _smooth(_add("pine", _cone(1, 0.02, 12), needles, at=(x, y, base + tall[2] / 2), size=tall))


def _monument() -> None:
    marble = mat.patterned(
        "marble", "Wave", [(0.75, 0.72, 0.66), (0.55, 0.50, 0.46), (0.16, 0.14, 0.15)],
        roughness=0.4, Scale=1.6, Distortion=9, Detail=4,
    )
    _add("pedestal", _cube, marble, at=(0, 0, PAVING + 0.35), turn=(0, 0, 20), size=(0.8, 0.8, 0.7))
    glaze = mat.patterned(
        "glaze", "Noise", [(0.02, 0.10, 0.16), (0.05, 0.35, 0.40), (0.80, 0.55, 0.15), (0.5, 0.08, 0.04)],
        roughness=0.35, Scale=4, Detail=6, Distortion=0.5,
    )
    monkey = _add(
        "monkey", bmesh.ops.create_monkey, glaze,
        at=(0, 0, PAVING + 1.19), turn=(-6, 0, 70), size=0.52,
    )
    monkey.modifiers.new("rounder", "SUBSURF").levels = 2
    finished = monkey.evaluated_get(bpy.context.evaluated_depsgraph_get())
    monkey.data = bpy.data.meshes.new_from_object(finished)
    monkey.modifiers.clear()
    _smooth(monkey)


def _column() -> None:
    """The occluder: it stands in front of the clutter."""
    bands = mat.patterned(
        "bands", "Wave", [(0.06, 0.10, 0.30), (0.85, 0.80, 0.62)], Scale=3.2, Distortion=7, Detail=3
    )
    x, y, z = MARKER["centre"]
    top = z - MARKER["radius"]
    _smooth(_add("column", _cone(0.17, 0.14), bands, at=(x, y, top / 2), size=(1, 1, top)))
    colour = tuple(value / 255 for value in MARKER["rgb"])
    _add("marker", _sphere, mat.glowing("marker", colour), at=MARKER["centre"], size=MARKER["radius"])


def _clutter() -> None:
    rng = np.random.default_rng(11)
    shapes = (_cube, _rock, _cone(0.6, 0.0), _cone(0.4, 0.4))
    finishes = [
        mat.cells("confetti", 7),
        mat.patterned("checks", "Checker", [(0.9, 0.85, 0.7), (0.6, 0.04, 0.03)], Scale=4),
        mat.patterned("swirl", "Magic", [(0.9, 0.5, 0.05), (0.1, 0.05, 0.3)], Scale=3, Distortion=2),
        mat.patterned("moss", "Noise", [(0.02, 0.08, 0.02), (0.5, 0.7, 0.2)], Scale=5, Detail=6),
    ]
    for index in range(34):
        x, y, size = rng.uniform((0.55, -1.25, 0.09), (1.15, 0.95, 0.20))
        _add(
            "clutter", shapes[index % 4], finishes[(index // 4) % 4],
            at=(x, y, PAVING + size * 0.5), turn=(0, 0, rng.uniform(0, 360)), size=size,
        )


def _toys() -> None:
    ball = _add("ball", _sphere, mat.cells("cells", 5), at=(-1.15, 0.75, PAVING + 0.4), size=0.4)
    _smooth(ball).rotation_euler = (0.4, 0.2, 0)
    brass = mat.patterned(
        "brass", "Noise", [(0.55, 0.30, 0.08), (0.95, 0.75, 0.40)], roughness=0.12, metallic=1, Scale=2
    )
    _smooth(_add("glossy ball", _sphere, brass, at=(-0.95, -0.95, PAVING + 0.36), size=0.36))

    def ring(u: float, v: float) -> Vector:
        out = 0.42 + 0.15 * math.cos(2 * math.pi * v)
        return Vector((out * math.cos(2 * math.pi * u), out * math.sin(2 * math.pi * u), 0.15 * math.sin(2 * math.pi * v)))

    stripes = mat.patterned(
        "stripes", "Wave", [(0.8, 0.1, 0.05), (0.95, 0.85, 0.7)], roughness=0.3, Scale=2.5, Distortion=1
    )
    _smooth(_add("ring", _grid(64, 24, ring, closed=True), stripes, at=(0.1, -1.45, 0.52), turn=(62, 0, 15)))


def _crates() -> None:
    wood = mat.patterned(
        "wood", "Wave", [(0.16, 0.07, 0.02), (0.42, 0.22, 0.08), (0.55, 0.34, 0.14)],
        Scale=3, Distortion=6, Detail=3,
    )
    _add("crate", _cube, wood, at=(0.15, 1.45, PAVING + 0.28), turn=(0, 0, 12), size=0.56)
    _add("crate", _cube, wood, at=(-0.42, 1.6, PAVING + 0.17), turn=(0, 0, 50), size=0.34)
    _add("crate", _cube, wood, at=(0.18, 1.42, PAVING + 0.75), turn=(0, 0, 41), size=0.38)
    wall = mat.plain("wall", (0.08, 0.42, 0.42))  # the one surface without texture
    _add("wall", _cube, wall, at=(1.35, 1.3, PAVING + 0.5), turn=(0, 0, -44), size=(1.1, 0.09, 1.0))


def _bar(material, start, end, radius: float = 0.018) -> None:
    start, end = Vector(start), Vector(end)
    along = end - start
    bar = _add("bar", _cone(1, 1, 10), material)
    scale = Matrix.Diagonal((radius, radius, along.length, 1))
    turn = along.to_track_quat("Z", "Y").to_matrix().to_4x4()
    bar.matrix_world = Matrix.Translation((start + end) / 2) @ turn @ scale


def _railing() -> None:
    paint = mat.patterned("rust", "Noise", [(0.02, 0.02, 0.03), (0.30, 0.10, 0.04)], roughness=0.5, Scale=3)
    posts = [
        Vector((2.2 * math.cos(angle), 2.2 * math.sin(angle), PAVING))
        for angle in np.radians(np.linspace(140, 245, 16))
    ]
    for post in posts:
        _bar(paint, post, post + Vector((0, 0, 0.7)))
    for here, there in zip(posts, posts[1:], strict=False):
        for height in (0.15, 0.7):
            _bar(paint, here + Vector((0, 0, height)), there + Vector((0, 0, height)))


def _trellis() -> None:
    lath = mat.patterned("lath", "Noise", [(0.55, 0.50, 0.42), (0.85, 0.82, 0.75)], Scale=6)
    corner, across, up = Vector((0.55, -2.0, PAVING)), Vector((1.0, 0.45, 0)), Vector((0, 0, 1.1))
    for step in np.linspace(0, 1, 6):
        _bar(lath, corner + across * step, corner + across * step + up)
        _bar(lath, corner + up * step, corner + up * step + across)

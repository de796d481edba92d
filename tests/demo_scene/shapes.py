"""Meshes without operators: shapes that fill a bmesh, and objects made of them."""

import math
from itertools import pairwise

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector


def mould(name, shape, material) -> bpy.types.Object:
    """An object that is not part of the scene, to be copied by `again`; `shape` fills an empty bmesh."""
    solid = bmesh.new()
    shape(solid)
    mesh = bpy.data.meshes.new(name)
    solid.to_mesh(mesh)
    solid.free()
    if material is not None:
        mesh.materials.append(material)
    return bpy.data.objects.new(name, mesh)


def add(name, shape, material, at=(0, 0, 0), turn=(0, 0, 0), size=1.0) -> bpy.types.Object:
    """A new object of the scene; `turn` is in degrees, `size` scales."""
    return _set(mould(name, shape, material), at, turn, size)


def again(thing: bpy.types.Object, at, turn=(0, 0, 0), size=1.0) -> bpy.types.Object:
    """A new object of the scene with the mesh of another."""
    return _set(bpy.data.objects.new(thing.name, thing.data), at, turn, size)


def _set(thing: bpy.types.Object, at, turn, size) -> bpy.types.Object:
    bpy.context.collection.objects.link(thing)
    thing.location = at
    thing.rotation_euler = [math.radians(angle) for angle in turn]
    thing.scale = (size, size, size) if isinstance(size, float | int) else size
    return thing


def lift(height: float) -> Vector:
    """So far upwards, in metres."""
    return Vector((0, 0, height))


def moved(things: list[bpy.types.Object], at, turn: float = 0.0) -> None:
    """Turn things that were modelled around the origin by `turn` degrees around z, then move the origin to
    `at`."""
    to_place = Matrix.Translation(at) @ Matrix.Rotation(math.radians(turn), 4, "Z")
    for thing in things:
        thing.matrix_basis = to_place @ thing.matrix_basis


def lettering(text: str, material, at, turn=(0, 0, 0), height: float = 0.3) -> bpy.types.Object:
    """Raised letters of Blender's own font, centred at `at`; without a turn they lie on their back."""
    curve = bpy.data.curves.new(text, "FONT")
    curve.body, curve.size, curve.extrude = text, height, 0.06 * height
    curve.align_x, curve.align_y = "CENTER", "CENTER"
    sign = bpy.data.objects.new(text, curve)
    mesh = bpy.data.meshes.new_from_object(sign)
    bpy.data.objects.remove(sign)
    mesh.materials.clear()
    mesh.materials.append(material)
    return _set(bpy.data.objects.new(text, mesh), at, turn, 1.0)


def smooth(thing: bpy.types.Object) -> bpy.types.Object:
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


def cube(solid) -> None:
    """Side 1, its middle at the origin."""
    bmesh.ops.create_cube(solid, size=1)


def block(width: float, depth: float, height: float):
    """A box that stands on the origin. Unlike a scaled cube it has materials in metres."""

    def shape(solid) -> None:
        bmesh.ops.create_cube(
            solid,
            size=1,
            matrix=Matrix.Translation((0, 0, height / 2)) @ Matrix.Diagonal((width, depth, height, 1)),
        )

    return shape


def slab(length: float, height: float, thickness: float, holes: list[tuple[float, float, float, float]] = ()):
    """A wall on its back: x from -length / 2, y from 0 to its height, its face at z = 0. `holes` are (left,
    right, bottom, top), from left to right."""
    pieces, at = [], -length / 2
    for left, right, bottom, top in holes:
        pieces += [(at, left, 0, height), (left, right, 0, bottom), (left, right, top, height)]
        at = right
    pieces.append((at, length / 2, 0, height))

    def shape(solid) -> None:
        for left, right, bottom, top in pieces:
            middle = Matrix.Translation(((left + right) / 2, (bottom + top) / 2, thickness / 2))
            bmesh.ops.create_cube(
                solid, size=1, matrix=middle @ Matrix.Diagonal((right - left, top - bottom, thickness, 1))
            )

    return shape


def gable(width: float, depth: float, height: float):
    """A roof that stands on the origin; its ridge runs along x."""

    def shape(solid) -> None:
        x, y = width / 2, depth / 2
        ends = [
            [solid.verts.new(at) for at in ((side, -y, 0), (side, 0, height), (side, y, 0))]
            for side in (-x, x)
        ]
        for corners in (ends[0], ends[1][::-1]):
            solid.faces.new(corners)
        for a, b in ((0, 1), (1, 2), (2, 0)):
            solid.faces.new((ends[0][b], ends[0][a], ends[1][a], ends[1][b]))

    return shape


def sphere(solid) -> None:
    """Radius 1."""
    bmesh.ops.create_uvsphere(solid, u_segments=48, v_segments=24, radius=1)


def rock(solid) -> None:
    """A coarse ball of radius 1, all facets."""
    bmesh.ops.create_icosphere(solid, subdivisions=2, radius=1)


def cone(bottom: float, top: float, segments: int = 32):
    """A frustum of height 1 around the z axis, its middle at the origin."""

    def shape(solid) -> None:
        bmesh.ops.create_cone(solid, cap_ends=True, segments=segments, radius1=bottom, radius2=top, depth=1)

    return shape


def sheet(columns: int, rows: int, place, closed: bool):
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


def turned(profile, columns: int = 32, rows: int = 8):
    """A round surface around the z axis; `profile` takes v in 0..1 to a radius and a height."""

    def place(u: float, v: float) -> Vector:
        out, up = profile(v)
        return Vector((out * math.cos(2 * math.pi * u), out * math.sin(2 * math.pi * u), up))

    return sheet(columns, rows, place, closed=False)


def patch(columns: int, rows: int, place):
    """A sheet of quads with four borders; `place` takes u and v in 0..1 to a point."""

    def shape(solid) -> None:
        points = [
            [solid.verts.new(place(column / columns, row / rows)) for column in range(columns + 1)]
            for row in range(rows + 1)
        ]
        for below, above in pairwise(points):
            for k in range(columns):
                solid.faces.new((below[k], below[k + 1], above[k + 1], above[k]))

    return shape


def bar(material, start, end, radius: float = 0.018) -> bpy.types.Object:
    """A thin round bar from one point to another."""
    start, end = Vector(start), Vector(end)
    along = end - start
    rod = add("bar", cone(1, 1, 10), material)
    scale = Matrix.Diagonal((radius, radius, along.length, 1))
    turn = along.to_track_quat("Z", "Y").to_matrix().to_4x4()
    rod.matrix_world = Matrix.Translation((start + end) / 2) @ turn @ scale
    return rod

"""Meshes without operators: shapes that fill a bmesh, and objects made of them."""

import math

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector


def add(name, shape, material, at=(0, 0, 0), turn=(0, 0, 0), size=1.0) -> bpy.types.Object:
    """A new object; `shape` fills an empty bmesh, `turn` is in degrees, `size` scales."""
    solid = bmesh.new()
    shape(solid)
    mesh = bpy.data.meshes.new(name)
    solid.to_mesh(mesh)
    solid.free()
    if material is not None:
        mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(thing)
    thing.location = at
    thing.rotation_euler = [math.radians(angle) for angle in turn]
    thing.scale = (size, size, size) if isinstance(size, float | int) else size
    bpy.context.view_layer.update()
    return thing


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
        points = [[solid.verts.new(place(column / columns, row / rows)) for column in range(columns)] for row in range(height)]
        for row in range(rows):
            for column in range(columns):
                here, above = points[row], points[(row + 1) % height]
                right = (column + 1) % columns
                solid.faces.new((here[column], here[right], above[right], above[column]))

    return shape


def bar(material, start, end, radius: float = 0.018) -> None:
    """A thin round bar from one point to another."""
    start, end = Vector(start), Vector(end)
    along = end - start
    rod = add("bar", cone(1, 1, 10), material)
    scale = Matrix.Diagonal((radius, radius, along.length, 1))
    turn = along.to_track_quat("Z", "Y").to_matrix().to_4x4()
    rod.matrix_world = Matrix.Translation((start + end) / 2) @ turn @ scale

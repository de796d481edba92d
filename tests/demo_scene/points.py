"""Sparse points as structure from motion would leave them, but exact: rays shot at the surface.

A point keeps the colour of the pixel it was shot through and the list of views that see it.
"""

from dataclasses import dataclass
from itertools import pairwise

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from demo_scene.views import Intrinsics, Pose

MIN_TRACK = 2  # views; structure from motion cannot place a point seen by fewer


@dataclass(frozen=True)
class Cloud:
    """Points and their observations; observations are sorted by view."""

    xyz: np.ndarray  # (N, 3) float64, world, metres
    rgb: np.ndarray  # (N, 3) uint8, sRGB
    view: np.ndarray  # (M,) int, which view observes
    point: np.ndarray  # (M,) int, which point is observed
    xy: np.ndarray  # (M, 2) float64, where in the image, pixel centres at k + 0.5


def world_surface(scene: bpy.types.Scene) -> BVHTree:
    """Every visible surface, in world coordinates, as one tree for ray casts."""
    bpy.context.view_layer.update()
    vertices, polygons = [], []
    for thing in scene.objects:
        if thing.type != "MESH":
            continue
        mesh, first = thing.data, len(vertices)
        places = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.vertices.foreach_get("co", places.ravel())
        vertices += _moved(places, np.array(thing.matrix_world, np.float32)).tolist()
        corners, sizes = np.empty(len(mesh.loops), np.int32), np.empty(len(mesh.polygons), np.int32)
        mesh.loops.foreach_get("vertex_index", corners)
        mesh.polygons.foreach_get("loop_total", sizes)
        all_corners, ends = (corners + first).tolist(), sizes.cumsum().tolist()
        polygons += [all_corners[begin:end] for begin, end in pairwise([0, *ends])]
    return BVHTree.FromPolygons(vertices, polygons)


def _moved(places: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Places (N, 3) in another frame, (N, 3) float32, with the bits of mathutils: products in float32, sums
    in float64."""
    places = np.column_stack([places, np.ones(len(places), np.float32)])
    products = (places[:, None] * matrix[:3]).astype(np.float64)
    return (products[..., 0] + products[..., 1] + products[..., 2] + products[..., 3]).astype(np.float32)


def sample(surface: BVHTree, camera: Intrinsics, poses: list[Pose], images: np.ndarray, count: int) -> Cloud:
    """About `count` points from `images` (V, H, W, 3) uint8, an equal share from each view."""
    shares = np.diff(np.linspace(0, count, len(poses) + 1).round().astype(int))
    shot = [
        _shoot(surface, camera, pose, image, share, np.random.default_rng(seed))
        for seed, (pose, image, share) in enumerate(zip(poses, images, shares, strict=True))
    ]
    xyz = np.concatenate([points for points, _ in shot])
    rgb = np.concatenate([colours for _, colours in shot])
    seen = np.stack([_visible(surface, camera, pose, xyz) for pose in poses])  # (V, N)
    keep = seen.sum(axis=0) >= MIN_TRACK
    xyz, rgb, seen = xyz[keep], rgb[keep], seen[:, keep]
    view, point = np.nonzero(seen)
    xy = [camera.project(pose.world_to_camera, xyz[row])[0] for pose, row in zip(poses, seen, strict=True)]
    return Cloud(xyz, rgb, view, point, np.concatenate(xy))


def _shoot(
    surface: BVHTree, camera: Intrinsics, pose: Pose, image: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Surface points (n, 3) behind `count` random pixels of a view, and their colours (n, 3)."""
    pixels = rng.choice(camera.width * camera.height, count, replace=False)
    rows, cols = np.divmod(np.sort(pixels), camera.width)
    centres = np.stack([cols + 0.5, rows + 0.5, np.ones(count)], axis=1)
    rays = centres @ np.linalg.inv(camera.matrix).T @ pose.world_to_camera[:3, :3]
    hits = [surface.ray_cast(pose.centre, ray)[0] for ray in rays]
    found = np.array([hit is not None for hit in hits], dtype=bool)
    xyz = np.array([hit for hit in hits if hit is not None], dtype=np.float64).reshape(-1, 3)
    return xyz, image[rows[found], cols[found]]


def _visible(surface: BVHTree, camera: Intrinsics, pose: Pose, xyz: np.ndarray) -> np.ndarray:
    """Which points (N, 3) the view sees: inside the image and nothing in between. (N,) bool."""
    xy, depth = camera.project(pose.world_to_camera, xyz)
    seen = (depth > 0.05) & (xy > 0).all(axis=1) & (xy < (camera.width, camera.height)).all(axis=1)
    rays = xyz - pose.centre
    distance = np.linalg.norm(rays, axis=1)
    for index in np.flatnonzero(seen):
        # Shot up to just short of the point: its own surface must not hide it.
        reach = distance[index] * (1 - 1e-4) - 1e-4
        seen[index] = surface.ray_cast(pose.centre, rays[index], reach)[0] is None
    return seen

"""Generated scenes with statistics like those of trained scenes: a room with objects, made of flat Gaussians,
and views of it."""

from __future__ import annotations

import numpy as np

from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import SH_COEFFICIENTS, Scene
from svrgs_addon.scene.morton_order import morton_order

ROOM = np.array([4.0, 2.5, 4.0])  # half sides, metres
OBJECTS = 70  # number of ellipsoids
WALL_SHARE, FAINT_SHARE = 0.4, 0.35  # shares of the Gaussians
SIGMA = 0.75  # standard deviation of the log-scales
COVER = 0.7  # median radius of a Gaussian over the distance between neighbours on a surface
FLATNESS = 0.15  # scale of the third axis over that of the other two
FIELD_OF_VIEW = 50.0  # degrees, vertical


def room(count: int, sh_degree: int = 3, seed: int = 7) -> Scene:
    """A scene of `count` Gaussians on the walls of a room and on ellipsoids in it. A third of them is faint,
    the others are mostly opaque."""
    rng = np.random.default_rng(seed)
    walls = int(count * WALL_SHARE)
    points, normals, area = (
        np.concatenate(parts) for parts in zip(_walls(rng, walls), _objects(rng, count - walls), strict=True)
    )
    radius = COVER * np.sqrt(area)
    log_scales = np.log(radius)[:, None] + rng.normal(0, SIGMA, (count, 3))
    log_scales[:, 2] += np.log(FLATNESS)
    faint = rng.random(count) < FAINT_SHARE
    logits = np.where(faint, rng.normal(-3.0, 0.8, count), rng.normal(1.0, 1.6, count))
    sh = rng.normal(0, 0.06, (count, SH_COEFFICIENTS[sh_degree], 3))
    sh[:, 0] = 0.9 * np.sin(points @ rng.normal(0, 1.5, (3, 3))) + rng.normal(0, 0.3, (count, 3))
    points += normals * rng.normal(0, 0.01, (count, 1))
    arrays = (points, log_scales, _facing(normals, rng), logits, sh)
    return Scene.of(*arrays).select(morton_order(points))  # as training keeps them


def orbit_camera(width: int, height: int, turn: float = 0.0) -> Camera:
    """A camera near one corner of the room that faces its middle. turn: degrees around the vertical axis;
    width, height in pixels."""
    angle = np.radians(40 + turn)
    eye = 0.95 * ROOM * (np.cos(angle), -0.5, np.sin(angle))
    return look_at(eye, np.array([0, 0.8, 0]), width, height)


def facing_camera(scene: Scene, width: int, height: int) -> Camera:
    """A camera that faces the median of the means along +z. Its distance is twice the radius that holds 80 %
    of the means."""
    middle = np.median(scene.means, axis=0).astype(np.float64)
    reach = np.percentile(np.linalg.norm(scene.means - middle, axis=1), 80)
    return look_at(middle - (0, 0, max(2 * reach, 1e-3)), middle, width, height)


def look_at(eye: np.ndarray, target: np.ndarray, width: int, height: int) -> Camera:
    """A camera at `eye` that faces `target`, in COLMAP's convention (y down), with the principal point in the
    middle."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross((0.0, 1.0, 0.0), forward)
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = R, -R @ eye
    focal = height / (2 * np.tan(np.radians(FIELD_OF_VIEW) / 2))
    return Camera(
        viewmat, np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]), width, height
    )


def _walls(rng: np.random.Generator, count: int):
    """Points on the six walls (count, 3), outward normals (count, 3), surface area per point (count,)."""
    areas = np.array([ROOM[1] * ROOM[2], ROOM[0] * ROOM[2], ROOM[0] * ROOM[1]]) * 8
    axis = rng.choice(3, count, p=areas / areas.sum())
    side = rng.choice([-1.0, 1.0], count)
    points = rng.uniform(-1, 1, (count, 3)) * ROOM
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = side
    points[np.arange(count), axis] = side * ROOM[axis]
    return points, normals, np.full(count, areas.sum() / max(count, 1))


def _objects(rng: np.random.Generator, count: int):
    """Points on ellipsoids of 5 to 60 cm (count, 3), outward normals (count, 3), surface area per point
    (count,)."""
    radii = np.exp(rng.uniform(np.log(0.1), np.log(0.6), (OBJECTS, 1))) * rng.uniform(0.5, 1.5, (OBJECTS, 3))
    centres = rng.uniform(-0.85, 0.85, (OBJECTS, 3)) * ROOM * (1, 0.9, 1)
    areas = 4 * np.pi * ((radii**1.6 * np.roll(radii, 1, 1) ** 1.6).mean(1)) ** (1 / 1.6)  # Thomsen's formula
    which = rng.choice(OBJECTS, count, p=areas / areas.sum())
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    normals = directions / radii[which]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return centres[which] + directions * radii[which], normals, np.full(count, areas.sum() / max(count, 1))


def _facing(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Quaternions (n, 4), w x y z, that rotate the third axis to the normal, with a random rotation around
    it."""
    half = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))], 1)
    half[half[:, 0] < 1e-6] = (0, 1, 0, 0)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    spin = rng.uniform(0, np.pi, len(normals))
    c, s = np.cos(spin), np.sin(spin)
    w, x, y, z = half.T
    # half times (c, 0, 0, s)
    return np.stack([w * c - z * s, x * c + y * s, y * c - x * s, w * s + z * c], 1)

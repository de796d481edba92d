"""The criteria of selections: pure functions that return a mask (N,) bool. Values that are not numbers fulfil
no criterion."""

from __future__ import annotations

import numpy as np

from ...finetune.saliency import removal_errors
from ...finetune.scores import contribution
from ...finetune.viewed_scene import ViewedScene
from ...native.library import thresholds
from ...scene.camera import Camera
from ...scene.gaussians import SH_C0, Scene
from ...system.errors import SceneError
from .haze import hangs_before_cameras
from .islands import on_small_islands

Range = tuple[float, float]  # lowest and highest value, both inside


def in_box(means: np.ndarray, corners: tuple[float, ...], matrix: np.ndarray | None = None) -> np.ndarray:
    """Centres (N, 3) inside a box with two opposite corners (x0, y0, z0, x1, y1, z1), faces included.

    matrix: (4, 4) affine, from the coordinates of the centres to those of the corners; None: they are the
    same.
    """
    low, high = np.minimum(corners[:3], corners[3:]), np.maximum(corners[:3], corners[3:])
    points = _moved(means, matrix)
    return ((points >= low) & (points <= high)).all(axis=1)


def in_sphere(means: np.ndarray, sphere: tuple[float, ...], matrix: np.ndarray | None = None) -> np.ndarray:
    """Centres (N, 3) in a sphere (x, y, z, radius), surface included. matrix: as for in_box; it may stretch
    the sphere."""
    with np.errstate(invalid="ignore", over="ignore"):
        return ((_moved(means, matrix) - sphere[:3]) ** 2).sum(axis=1) <= sphere[3] ** 2


def between(values: np.ndarray, limits: Range) -> np.ndarray:
    """Values (N,) of at least limits[0] and at most limits[1]."""
    return (values >= limits[0]) & (values <= limits[1])


def lowest(values: np.ndarray, share: float) -> np.ndarray:
    """The share (0..1) of the Gaussians with the lowest values (N,), rounded to a whole number; of equal
    values the earlier rows."""
    mask = np.zeros(len(values), bool)
    mask[np.argsort(values, kind="stable")[: round(share * len(values))]] = True
    return mask


def opacities(scene: Scene) -> np.ndarray:
    """(N,) float64 in 0..1."""
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-scene.opacity_logits.astype(np.float64)))


def base_colours(scene: Scene) -> np.ndarray:
    """(N, 3) float64 display sRGB: of SH degree 0."""
    return 0.5 + SH_C0 * scene.sh[:, 0].astype(np.float64)


def sizes(scene: Scene) -> np.ndarray:
    """The largest standard deviation of each Gaussian, (N,) float64, in units of the scene."""
    with np.errstate(over="ignore"):
        return np.exp(scene.log_scales.max(axis=1).astype(np.float64))


def contributions(scene: Scene, cameras: list[Camera]) -> np.ndarray:
    """Sum of αT over all pixels of all views, (N,) float64. Raises SceneError without views."""
    return contribution(_viewed(scene, cameras))[0]


def errors(scene: Scene, cameras: list[Camera]) -> np.ndarray:
    """Removal error (finetune/saliency.py), (N,) float64: squared error of colours, summed over views. Raises
    SceneError without views."""
    return removal_errors(_viewed(scene, cameras))


def seen(scene: Scene, cameras: list[Camera]) -> np.ndarray:
    """Gaussians that reach αT = 1/255 in a pixel of at least one view, (N,) bool. Raises SceneError without
    views."""
    return contribution(_viewed(scene, cameras))[1] >= np.float32(thresholds().alpha_cut)


def floaters(scene: Scene, cameras: list[Camera]) -> np.ndarray:
    """Gaussians on small islands (islands.py) and, with enough views, haze (haze.py), (N,) bool."""
    return on_small_islands(scene) | hangs_before_cameras(scene, cameras)


def _moved(means: np.ndarray, matrix: np.ndarray | None) -> np.ndarray:
    """Points (N, 3) float64 after an affine map."""
    points = means.astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        return points if matrix is None else points @ matrix[:3, :3].T + matrix[:3, 3]


def _viewed(scene: Scene, cameras: list[Camera]) -> ViewedScene:
    if not cameras:
        raise SceneError("there are no views to measure Gaussians in")
    return ViewedScene.of(scene, cameras)

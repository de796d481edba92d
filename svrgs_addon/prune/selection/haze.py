"""Haze: Gaussians that hang in the air before the cameras.

Training puts them there where they make a few photographs brighter or darker. The photographs look through
them at what is behind. So haze is near a camera, and in front of what the views show at its place, not on the
surface that they show there. Something that is really there is on a surface in the views that look at it,
however thin it is.
"""

from __future__ import annotations

import numpy as np

from ...native.rasterizer import Rasterizer
from ...render.metrics.evaluate import picture_options
from ...scene.camera import Camera
from ...scene.gaussians import Scene

# distance to the nearest camera, as a share of the median depth of its picture, below which a Gaussian can be
# haze
NEAR = 0.5
IN_FRONT = 0.7  # of the depth of a pixel: a Gaussian is in front of its surface up to here
ON_SURFACE = 0.15  # relative difference of depths up to which it is on the surface
RARELY = 0.1  # times as often as in front of a surface: as often haze may be on one
SOLID = 0.5  # alpha of a pixel from which it shows a surface; below, the haze itself is all that it shows
LONGER_SIDE = 640  # pixels, about: views are reduced to this size
MOST_VIEWS = 64  # that are looked at, evenly spaced in the list
LEAST_VIEWS = 8  # with fewer views, nothing is known about a Gaussian near one of them


def hangs_before_cameras(scene: Scene, cameras: list[Camera]) -> np.ndarray:
    """(N,) bool: haze, as the top of this file describes it; none with fewer views than LEAST_VIEWS. scene:
    finite values."""
    rasterizer, options = Rasterizer(), picture_options(scene)
    near, in_front, on_surface = (np.zeros(scene.count, np.int64) for _ in range(3))  # numbers of views
    for view in cameras[:: -(-len(cameras) // MOST_VIEWS)] if len(cameras) >= LEAST_VIEWS else ():
        camera = view.reduced(max(1, max(view.width, view.height) // LONGER_SIDE))
        images = rasterizer.forward(scene, camera, options, outputs=("depth", "alpha"))
        alpha = images["alpha"]
        depth = images["depth"] / np.maximum(alpha, 1e-6)
        if not (alpha >= SOLID).any():
            continue
        rows, z, column, line = _projected(scene, camera)
        shown = z / depth[line, column]
        solid = alpha[line, column] >= SOLID
        near[rows] += z < NEAR * np.median(depth[alpha >= SOLID])
        in_front[rows] += solid & (shown < IN_FRONT)
        on_surface[rows] += solid & (np.abs(shown - 1) < ON_SURFACE)
    return (near > 0) & (in_front > 0) & (on_surface <= RARELY * in_front)


def _projected(scene: Scene, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the Gaussians whose centres are in the picture, their depths, and the columns and lines of
    their pixels, (n,) each."""
    matrix = camera.viewmat.astype(np.float32)
    local = scene.means @ matrix[:3, :3].T + matrix[:3, 3]
    with np.errstate(invalid="ignore", over="ignore"):
        x, y = np.nan_to_num(camera.pixels(local), nan=-1).T
    rows = np.flatnonzero((local[:, 2] > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height))
    return rows, local[rows, 2], x[rows].astype(np.int64), y[rows].astype(np.int64)

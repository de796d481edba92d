"""Frames per second of a large scene under an orbiting camera."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from svrgs_addon.native import library
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.composite import composite
from svrgs_addon.render.live_view import COARSE
from svrgs_addon.render.passes import linear_rgba
from svrgs_addon.render.thinning import Thinning
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.scene.morton_order import morton_order

from .preview import Preview
from .scenes import orbit_camera, room
from .timing import WARMUPS, seconds

COUNT, SIZE = 1_000_000, (640, 360)
VIEWPORT_COUNT, VIEWPORT_SIZE = 3_000_000, (1280, 720)
FRAMES, STEP = 30, 1.0  # number of frames; degrees per frame
EXACT = 6  # exact pictures of a viewport


def measure_interactive(
    progress: Callable[[str], None], count: int = COUNT, size: tuple[int, int] = SIZE, frames: int = FRAMES
) -> dict:
    """The entry `interactive` of the result: milliseconds of the median and of the slowest frame, frames per
    second, and `rest_ms`, the milliseconds of a frame whose camera has not moved."""
    progress(f"orbiting around {count:,} Gaussians")
    preview = Preview(room(count))
    cameras = [orbit_camera(*size, turn=STEP * k) for k in range(WARMUPS + frames)]
    facts = _frames(preview.image, cameras, count, size)
    return facts | {"rest_ms": 1e3 * seconds(preview.image, cameras[-1])}


def measure_viewport(
    progress: Callable[[str], None],
    count: int = VIEWPORT_COUNT,
    size: tuple[int, int] = VIEWPORT_SIZE,
    frames: int = FRAMES,
    reduction: int = COARSE,
) -> dict:
    """The entry `viewport` of the result: the same of coarse pictures, as the viewport of Blender draws them
    while the camera moves (render/live_view.py), and `exact_ms`, the milliseconds of the exact picture where
    it stops."""
    progress(f"orbiting around {count:,} Gaussians in a viewport")
    scene, rasterizer = (one := room(count)).select(morton_order(one.means)), Rasterizer()
    thinning = Thinning(scene)

    def coarse(camera: Camera):
        drawn = thinning.draws()
        picture(drawn, camera)
        thinning.drew(drawn, rasterizer)
        thinning.wait()

    def picture(drawn: Scene, camera: Camera) -> np.ndarray:
        return linear_rgba(composite(rasterizer, drawn, camera, passes=()), transparent=False)

    cameras = [orbit_camera(*size, turn=STEP * k) for k in range(WARMUPS + frames)]
    facts = _frames(coarse, [camera.reduced(reduction) for camera in cameras], count, size)
    exact = [1e3 * seconds(picture, scene, camera) for camera in cameras[:: max(1, frames // EXACT)]][1:]
    return facts | {"reduction": reduction, "exact_ms": float(np.median(exact))}


def _frames(
    draw: Callable[[Camera], object], cameras: list[Camera], count: int, size: tuple[int, int]
) -> dict:
    """Milliseconds of the median and of the slowest frame; the first ones do not count."""
    ms = [1e3 * seconds(draw, camera) for camera in cameras][WARMUPS:]
    median = float(np.median(ms))
    facts = {"count": count, "width": size[0], "height": size[1], "threads": library.threads()}
    return facts | {"frame_ms": median, "slowest_ms": max(ms), "frames_per_second": 1e3 / median}

"""One complete picture of Gaussians: colours, depth, alpha, spatial mask and hits, with what opaque surfaces hide left out."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..camera import Camera
from ..errors import Cancelled
from ..native import Rasterizer, RenderOptions
from ..scene import Scene
from .mesh_depth import Surface

FAR = 1e10  # depth where there is nothing, as Blender's own engines have it
POLL = 0.05  # seconds between two questions whether to stop
OUTPUTS = ("rgb", "depth", "alpha", "mask", "hits")


@dataclass(frozen=True)
class Drawing:
    """What a camera sees; all arrays (H, W) float32 but rgb (H, W, 3)."""

    rgb: np.ndarray  # display sRGB, blended over background and surface, not clamped
    alpha: np.ndarray  # of the Gaussians alone
    covered: np.ndarray  # alpha of Gaussians and surface
    depth: np.ndarray  # mean along the camera's z axis of what is seen; FAR where nothing is
    mask: np.ndarray  # F of the Gaussians before the surface (paper Eq. 5), all masks 1
    hits: np.ndarray  # N: how many these are


def draw(rasterizer: Rasterizer, scene: Scene, camera: Camera, background=(0.0, 0.0, 0.0), surface: Surface | None = None) -> Drawing:
    """Gaussians are hidden at every pixel where the surface lies before their centre. Raises Cancelled once rasterizer.cancel[0] is set."""
    options = RenderOptions(antialiased=scene.antialiased, mask_kind="svr", background=tuple(background))
    if surface is None or not (solid := np.isfinite(surface.depth)).any():
        images = rasterizer.forward(scene, camera, options, outputs=OUTPUTS)
        return _drawing(images, images["alpha"])
    limit = np.ascontiguousarray(surface.depth, rasterizer.dtype)
    images = rasterizer.forward(scene, camera, replace(options, background=(0.0, 0.0, 0.0)), outputs=OUTPUTS, depth_limit=limit)
    T = 1 - images["alpha"]
    images["rgb"] += T[..., None] * np.where(solid[..., None], surface.rgb, np.asarray(background, np.float32))
    images["depth"] += T * np.where(solid, surface.depth, np.float32(0))
    return _drawing(images, np.where(solid, np.float32(1), images["alpha"]))


def draw_while(wanted: Callable[[], bool], rasterizer: Rasterizer, *arguments) -> Drawing | None:
    """draw(rasterizer, *arguments) in a thread, while this one asks now and then whether it is still wanted; None if not."""
    result: list = []

    def work():
        try:
            result.append(draw(rasterizer, *arguments))
        except BaseException as error:  # noqa: BLE001 - raised again in the thread that waits
            result.append(error)

    rasterizer.cancel[0] = 0
    thread = threading.Thread(target=work, name="svrgs-draw")
    thread.start()
    while thread.is_alive():
        thread.join(POLL)
        if not wanted():
            rasterizer.cancel[0] = 1
    if isinstance(result[0], Cancelled):
        return None
    if isinstance(result[0], BaseException):
        raise result[0]
    return result[0]


def _drawing(images: dict, covered: np.ndarray) -> Drawing:
    depth = np.divide(images["depth"], covered, out=np.full_like(covered, FAR), where=covered > 0)
    return Drawing(images["rgb"], images["alpha"], covered, depth, images["mask"], images["hits"].astype(np.float32))

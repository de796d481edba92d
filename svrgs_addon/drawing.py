"""One complete picture of Gaussians: colours, depth, alpha, spatial mask and hits, with what opaque surfaces hide left out."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .camera import Camera
from .errors import Cancelled
from .native import Rasterizer, RenderOptions
from .scene import Scene
from .surfaces import Surface

LAYERS = 24  # of Gaussians between the nearest and the farthest point of a surface
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
    """Gaussians whose centre lies behind the surface are hidden where it is; exact to the thickness of a layer (LAYERS).

    Raises Cancelled once rasterizer.cancel[0] is set.
    """
    options = RenderOptions(antialiased=scene.antialiased, mask_kind="svr", background=tuple(background))
    if surface is None or not np.isfinite(surface.depth).any():
        return _unhidden(rasterizer.forward(scene, camera, options, outputs=OUTPUTS))
    return _hidden(rasterizer, scene, camera, options, surface)


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


def _unhidden(images: dict) -> Drawing:
    alpha = images["alpha"]
    depth = np.divide(images["depth"], alpha, out=np.full_like(alpha, FAR), where=alpha > 0)
    return Drawing(images["rgb"], alpha, alpha, depth, images["mask"], images["hits"].astype(np.float32))


def _hidden(rasterizer: Rasterizer, scene: Scene, camera: Camera, options: RenderOptions, surface: Surface) -> Drawing:
    shape, solid = surface.depth.shape, np.isfinite(surface.depth)
    rgb, depth, hits = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    T, full_T = np.ones(shape, np.float32), np.ones(shape, np.float32)
    for rows, middle in _layers(scene, camera, surface.depth[solid]):
        part = scene.select(rows)
        images = rasterizer.forward(part, camera, replace(options, background=(0, 0, 0)), outputs=("rgb", "depth", "alpha", "hits", "transmittance"))
        seen = surface.depth > middle
        through = T * seen
        rgb += through[..., None] * images["rgb"]
        depth += through * images["depth"]
        hits += seen * images["hits"]
        T *= np.where(seen, 1 - images["alpha"], 1)
        full_T *= np.where(seen, images["transmittance"], 1)
    rgb += T[..., None] * np.where(solid[..., None], surface.rgb, np.asarray(options.background, np.float32))
    alpha, covered = 1 - T, np.where(solid, np.float32(1), 1 - T)
    depth += np.where(solid, T * np.where(solid, surface.depth, 0), 0)
    depth = np.divide(depth, covered, out=np.full_like(depth, FAR), where=covered > 0)
    mask = np.divide(hits - 1 + full_T, np.log1p(hits), out=np.zeros_like(hits), where=hits > 0)
    return Drawing(rgb, alpha, covered, depth, mask, hits)


def _layers(scene: Scene, camera: Camera, depths: np.ndarray):
    """Yields (rows of the scene, middle depth) of its layers, nearest first: one before all of the surface, LAYERS along it, one behind."""
    z = scene.means.astype(np.float64) @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    low, high = float(depths.min()), float(depths.max())
    between = z[(z > low) & (z < high)]
    inner = np.quantile(between, np.linspace(0, 1, LAYERS + 1)) if len(between) else []
    edges = np.unique(np.r_[-np.inf, low, inner, high, np.inf])
    for near, far in zip(edges[:-1], edges[1:], strict=True):
        rows = np.flatnonzero((z > near) & (z <= far))
        if len(rows):
            yield rows, (near if np.inf in (-near, far) else (near + far) / 2)

"""One complete picture of Gaussians and meshes: colours, and every output that is a render pass.

A mesh is a depth per pixel (mesh_depth.py). A pixel takes the Gaussians whose centre lies before it; behind them it shows the colour of
the mesh, lit from the camera, without shadows.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..camera import Camera
from ..errors import Cancelled
from ..native import Rasterizer, RenderOptions
from ..outputs import OUTPUTS
from ..scene import Scene
from .mesh_depth import Surface

FAR = 1e10  # depth where there is nothing, as Blender's own engines have it
POLL = 0.05  # seconds between two questions whether to stop
PASS_OUTPUTS = tuple(output.name for output in OUTPUTS.values() if output.render_pass)


@dataclass(frozen=True)
class Composite:
    """What a camera sees."""

    rgb: np.ndarray  # (H, W, 3) float32 display sRGB, blended over background and meshes, not clamped
    covered: np.ndarray  # (H, W) float32: alpha of Gaussians and meshes
    images: dict[str, np.ndarray]  # (H, W) float32 of each output with a render pass, by name

    @property
    def depth(self) -> np.ndarray:
        """(H, W): mean along the camera's z axis of all that is seen, meshes too; FAR where nothing is."""
        return self.images["depth"]

    @property
    def alpha(self) -> np.ndarray:
        """(H, W): of the Gaussians alone."""
        return self.images["alpha"]


def composite(rasterizer: Rasterizer, scene: Scene, camera: Camera, background=(0.0, 0.0, 0.0), surface: Surface | None = None) -> Composite:
    """Gaussians are hidden at every pixel where the surface lies before their centre. Raises Cancelled once rasterizer.cancel[0] is set."""
    options = RenderOptions(antialiased=scene.antialiased, mask_kind="svr", background=tuple(background))
    if surface is None or not (solid := np.isfinite(surface.depth)).any():
        images = rasterizer.forward(scene, camera, options, outputs=("rgb", *PASS_OUTPUTS))
        return _composite(images, images["alpha"])
    limit = np.ascontiguousarray(surface.depth, rasterizer.dtype)
    images = rasterizer.forward(scene, camera, replace(options, background=(0.0, 0.0, 0.0)), outputs=("rgb", *PASS_OUTPUTS), depth_limit=limit)
    T = 1 - images["alpha"]
    images["rgb"] += T[..., None] * np.where(solid[..., None], surface.rgb, np.asarray(background, np.float32))
    images["depth"] += T * np.where(solid, surface.depth, np.float32(0))
    return _composite(images, np.where(solid, np.float32(1), images["alpha"]))


def composite_while(wanted: Callable[[], bool], rasterizer: Rasterizer, *arguments) -> Composite | None:
    """draw(rasterizer, *arguments) in a thread, while this one asks now and then whether it is still wanted; None if not."""
    result: list = []

    def work():
        try:
            result.append(composite(rasterizer, *arguments))
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


def _composite(images: dict, covered: np.ndarray) -> Composite:
    depth = np.divide(images["depth"], covered, out=np.full_like(covered, FAR), where=covered > 0)
    passes = {name: images[name].astype(np.float32, copy=False) for name in PASS_OUTPUTS}
    return Composite(images["rgb"], covered, passes | {"depth": depth})

"""A complete picture of Gaussians and meshes: colours, and every output that is a render pass.

A mesh is given as a depth per pixel (mesh_depth.py, or the depth buffer of a viewport). The rasterizer takes it as depth limit: a
pixel blends only Gaussians whose centre is in front of the mesh. Behind these Gaussians, the pixel shows the base colour of the
mesh, lit from the camera. There are no shadows, and mesh and Gaussians do not light each other.
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

FAR = 1e10  # depth of empty pixels, as in Blender's own engines
POLL_SECONDS = 0.05  # between two calls of wanted()
PASS_OUTPUTS = tuple(output.name for output in OUTPUTS.values() if output.render_pass)


@dataclass(frozen=True)
class Composite:
    """The picture of one camera."""

    rgb: np.ndarray  # (H, W, 3) float32 display sRGB, over background and meshes, not clamped
    coverage: np.ndarray  # (H, W) float32, alpha of Gaussians and meshes together
    images: dict[str, np.ndarray]  # {name: (H, W) float32} of the outputs that are render passes

    @property
    def depth(self) -> np.ndarray:
        """(H, W) float32: mean camera z of Gaussians and meshes, weighted by their contribution to the pixel; FAR where the pixel is empty."""
        return self.images["depth"]

    @property
    def alpha(self) -> np.ndarray:
        """(H, W) float32: alpha of the Gaussians alone."""
        return self.images["alpha"]


def composite(rasterizer: Rasterizer, scene: Scene, camera: Camera, background=(0.0, 0.0, 0.0), surface: Surface | None = None) -> Composite:
    """Renders Gaussians over meshes and a background.

    background: display sRGB. surface: meshes as the camera sees them; None: there are none. Scene and camera have the same world.
    Raises Cancelled when rasterizer.cancel[0] is set.
    """
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
    """Calls composite(rasterizer, *arguments) in another thread. Returns its result, or None if wanted() became false.

    The calling thread calls wanted() every POLL_SECONDS. Errors of composite() are raised again.
    """
    result: list = []

    def work():
        try:
            result.append(composite(rasterizer, *arguments))
        except BaseException as error:  # noqa: BLE001 - raised again in the waiting thread
            result.append(error)

    rasterizer.cancel[0] = 0
    thread = threading.Thread(target=work, name="svrgs-draw")
    thread.start()
    while thread.is_alive():
        thread.join(POLL_SECONDS)
        if not wanted():
            rasterizer.cancel[0] = 1
    if isinstance(result[0], Cancelled):
        return None
    if isinstance(result[0], BaseException):
        raise result[0]
    return result[0]


def _composite(images: dict, coverage: np.ndarray) -> Composite:
    """Makes a Composite of the outputs of the rasterizer; divides the summed depth by the coverage."""
    depth = np.divide(images["depth"], coverage, out=np.full_like(coverage, FAR), where=coverage > 0)
    passes = {name: images[name].astype(np.float32, copy=False) for name in PASS_OUTPUTS}
    return Composite(images["rgb"], coverage, passes | {"depth": depth})

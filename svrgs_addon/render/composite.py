"""A complete picture of Gaussians and meshes: colours, and every output that is a render pass.

A mesh is given as a depth per pixel (meshes.py, or the depth buffer of a viewport). The rasterizer takes it
as depth limit: a pixel blends only Gaussians whose centre is in front of the mesh. Behind these Gaussians,
the pixel shows the mesh. There are no shadows, and mesh and Gaussians do not light each other. A pixel at the
edge of a mesh is the mean of two pictures: with the mesh, and without it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, replace

import numpy as np

from ..native.outputs import OUTPUTS
from ..native.rasterizer import Rasterizer, RenderOptions
from ..scene.camera import Camera
from ..scene.gaussians import Scene
from ..system.errors import Cancelled
from .meshes import Surface

FAR = 1e10  # depth of empty pixels, as in Blender's own engines
ON_CATCHER = 0.03  # share of the distance of a shadow catcher
POLL_SECONDS = 0.05  # between two calls of wanted()
PASS_OUTPUTS = tuple(output.name for output in OUTPUTS.values() if output.render_pass)


@dataclass(frozen=True)
class Composite:
    """The picture of one camera."""

    rgb: np.ndarray  # (H, W, 3) float32 display sRGB, over background and meshes, not clamped; black in holes
    coverage: np.ndarray  # (H, W) float32, alpha of Gaussians and meshes together
    holes: np.ndarray  # (H, W) float32, share of each pixel that shows a holdout
    # {name: (H, W) float32} of the outputs that are render passes, or of those that were asked for
    images: dict[str, np.ndarray]
    # (H, W, 4) float32, display sRGB times alpha: Gaussians behind the surfaces; only of split()
    behind: np.ndarray | None = None

    @property
    def depth(self) -> np.ndarray:
        """(H, W) float32: mean camera z, weighted by contribution to the pixel; FAR where it is empty."""
        return self.images["depth"]

    @property
    def solid_depth(self) -> np.ndarray:
        """(H, W) float32: the same, but FAR where less than a half of the pixel is covered."""
        return np.where(self.coverage > 0.5, self.depth, np.float32(FAR))

    @property
    def alpha(self) -> np.ndarray:
        """(H, W) float32: alpha of the Gaussians alone."""
        return self.images["alpha"]


def composite(
    rasterizer: Rasterizer,
    scene: Scene,
    camera: Camera,
    background=(0.0, 0.0, 0.0),
    surface: Surface | None = None,
    passes: Sequence[str] = PASS_OUTPUTS,
) -> Composite:
    """Renders Gaussians over meshes and a background.

    background: display sRGB. surface: meshes as the camera sees them; None: there are none. Scene and camera
    have the same world. passes: of PASS_OUTPUTS; others are not rendered, but for alpha. Raises Cancelled
    when rasterizer.cancel[0] is set.
    """
    options = RenderOptions(
        antialiased=scene.antialiased,
        mask_kind="svr" if "mask" in passes else "none",
        background=tuple(background),
        picture_only=True,
    )
    outputs = ("rgb", *(name for name in PASS_OUTPUTS if name in passes or name == "alpha"))
    if surface is None:
        images = rasterizer.forward(scene, camera, options, outputs=outputs)
        return _composite(images | {"coverage": images["alpha"], "holes": np.zeros_like(images["alpha"])})
    images = _over(rasterizer, scene, camera, options, outputs, surface, surface.depth)
    if surface.rest is not None:
        assert surface.share is not None
        edges, rest = surface.share < 1, surface.rest
        limit = np.where(edges, rest.depth, np.float32(0))
        behind = _over(rasterizer, scene, camera, options, outputs, rest, limit)
        share = surface.share[edges]
        for name, image in images.items():
            part = share if image.ndim == 2 else share[:, None]
            image[edges] = part * image[edges] + (1 - part) * behind[name][edges]
    return _composite(images)


def split(
    rasterizer: Rasterizer,
    scene: Scene,
    camera: Camera,
    background=None,
    surface: Surface | None = None,
    catcher: Surface | None = None,
) -> Composite:
    """Renders the Gaussians in front of surfaces, with alpha, and those behind them as Composite.behind.

    Another picture of the surfaces, with alpha, belongs between the two: front over surfaces over behind. So
    front ends at the nearest surface of a pixel, even if that has only a part of it: its alpha is in the
    other picture. Where there is no surface, all Gaussians are in front. Behind holdouts there is nothing.
    background: display sRGB, a part of behind; None: it is transparent. catcher: shadow catchers; Gaussians
    that are less than ON_CATCHER in front of them count as behind, because those of the ground on which a
    shadow falls are on both sides of the catcher. Raises Cancelled.
    """
    whole = composite(rasterizer, scene, camera)
    limit = np.full_like(whole.coverage, np.inf) if surface is None else surface.depth
    if catcher is not None:
        limit = np.minimum(limit, catcher.depth * np.float32(1 - ON_CATCHER))
    front = composite(rasterizer, scene, camera, surface=Surface.black(limit))
    T = 1 - front.alpha[..., None]  # sums of the whole picture: front + T * behind
    sums = np.concatenate([whole.rgb - front.rgb, (whole.alpha - front.alpha)[..., None]], axis=2)
    behind = np.divide(sums, T, out=np.zeros_like(sums), where=T > 0).clip(
        0, np.array((np.inf, np.inf, np.inf, 1), sums.dtype)
    )
    if background is not None:
        behind += (1 - behind[..., 3:]) * np.array((*background, 1), sums.dtype)
    if surface is not None:
        behind *= 1 - surface.holes[..., None]
    return replace(front, holes=np.zeros_like(front.holes), behind=behind)


def _over(
    rasterizer: Rasterizer,
    scene: Scene,
    camera: Camera,
    options: RenderOptions,
    outputs: Sequence[str],
    surface: Surface,
    limit: np.ndarray,
) -> dict[str, np.ndarray]:
    """The sums of a pixel: Gaussians with z < limit (H, W) over the surface over the background."""
    limit = np.ascontiguousarray(limit, rasterizer.dtype)
    images = rasterizer.forward(
        scene, camera, replace(options, background=(0.0, 0.0, 0.0)), outputs=outputs, depth_limit=limit
    )
    images = {name: image.astype(rasterizer.dtype, copy=False) for name, image in images.items()}
    T, solid, shown = 1 - images["alpha"], np.isfinite(surface.depth), surface.rgba[..., 3]
    behind = np.where(solid[..., None], surface.rgba[..., :3], np.asarray(options.background, np.float32))
    images["rgb"] += T[..., None] * behind
    if "depth" in images:
        images["depth"] += T * shown * np.where(solid, surface.depth, np.float32(0))
    images["coverage"] = images["alpha"] + T * shown
    images["holes"] = T * (solid - shown)
    return images


def composite_while(
    wanted: Callable[[], bool], rasterizer: Rasterizer, draw: Callable[..., Composite], *arguments
) -> Composite | None:
    """Calls draw(rasterizer, *arguments) in another thread. Returns its result, or None if wanted() became
    false.

    The calling thread calls wanted() every POLL_SECONDS. Errors of draw() are raised again. draw must raise
    Cancelled when rasterizer.cancel[0] is set, as composite() does.
    """
    rasterizer.cancel[0] = 0
    with ThreadPoolExecutor(1, "svrgs-draw") as pool:
        drawn = pool.submit(draw, rasterizer, *arguments)
        while not wait([drawn], POLL_SECONDS).done:
            if not wanted():
                rasterizer.cancel[0] = 1
    try:
        return drawn.result()
    except Cancelled:
        return None


def _composite(sums: dict) -> Composite:
    """Makes a Composite of the sums of each pixel; divides the summed depth by the coverage."""
    coverage = sums["coverage"]
    passes = {name: sums[name].astype(np.float32, copy=False) for name in PASS_OUTPUTS if name in sums}
    if "depth" in sums:
        passes["depth"] = np.divide(
            sums["depth"], coverage, out=np.full_like(coverage, FAR), where=coverage > 0
        )
    return Composite(sums["rgb"], coverage, sums["holes"], passes)

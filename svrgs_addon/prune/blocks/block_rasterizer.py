"""Scenes to render, whether memory holds them or not: as a whole, or divided on the disk for as long as they
are needed."""

from __future__ import annotations

import contextlib
import logging
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...files.registry import load_scene
from ...native.rasterizer import Rasterizer, RenderOptions
from ...render.metrics.evaluate import Renderable, Renderer
from ...scene.camera import Camera
from ...scene.gaussians import Scene
from ...system import memory
from ...system.errors import MemoryShort, TooMany
from ...system.processes import interrupting
from .divided import Divided, divide
from .visible import DividedView


class BlockRasterizer:
    """Renders a divided scene as Rasterizer renders one in memory."""

    def __init__(self):
        self._rasterizer = Rasterizer()

    def forward(
        self, divided: Divided, camera: Camera, options: RenderOptions = RenderOptions(), outputs=("rgb",)
    ) -> dict[str, np.ndarray]:
        """As Rasterizer.forward(), of the outputs rgb, depth, alpha and, with the mask_kind svr, mask. Raises
        SplatError, also if memory cannot hold what the view blends."""
        view = DividedView(divided, camera, self._rasterizer)
        mask = {"mask": view.spatial_mask()} if "mask" in outputs else {}
        colours = [name for name in outputs if name != "mask"]
        if not colours:
            return mask
        scene, _ = view.seen()
        plain = replace(options, mask_kind="none")
        return self._rasterizer.forward(scene, camera, plain, outputs=colours) | mask


@contextlib.contextmanager
def opened(path: Path, doing: str, needed: Callable[[int], int]) -> Iterator[tuple[Renderable, Renderer]]:
    """A scene and what renders it. Where memory is too short for all of it, or the file holds too many
    Gaussians, it is divided in the folder for temporary files, and the log says so.

    doing: a word for messages, such as 'rendering'. needed: gives the bytes of memory that this takes for N
    Gaussians which are in memory already. Raises SplatError.
    """
    try:
        scene = _whole(path, doing, needed)
    except (MemoryShort, TooMany) as error:
        if memory.shortage("", needed(0)):  # the pictures alone are too large
            raise
        reason = memory.without_advice(str(error))
    else:
        yield scene, Rasterizer()
        return
    logging.warning(
        "%s; it is done by blocks in %s (TMPDIR), which takes longer", reason, tempfile.gettempdir()
    )
    with (
        interrupting(),
        tempfile.TemporaryDirectory(prefix="svrgs-blocks-", ignore_cleanup_errors=True) as folder,
    ):
        yield divide(path, Path(folder)), BlockRasterizer()


def _whole(path: Path, doing: str, needed: Callable[[int], int]) -> Scene:
    scene = load_scene(path)
    memory.refuse_excess(f"{path}: {doing} it", needed(scene.count))
    return scene

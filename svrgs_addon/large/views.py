"""What a view shows of a divided scene: it reads the blocks that it may show, and of those the Gaussians that it may show."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from .. import memory
from ..camera import Camera
from ..metrics.evaluate import render_options
from ..native import Rasterizer, threads
from ..render.quads import colors, recolored
from ..scene import Scene
from .blocks import WIDTH, Block, Divided, arrays_of
from .discs import PART, may_show, places_in

ROW = 3 * 4 * 14  # bytes of a Gaussian in one colour: its values, and copies while they are put in order


@dataclass(frozen=True)
class Shown:
    """The Gaussians that a view may show."""

    blocks: list[Block]  # that have some
    places: list[np.ndarray]  # of each block, the places of the Gaussians in it, ascending
    blended: list[np.ndarray]  # of each block, which of these the view blends into a pixel, bool
    rows: np.ndarray  # (n,) rows in the file, ascending
    order: np.ndarray  # (n,) of all, block after block, those in the order of the file
    scene: Scene  # in the order of the file, without colours (SH degree 0)


def shown(divided: Divided, camera: Camera, rasterizer: Rasterizer) -> Shown:
    """What a view may show. Those that it does not blend are behind others or too small. Raises SplatError."""
    near = [block for block in divided.blocks if may_show(block, camera)]
    with ThreadPoolExecutor(threads()) as pool:
        places = list(pool.map(lambda block: places_in(block, camera), near))
        count = sum(map(len, places))
        needed = memory.rendering(count, camera.width, camera.height) + ROW * count
        memory.refuse_excess(f"{divided.source}: rendering the {count:,} Gaussians of the view {camera.name}", needed)
        geometry = _joined(list(pool.map(lambda block, some: block.geometry[some], near, places)), (WIDTH,))
    rows = _joined([block.rows[some] for block, some in zip(near, places, strict=True)], ()).astype(np.uint32)
    order = np.argsort(rows, kind="stable")
    scene = Scene(**arrays_of(geometry[order]), sh=np.zeros((count, 1, 3), np.float32), antialiased=divided.antialiased)
    del geometry  # of a view of a town, gigabytes
    blended = np.empty(count, bool)
    blended[order] = _blended(scene, camera, rasterizer)
    ends = np.cumsum([0, *map(len, places)])
    return Shown(near, places, [blended[start:end] for start, end in itertools.pairwise(ends)], rows[order], order, scene)


def seen(divided: Divided, camera: Camera, rasterizer: Rasterizer) -> tuple[Scene, np.ndarray]:
    """The Gaussians that a view may show, in the order of the file, in colours as it sees them (SH degree 0), and their rows in the file (n,). Those that
    the view does not blend have no colours: theirs are not read. Raises SplatError."""
    found = shown(divided, camera, rasterizer)
    sh = np.zeros((found.scene.count, 1, 3), np.float32)
    if found.blocks:
        with ThreadPoolExecutor(threads()) as pool:
            parts = [some[blended] for some, blended in zip(found.places, found.blended, strict=True)]
            sh[np.concatenate(found.blended)] = _joined(list(pool.map(lambda block, some: _colors(block, some, divided, camera), found.blocks, parts)), (1, 3))
    return replace(found.scene, sh=sh[found.order]), found.rows


def _blended(scene: Scene, camera: Camera, rasterizer: Rasterizer) -> np.ndarray:
    """Which Gaussians the view blends into a pixel, (n,) bool. It does not depend on colours."""
    pixels = np.zeros(scene.count, np.int64)
    rasterizer.forward(scene, camera, render_options(scene), outputs=())
    rasterizer.add_scores(np.zeros(scene.count), np.zeros(scene.count, np.float32), pixels)
    return pixels > 0


def _joined(parts: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros((0, *shape), np.float32)


def _colors(block: Block, some: np.ndarray, divided: Divided, camera: Camera) -> np.ndarray:
    """The colours of these Gaussians of a block as the camera sees them, as SH of degree 0, (n, 1, 3) float32."""
    sh = np.empty((len(some), 1, 3), np.float32)
    for start in range(0, len(some), PART):
        rows = some[start : start + PART]
        one = Scene(**arrays_of(block.geometry[rows]), sh=block.sh(divided.coefficients)[rows])
        sh[start : start + PART] = recolored(one, colors(one, np.arange(one.count), camera)).sh
    return sh

"""What a view shows of a divided scene: it reads the blocks that it may show, and of those the Gaussians that
it may show.

Which of these hit a ray before it stops is found out first: without colours, and in parts of the picture that
may show PORTION Gaussians at most, so memory need not hold all that is in view. Only those are then read with
their colours, and rendered. The others do not change the picture: they are behind what is opaque, or too
small, or too faint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ...native.library import threads
from ...native.rasterizer import Rasterizer
from ...render.metrics.evaluate import picture_options, render_options
from ...render.painting import colors, recolored
from ...scene.camera import Camera
from ...scene.gaussians import Scene
from ...system import memory
from .discs import PART, Discs, Window, may_show, places_among, places_in
from .divided import WIDTH, Block, Divided, arrays_of

ROW = 3 * 4 * 14  # bytes of a Gaussian in one colour: its values, and copies while they are put in order
# Gaussians that a part of a picture may show, at most, if its longer side is not below so many pixels
PORTION, MIN_SIDE_PIXELS = 4_000_000, 64
FEWEST = 125_000  # the same, if memory is too short for more
# pixels; what reaches farther is not tested in parts, at whose borders the rasterizer limits the shape of
# large Gaussians
REACH = 32.0


@dataclass(frozen=True)
class Shown:
    """The Gaussians that a view blends into a pixel, or that stop a ray, and perhaps a few others."""

    blocks: list[Block]  # that may have some
    places: list[np.ndarray]  # of each block, the places of the Gaussians in it, ascending
    rows: np.ndarray  # (n,) rows in the file, ascending
    order: np.ndarray  # (n,) of all, block after block, those in the order of the file
    scene: Scene  # in the order of the file, without colours (SH degree 0)


def shown(divided: Divided, camera: Camera, rasterizer: Rasterizer) -> Shown:
    """What a view shows. Raises SplatError."""
    near, places = _in_view(divided, camera)
    blended = [np.zeros(block.count, bool) for block in near]
    portion = _portion(sum(map(len, places)), camera)
    for window, some in _parts(near, places, camera, Window.of(camera), portion):
        found = _blended(divided, near, some, camera, window, rasterizer)
        for marked, part, in_part in zip(blended, some, found, strict=True):
            marked[part[in_part]] = True
    blocks = [block for block, marked in zip(near, blended, strict=True) if marked.any()]
    places = [np.flatnonzero(marked) for marked in blended if marked.any()]
    return Shown(blocks, places, *_read(divided, blocks, places, camera))


def seen(divided: Divided, camera: Camera, rasterizer: Rasterizer) -> tuple[Scene, np.ndarray]:
    """The Gaussians that a view blends or that stop its rays, and perhaps a few others, in the order of the
    file, in colours as it sees them (SH degree 0), and their rows in the file (n,). Raises SplatError."""
    found = shown(divided, camera, rasterizer)
    colours = _each(lambda block, some: _colors(block, some, divided, camera), found.blocks, found.places)
    sh = _joined(colours, (1, 3))
    return replace(found.scene, sh=sh[found.order]), found.rows


def spatial_mask(divided: Divided, camera: Camera, rasterizer: Rasterizer) -> np.ndarray:
    """F of a view (H, W), float32, of all Gaussians on each ray, also those hidden behind others: hits of the
    blocks are added and their transmittances multiplied (docs/methods.md, "Spatial mask", K = N). So memory
    holds one block at a time. Raises SplatError."""
    shape = camera.height, camera.width
    hits, transmittance = np.zeros(shape, np.int64), np.ones(shape, np.float64)
    for block, places in zip(*_in_view(divided, camera), strict=True):
        for start in range(0, len(places), PORTION):
            _, _, scene = _read(divided, [block], [places[start : start + PORTION]], camera)
            options = picture_options(scene, mask_kind="svr")
            found = rasterizer.forward(scene, camera, options, outputs=("hits", "transmittance"))
            hits += found["hits"]
            transmittance *= found["transmittance"]
    mask = np.divide(hits - 1 + transmittance, np.log1p(hits), out=np.zeros(shape), where=hits > 0)
    return mask.astype(np.float32)


def _in_view(divided: Divided, camera: Camera) -> tuple[list[Block], list[np.ndarray]]:
    """The blocks that a view may show, and of each the places of the Gaussians that it may show,
    ascending."""
    near = [block for block in divided.blocks if may_show(block, camera)]
    return near, _each(lambda block: places_in(block, camera), near)


def _each(work: Callable[..., np.ndarray], *arguments: Sequence) -> list[np.ndarray]:
    """What the work gives for each of the arguments, by all threads."""
    with ThreadPoolExecutor(threads()) as pool:
        return list(pool.map(work, *arguments))


def _portion(count: int, camera: Camera) -> int:
    """The Gaussians that a part of a view may show, of `count` in all: PORTION, so that every machine finds
    the same; less only if memory is too short."""
    portion = PORTION
    while portion > FEWEST and memory.shortage("", _needed(min(count, portion), camera)):
        portion //= 2
    return portion


def _parts(
    blocks: Sequence[Block], places: Sequence[np.ndarray], camera: Camera, window: Window, portion: int
) -> Iterator[tuple[Window, Sequence[np.ndarray]]]:
    """Parts of the window, and the places in each block of the Gaussians that they may show, if possible not
    more than `portion`. places: those of the window."""
    longest = max(window.right - window.left, window.bottom - window.top)
    if sum(map(len, places)) <= portion or longest < 2 * MIN_SIDE_PIXELS:
        yield window, places
        return
    for half in window.halves():
        inside = _each(lambda some, block, half=half: places_among(some, block, camera, half), places, blocks)
        yield from _parts(blocks, inside, camera, half, portion)


def _blended(
    divided: Divided,
    blocks: Sequence[Block],
    places: Sequence[np.ndarray],
    camera: Camera,
    window: Window,
    rasterizer: Rasterizer,
) -> Iterator[np.ndarray]:
    """Which Gaussians a part of the view blends into a pixel, or stop a ray there, (n,) bool of each block.
    It does not depend on colours."""
    _, order, scene = _read(divided, blocks, places, window.seen_by(camera))
    reached, needed = np.zeros(scene.count, np.uint8), np.empty(scene.count, bool)
    rasterizer.forward(scene, window.seen_by(camera), render_options(scene), outputs=())
    rasterizer.add_scores(reached=reached)
    needed[order] = reached > 0
    ends = np.cumsum([0, *map(len, places)])
    for block, some, start, end in zip(blocks, places, ends, ends[1:], strict=False):
        wide = _wide(block, some, camera) if window != Window.of(camera) else False
        yield needed[start:end] | wide


def _wide(block: Block, some: np.ndarray, camera: Camera) -> np.ndarray:
    """Which of these Gaussians of a block reach farther than REACH, (n,) bool."""
    parts = (block.geometry[some[start : start + PART]] for start in range(0, len(some), PART))
    discs = (Discs.of_geometry(part, camera) for part in parts)
    return np.concatenate([np.zeros(0, bool), *(disc.right - disc.left > 2 * REACH for disc in discs)])


def _read(
    divided: Divided, blocks: Sequence[Block], places: Sequence[np.ndarray], camera: Camera
) -> tuple[np.ndarray, np.ndarray, Scene]:
    """Gaussians of blocks: their rows in the file, ascending, their order, and themselves, without colours,
    as in Shown. Raises SceneError if memory is too short to render them."""
    count = sum(map(len, places))
    what = f"{divided.source}: rendering the {count:,} Gaussians of the view {camera.name}"
    memory.refuse_excess(what, _needed(count, camera))
    geometry = _joined(_each(lambda block, some: block.geometry[some], blocks, places), (WIDTH,))
    rows = _joined([block.rows[some] for block, some in zip(blocks, places, strict=True)], ())
    rows = rows.astype(np.uint32)
    order = np.argsort(rows, kind="stable")
    scene = Scene(
        **arrays_of(geometry[order]), sh=np.zeros((count, 1, 3), np.float32), antialiased=divided.antialiased
    )
    return rows[order], order, scene


def _needed(count: int, camera: Camera) -> int:
    """Bytes of memory needed to read and render so many Gaussians."""
    return memory.rendering(count, camera.width, camera.height) + ROW * count


def _joined(parts: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros((0, *shape), np.float32)


def _colors(block: Block, some: np.ndarray, divided: Divided, camera: Camera) -> np.ndarray:
    """The colours of these Gaussians of a block as the camera sees them, as SH of degree 0, (n, 1, 3)
    float32."""
    sh = np.empty((len(some), 1, 3), np.float32)
    for start in range(0, len(some), PART):
        rows = some[start : start + PART]
        one = Scene(**arrays_of(block.geometry[rows]), sh=block.sh(divided.coefficients)[rows])
        sh[start : start + PART] = recolored(one, colors(one, np.arange(one.count), camera)).sh
    return sh

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
from functools import partial

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


@dataclass(frozen=True)
class DividedView:
    """A view of a divided scene, and what renders it."""

    divided: Divided
    camera: Camera
    rasterizer: Rasterizer

    def shown(self) -> Shown:
        """What the view shows. Raises SplatError."""
        near, places = self._in_view()
        blended = [np.zeros(block.count, bool) for block in near]
        portion = _portion(sum(map(len, places)), self.camera)
        for window, some in self._parts(near, places, Window.of(self.camera), portion):
            for marked, part, in_part in zip(blended, some, self._blended(near, some, window), strict=True):
                marked[part[in_part]] = True
        blocks = [block for block, marked in zip(near, blended, strict=True) if marked.any()]
        places = [np.flatnonzero(marked) for marked in blended if marked.any()]
        return Shown(blocks, places, *self._read(blocks, places))

    def seen(self) -> tuple[Scene, np.ndarray]:
        """The Gaussians that the view blends or that stop its rays, and perhaps a few others, in the order of
        the file, in colours as it sees them (SH degree 0), and their rows in the file (n,). Raises
        SplatError."""
        found = self.shown()
        colours = _each(partial(_colors, self.divided, self.camera), found.blocks, found.places)
        return replace(found.scene, sh=_joined(colours, (1, 3))[found.order]), found.rows

    def spatial_mask(self) -> np.ndarray:
        """F of the view (H, W), float32, of all Gaussians on each ray, also those hidden behind others: hits
        of the blocks are added and their transmittances multiplied (docs/methods.md, "Spatial mask", K = N).
        So memory holds one block at a time. Raises SplatError."""
        shape = self.camera.height, self.camera.width
        hits, transmittance = np.zeros(shape, np.int64), np.ones(shape, np.float64)
        for block, places in zip(*self._in_view(), strict=True):
            for start in range(0, len(places), PORTION):
                _, _, scene = self._read([block], [places[start : start + PORTION]])
                options = picture_options(scene, mask_kind="svr")
                outputs = ("hits", "transmittance")
                found = self.rasterizer.forward(scene, self.camera, options, outputs=outputs)
                hits += found["hits"]
                transmittance *= found["transmittance"]
        mask = np.divide(hits - 1 + transmittance, np.log1p(hits), out=np.zeros(shape), where=hits > 0)
        return mask.astype(np.float32)

    def _in_view(self) -> tuple[list[Block], list[np.ndarray]]:
        """The blocks that the view may show, and of each the places of the Gaussians that it may show,
        ascending."""
        near = [block for block in self.divided.blocks if may_show(block, self.camera)]
        return near, _each(lambda block: places_in(block, self.camera), near)

    def _parts(
        self, blocks: Sequence[Block], places: Sequence[np.ndarray], window: Window, portion: int
    ) -> Iterator[tuple[Window, Sequence[np.ndarray]]]:
        """Parts of the window, and the places in each block of the Gaussians that they may show, if possible
        not more than `portion`. places: those of the window."""
        longest = max(window.right - window.left, window.bottom - window.top)
        if sum(map(len, places)) <= portion or longest < 2 * MIN_SIDE_PIXELS:
            yield window, places
            return
        for half in window.halves():
            among = lambda some, block, half=half: places_among(some, block, self.camera, half)
            yield from self._parts(blocks, _each(among, places, blocks), half, portion)

    def _blended(
        self, blocks: Sequence[Block], places: Sequence[np.ndarray], window: Window
    ) -> Iterator[np.ndarray]:
        """Which Gaussians a part of the view blends into a pixel, or stop a ray there, (n,) bool of each
        block. It does not depend on colours."""
        part = replace(self, camera=window.seen_by(self.camera))
        _, order, scene = part._read(blocks, places)
        reached, needed = np.zeros(scene.count, np.uint8), np.empty(scene.count, bool)
        self.rasterizer.forward(scene, part.camera, render_options(scene), outputs=())
        self.rasterizer.add_scores(reached=reached)
        needed[order] = reached > 0
        ends = np.cumsum([0, *map(len, places)])
        for block, some, start, end in zip(blocks, places, ends, ends[1:], strict=False):
            wide = _wide(block, some, self.camera) if window != Window.of(self.camera) else False
            yield needed[start:end] | wide

    def _read(
        self, blocks: Sequence[Block], places: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, Scene]:
        """Gaussians of blocks: their rows in the file, ascending, their order, and themselves, without
        colours, as in Shown. Raises SceneError if memory is too short to render them."""
        divided, count = self.divided, sum(map(len, places))
        what = f"{divided.source}: rendering the {count:,} Gaussians of the view {self.camera.name}"
        memory.refuse_excess(what, _needed(count, self.camera))
        geometry = _joined(_each(lambda block, some: block.geometry[some], blocks, places), (WIDTH,))
        rows = _joined([block.rows[some] for block, some in zip(blocks, places, strict=True)], ())
        rows = rows.astype(np.uint32)
        order = np.argsort(rows, kind="stable")
        sh, arrays = np.zeros((count, 1, 3), np.float32), arrays_of(geometry[order])
        return rows[order], order, Scene(**arrays, sh=sh, antialiased=divided.antialiased)


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


def _wide(block: Block, some: np.ndarray, camera: Camera) -> np.ndarray:
    """Which of these Gaussians of a block reach farther than REACH, (n,) bool."""
    parts = (block.geometry[some[start : start + PART]] for start in range(0, len(some), PART))
    discs = (Discs.of_geometry(part, camera) for part in parts)
    return np.concatenate([np.zeros(0, bool), *(disc.right - disc.left > 2 * REACH for disc in discs)])


def _needed(count: int, camera: Camera) -> int:
    """Bytes of memory needed to read and render so many Gaussians."""
    return memory.rendering(count, camera.width, camera.height) + ROW * count


def _joined(parts: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros((0, *shape), np.float32)


def _colors(divided: Divided, camera: Camera, block: Block, some: np.ndarray) -> np.ndarray:
    """The colours of these Gaussians of a block as the camera sees them, as SH of degree 0, (n, 1, 3)
    float32."""
    sh = np.empty((len(some), 1, 3), np.float32)
    for start in range(0, len(some), PART):
        rows = some[start : start + PART]
        one = Scene(**arrays_of(block.geometry[rows]), sh=block.sh(divided.coefficients)[rows])
        sh[start : start + PART] = recolored(one, colors(one, np.arange(one.count), camera)).sh
    return sh

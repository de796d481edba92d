"""What is around a block: the windows of the views in which it is seen, and all Gaussians that are blended
into them.

Beside the blocks lie NUMBER.blended.npy, uint32: the places of the Gaussians that a view blends, counted
through all blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...files.atomic import write_array
from ...native.rasterizer import Rasterizer
from ...scene.camera import Camera
from ...scene.gaussians import Scene
from ...system.errors import FormatError
from .discs import Discs, Window
from .divided import Block, Divided, Progress, arrays_of
from .visible import DividedView

# pixels by which a window is larger than the block on each side: SSIM and the Gaussians at the block's border
# need them
MARGIN = 32
BLENDED = "{}.blended.npy"  # file of a view


@dataclass(frozen=True)
class Around:
    """The parts of the views that show a block, and the Gaussians of all blocks that are blended into these
    parts."""

    divided: Divided
    number: int  # of the block
    blocks: list[Block]  # it, and those that are around it
    windows: list[Window | None]  # of each view; None: it does not show the block
    there: list[np.ndarray]  # of each block, (n,) bool: the Gaussians that are blended into a window

    @classmethod
    def of(
        cls,
        divided: Divided,
        number: int,
        views: Sequence[Camera],
        progress: Progress = lambda *_: None,
        others: Divided | None = None,
    ) -> Around:
        """others: a scene with as many blocks, whose blocks take the place of the others; None: the others
        are those of `divided`. Raises SplatError."""
        rasterizer, windows = Rasterizer(), list[Window | None]()
        blocks = list((others or divided).blocks)
        blocks[number] = divided.blocks[number]
        there = [np.zeros(block.count, bool) for block in blocks]
        for view, camera in enumerate(views):
            progress(f"block {number}, view {camera.name or view}", 0.5 * view / len(views))
            places = _blended(divided, view, camera, rasterizer)
            if others is not None:
                places, own = _blended(others, view, camera, rasterizer), places[number]
                places[number] = own
            of_block = Discs.of_geometry(blocks[number].geometry[places[number]], camera)
            window = of_block.around(camera, MARGIN)
            windows.append(window)
            if window is None:
                continue
            for block, some, marked in zip(blocks, places, there, strict=True):
                marked[some[Discs.of_geometry(block.geometry[some], camera).touch(window)]] = True
        return cls(divided, number, blocks, windows, there)

    @property
    def scene(self) -> Scene:
        """The Gaussians that are there, of all blocks, in their order."""
        marked = [(block, np.flatnonzero(some)) for block, some in zip(self.blocks, self.there, strict=True)]
        geometry = np.concatenate([block.geometry[rows] for block, rows in marked])
        sh = np.concatenate([block.sh(self.divided.coefficients)[rows] for block, rows in marked])
        return Scene(**arrays_of(geometry), sh=sh, antialiased=self.divided.antialiased)

    @property
    def own(self) -> tuple[int, int]:
        """The rows of the scene that are of the block, from and to."""
        first = sum(int(some.sum()) for some in self.there[: self.number])
        return first, first + int(self.there[self.number].sum())


def _blended(divided: Divided, view: int, camera: Camera, rasterizer: Rasterizer) -> list[np.ndarray]:
    """Of each block, the places of the Gaussians that a view blends, ascending, int64. Whoever needs them
    first writes them into the folder. Raises SplatError."""
    path = divided.folder / BLENDED.format(view)
    firsts = np.cumsum([0, *(block.count for block in divided.blocks)])
    if not path.exists():
        found = DividedView(divided, camera, rasterizer).shown()
        places = [firsts[block.number] + some for block, some in zip(found.blocks, found.places, strict=True)]
        write_array(path, np.concatenate([np.zeros(0, np.uint32), *places]).astype(np.uint32))
    try:
        blended = np.load(path, allow_pickle=False).astype(np.int64)
    except (OSError, ValueError, EOFError) as error:
        raise FormatError(f"{path}: cannot be read ({error}); remove it, and start the step again") from None
    parts = np.split(blended, np.searchsorted(blended, firsts[1:-1]))
    return [some - first for some, first in zip(parts, firsts, strict=False)]

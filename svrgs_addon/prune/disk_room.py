"""The disk space of a job: looked for before the work begins, and held until it is used.

What is held is room for the result and for one more checkpoint, with the present number of Gaussians.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from ..files.atomic import FREE_SPACE_MARGIN
from ..files.disk_space import HeldSpace, existing_parent, refuse_shortage
from ..files.ply import file_size
from ..scene.gaussians import Scene
from ..system import memory
from ..system.errors import SceneError
from ..system.file_names import real

PURPOSE = "the result and a checkpoint"
BACKGROUND_FILES = 3  # splat files of a background job: the splat, the recovered Gaussians, the result
ORDER_ROW = 12  # bytes per Gaussian of a quick job's order
ROW = "svrgs_row"  # column of a background job's scene.ply: the row of each Gaussian in the splat
ROW_NUMBER = 4  # bytes: the source row of each Gaussian in these files


class DiskRoom:
    """Room for a result and a checkpoint. A context manager that releases it at its end. out: the result;
    checkpoints: their folder."""

    def __init__(self, out: Path, checkpoints: Path):
        self._out = out
        self._folders = existing_parent(real(out).parent), existing_parent(checkpoints.parent)
        # of the scene: SH coefficients per channel, bytes per Gaussian in a file
        self._coefficients, self._row = 1, 0.0
        self._averaged = 0  # Gaussians whose values will be averaged
        self._held: list[HeldSpace] = []

    def __enter__(self) -> DiskRoom:
        return self

    def __exit__(self, *_):
        self.release()

    def hold_for(self, scene: Scene, count: int, averaged: int):
        """Holds room for `count` Gaussians with the columns of the scene. averaged:
        Settings.averaged_count(). Raises SceneError if there is too little."""
        self._coefficients, self._averaged = scene.sh.shape[1], averaged
        self._row = file_size(scene) / max(1, scene.count)
        self.hold(count)

    def hold(self, count: int):
        """Holds room for `count` Gaussians, in place of what was held. Raises SceneError if there is too
        little."""
        self.release()
        largest_checkpoint = memory.checkpoint(count, self._coefficients, min(self._averaged, count))
        sizes = [int(FREE_SPACE_MARGIN * size) for size in (self._row * count, largest_checkpoint)]
        result, checkpoints = self._folders
        needed = (
            {result: sum(sizes)} if result == checkpoints else dict(zip(self._folders, sizes, strict=True))
        )
        refuse_shortage(self._out, needed, PURPOSE)
        try:
            self._held.extend(
                HeldSpace(folder, size) for folder, size in zip(self._folders, sizes, strict=True)
            )
        except OSError as error:
            self.release()
            refuse_shortage(self._out, needed, PURPOSE)  # others have used it meanwhile
            raise SceneError(f"{self._out}: cannot be written ({error.strerror or error})") from error

    @contextlib.contextmanager
    def for_checkpoint(self, count: int) -> Iterator[None]:
        """Releases the room while the block writes a checkpoint. Then there is room for the next one, if the
        disk has it."""
        self.release()
        yield
        with contextlib.suppress(SceneError):  # the next checkpoint says it
            self.hold(count)

    def release(self):
        while self._held:
            self._held.pop().release()


def bytes_of_job(count: int, file_bytes: int, coefficients: int, quick: bool, checkpoints: int = 1) -> int:
    """Bytes on disk of the folder of a background job, at most. file_bytes: of the splat as a PLY.
    coefficients: SH coefficients per channel. checkpoints: that are there at once."""
    files = BACKGROUND_FILES * (file_bytes + ROW_NUMBER * count)
    if quick:
        return files + file_bytes + ORDER_ROW * count  # merged.ply and order.npy
    return files + checkpoints * memory.checkpoint(count, coefficients, count)


def check_room(folder: Path, scene: Scene, quick: bool):
    """Raises SceneError if there is no disk space for the folder of a background job of the scene."""
    size = bytes_of_job(scene.count, file_size(scene), scene.sh.shape[1], quick)
    refuse_shortage(folder, {folder: int(FREE_SPACE_MARGIN * size)}, "the job")

"""A scene divided into blocks, on the disk: what a view shows can be read without the rest.

The folder holds for each block, in the order of the file that was divided:

    NUMBER.geometry   float32, 11 for each Gaussian: mean 3, log-scale 3, quaternion 4, opacity logit
    NUMBER.sh         float32, 3 K for each
    NUMBER.rows       uint32: the rows in the file, ascending

and blocks.json, which is written last. Blocks are the leaves of a k-d tree: a part with more than `most`
Gaussians is cut at the median of its longest side. The file is read twice; memory holds its means and one
part of it.
"""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...files.atomic import check_space, write_bytes, write_json
from ...files.reading import json_object
from ...files.registry import load_parts, size_on_disk
from ...finetune.decimate.order import NORMALS
from ...scene.gaussians import Scene
from ...system.errors import FormatError, SceneError
from ...system.memory import size_text

SCHEMA, INDEX, LARGEST_INDEX = 1, "blocks.json", 1 << 24
MAX_BLOCK_COUNT = 2_000_000  # Gaussians of a block
SPREAD = 100_000  # Gaussians that stand for all of a scene
GEOMETRY = {"means": 3, "log_scales": 3, "quats": 4, "opacity_logits": 1}
WIDTH = sum(GEOMETRY.values())
OPACITY = WIDTH - 1  # its column
OWN_COLUMNS = "svrgs_"  # how columns begin that a job has added to its splat
OWN_FILES = (  # files of prune/blocks/
    INDEX, "scores_*_of_*.npy", "reduced.json", "error.json", "[0-9]*.geometry", "[0-9]*.sh",
    "[0-9]*.rows", "[0-9]*.visibility", "[0-9]*.order.npz", "[0-9]*.picture.npy", "[0-9]*.blended.npy",
)  # fmt: skip
Progress = Callable[[str, float], None]  # what is done now, and the share of the work that is done
ProgressOf = Callable[[str], Progress]  # of the name of a step
# of the number of Gaussians and the SH coefficients per channel of a scene: Gaussians of a block, at most
MaxBlockCount = Callable[[int, int], int]


@dataclass(frozen=True)
class Block:
    """The Gaussians of one block. Each access maps the file of an array into memory; it is not kept, because
    Windows deletes no file that is mapped."""

    folder: Path
    number: int
    count: int
    low: np.ndarray  # (3,) corners of the box around its means
    high: np.ndarray
    largest: float  # the largest log-scale

    @property
    def geometry(self) -> np.ndarray:
        """(n, 11) float32."""
        return self._mapped("geometry", np.float32, (self.count, WIDTH))

    @property
    def rows(self) -> np.ndarray:
        """(n,) uint32: the rows in the file that was divided."""
        return self._mapped("rows", np.uint32, (self.count,))

    def sh(self, coefficients: int) -> np.ndarray:
        """(n, K, 3) float32."""
        return self._mapped("sh", np.float32, (self.count, coefficients, 3))

    def _mapped(self, name: str, dtype: type, shape: tuple[int, ...]) -> np.ndarray:
        path = self.folder / f"{self.number}.{name}"
        try:
            return np.asarray(np.memmap(path, dtype, "r", shape=shape))
        except (FileNotFoundError, ValueError) as error:
            raise FormatError(f"{path}: cannot be read ({error}); divide the scene again") from None
        except OSError as error:
            size = size_text(math.prod(shape) * np.dtype(dtype).itemsize)
            raise SceneError(f"{path}: cannot be read ({error.strerror}); free {size} of memory") from None


@dataclass(frozen=True)
class Divided:
    """A scene that was divided. source: its file, of so many bytes."""

    folder: Path
    source: Path
    source_bytes: int
    count: int
    coefficients: int  # SH coefficients per channel, K
    antialiased: bool
    blocks: tuple[Block, ...]

    @classmethod
    def read(cls, folder: Path) -> Divided:
        """Raises FormatError, SceneError."""
        path = folder / INDEX
        try:
            found = json_object(path, LARGEST_INDEX) or {}
        except OSError as error:
            raise SceneError(f"{path}: cannot be read ({error.strerror}); divide the scene first") from None
        try:
            if found["schema"] != SCHEMA:
                raise ValueError
            blocks = tuple(
                Block(folder, k, int(n), np.array(low), np.array(high), float(size))
                for k, (n, low, high, size) in enumerate(found["blocks"])
            )
            facts = {name: int(found[name]) for name in ("source_bytes", "count", "coefficients")}
            antialiased = bool(found["antialiased"])
            return cls(folder, Path(found["source"]), **facts, antialiased=antialiased, blocks=blocks)
        except (KeyError, TypeError, ValueError):
            raise FormatError(
                f"{path}: is no divided scene of this version; divide the scene again"
            ) from None

    def write(self):
        """Writes blocks.json. Raises SceneError."""
        facts = {
            "schema": SCHEMA,
            "source": str(self.source),
            "source_bytes": self.source_bytes,
            "count": self.count,
            "coefficients": self.coefficients,
            "antialiased": self.antialiased,
            "blocks": [[one.count, one.low.tolist(), one.high.tolist(), one.largest] for one in self.blocks],
        }
        write_json(self.folder / INDEX, facts)

    @property
    def bytes(self) -> int:
        """Of its blocks on the disk."""
        return self.count * 4 * (WIDTH + 3 * self.coefficients + 1)

    @property
    def means(self) -> np.ndarray:
        """(n, 3) of Gaussians evenly spread over the blocks, about SPREAD of many."""
        step = max(1, self.count // SPREAD)
        return np.concatenate([block.geometry[::step, :3] for block in self.blocks])

    @property
    def digest(self) -> str:
        """Differs for scenes that differ in what is stored here, in hexadecimal digits; not for other
        divisions of the same scene."""
        return hashlib.sha256(
            f"{self.source_bytes} {self.count} {self.coefficients} {self.antialiased}".encode()
        ).hexdigest()[:16]


def arrays_of(geometry: np.ndarray) -> dict[str, Any]:
    """The arrays of a scene, without SH, of rows of the geometry (n, 11)."""
    parts = {
        "means": geometry[:, :3],
        "log_scales": geometry[:, 3:6],
        "quats": geometry[:, 6:10],
        "opacity_logits": geometry[:, 10],
    }
    return {name: np.ascontiguousarray(array) for name, array in parts.items()}


def scene_of(divided: Divided, block: Block) -> Scene:
    """The Gaussians of a block, in memory."""
    sh = np.array(block.sh(divided.coefficients))
    return Scene(**arrays_of(np.array(block.geometry)), sh=sh, antialiased=divided.antialiased)


def divide(
    source: Path,
    folder: Path,
    most: int | MaxBlockCount = MAX_BLOCK_COUNT,
    progress: Progress = lambda *_: None,
    read: Callable[[Path], Iterator[Scene]] = load_parts,
) -> Divided:
    """Divides the scene of a file. A divided scene that is in the folder is replaced. most: Gaussians of a
    block, at most. read: reads the file, in parts. Raises SplatError."""
    folder.mkdir(parents=True, exist_ok=True)
    clear(folder)
    progress("reads the means", 0.0)
    means, coefficients, antialiased = _means(source, read)
    size = len(means) * 4 * (WIDTH + 3 * coefficients + 1)
    check_space(folder / INDEX, size)
    if not isinstance(most, int):
        most = most(len(means), coefficients)
    parts = list(leaves(means, np.arange(len(means), dtype=np.uint32), most))
    block_of = np.empty(len(means), np.uint32)
    for number, rows in enumerate(parts):
        block_of[rows] = number
    boxes = [(means[rows].min(axis=0), means[rows].max(axis=0), len(rows)) for rows in parts]
    del means, parts
    largest = np.full(len(boxes), -np.inf)
    start = 0
    for part in read(source):
        try:
            _append(part, block_of[start : start + part.count], start, folder, largest)
        except OSError as error:
            raise SceneError(
                f"{folder}: a block cannot be written ({error.strerror}); the blocks need {size_text(size)}:"
                " free disk space, or choose another folder"
            ) from error
        start += part.count
        progress("writes the blocks", start / len(block_of))
    blocks = tuple(
        Block(folder, k, n, low, high, float(largest[k])) for k, (low, high, n) in enumerate(boxes)
    )
    divided = Divided(folder, source, size_on_disk(source), len(block_of), coefficients, antialiased, blocks)
    divided.write()
    return divided


def write_block(folder: Path, number: int, scene: Scene, start: int):
    """Writes the Gaussians of a block; their rows begin with `start`. gathered() makes a divided scene of all
    blocks. Raises SceneError."""
    rows = np.arange(start, start + scene.count, dtype=np.uint32)
    for name, array in (("geometry", _geometry(scene)), ("sh", scene.sh), ("rows", rows)):
        check_space(folder / f"{number}.{name}", array.nbytes)
        write_bytes(folder / f"{number}.{name}", np.ascontiguousarray(array).data.cast("B"))


def gathered(folder: Path, like: Divided) -> Divided:
    """The divided scene of blocks in a folder that were written one by one, as many as `like` has. Raises
    SceneError if one is missing."""
    blocks = []
    for number in range(len(like.blocks)):
        try:
            count = (folder / f"{number}.rows").stat().st_size // 4
        except OSError:
            raise SceneError(
                f"{folder}: the block {number} is missing; do the step before it first"
            ) from None
        one = Block(folder, number, count, np.zeros(3), np.zeros(3), 0.0)
        means, largest = one.geometry[:, :3], float(one.geometry[:, 3:6].max())
        blocks.append(replace(one, low=means.min(axis=0), high=means.max(axis=0), largest=largest))
    divided = replace(like, folder=folder, count=sum(one.count for one in blocks), blocks=tuple(blocks))
    divided.write()
    return divided


def clear(folder: Path):
    """Removes the files of a divided scene from a folder, and no others."""
    for path in (path for name in OWN_FILES for path in folder.glob(name)):
        path.unlink(missing_ok=True)


def _means(source: Path, read: Callable[[Path], Iterator[Scene]]) -> tuple[np.ndarray, int, bool]:
    """The means (N, 3) of a file, its SH coefficients per channel, and whether it is antialiased."""
    parts, part = [], None
    for part in read(source):
        parts.append(part.means.copy())
    assert part is not None
    if columns := sorted(
        name for name in part.attributes if name not in NORMALS and not name.startswith(OWN_COLUMNS)
    ):
        logging.warning("%s: these columns of the file are left out: %s", source, ", ".join(columns))
    return np.concatenate(parts), part.sh.shape[1], part.antialiased


def leaves(means: np.ndarray, rows: np.ndarray, most: int) -> Iterator[np.ndarray]:
    """The rows of each part of a k-d tree, ascending, at most so many. means: (N, 3). rows: (n,), ascending.
    Parts of a part are those of the whole."""
    if len(rows) <= most:
        yield rows
        return
    here = means[rows]
    values = here[:, int(np.argmax(np.ptp(here, axis=0)))]
    del here
    low = values < np.partition(values, len(values) // 2)[len(values) // 2]
    if not low.any():  # more than half are at the lowest place
        low[: len(low) // 2] = True
    yield from leaves(means, rows[low], most)
    yield from leaves(means, rows[~low], most)


def _geometry(scene: Scene) -> np.ndarray:
    """(n, 11) float32."""
    return np.concatenate(
        [getattr(scene, name).reshape(scene.count, -1) for name in GEOMETRY], axis=1, dtype=np.float32
    )


def _append(part: Scene, numbers: np.ndarray, start: int, folder: Path, largest: np.ndarray):
    """Appends the Gaussians of a part of the file to their blocks. largest: (blocks,) the largest log-scales
    so far, which are changed. Raises OSError."""
    geometry = _geometry(part)
    for number in np.unique(numbers):
        some = np.flatnonzero(numbers == number)
        largest[number] = max(largest[number], part.log_scales[some].max())
        arrays = {"geometry": geometry[some], "sh": part.sh[some], "rows": (start + some).astype(np.uint32)}
        for name, array in arrays.items():
            with open(folder / f"{number}.{name}", "ab") as file:
                file.write(np.ascontiguousarray(array).data)

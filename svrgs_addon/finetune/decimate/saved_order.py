"""The files of an order, from which the scene with any number of Gaussians is put together at once.

merged.ply    the M Gaussians that merging makes
order.npy     (n, 3) int32: row of a Gaussian, among the N of the source and those M; the number of
              operations after which it is there, and after which it is gone again. Gaussians that are
              close in space are close in the file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...files.atomic import write_array
from ...files.registry import read_scene, write_scene
from ...files.sh_rounding import without_bands
from ...scene.affine import transformed
from ...scene.concatenate import concatenated
from ...scene.gaussians import PARAMETERS, Scene
from ...scene.morton_order import morton_order
from ...system.errors import FormatError
from .order import Order

MERGED, ORDER = "merged.ply", "order.npy"  # names of the files


@dataclass(frozen=True)
class SavedOrder:
    """All Gaussians that are there after some number of operations."""

    scene: Scene  # (n,)
    born: np.ndarray  # (n,) int32
    gone: np.ndarray  # (n,) int32
    least: int  # numbers of Gaussians between which at() chooses
    most: int

    def at(self, count: int) -> Scene:
        """The scene with about `count` Gaussians, as clipped() says; without further columns."""
        done = self.most - self.clipped(count)
        return self.scene.select(np.flatnonzero((self.born <= done) & (self.gone > done)))

    def clipped(self, count: int) -> int:
        """The number of Gaussians that at(count) has."""
        return min(max(count, self.least), self.most)

    def moved(self, matrix: np.ndarray) -> SavedOrder:
        """The order with all Gaussians moved by an affine (4, 4). Raises SceneError if it is singular."""
        return replace(self, scene=transformed(self.scene, matrix))


def write_order(folder: Path, order: Order, rows: np.ndarray, total: int):
    """Writes the files. rows: (n,) rows of the order's Gaussians in the source, which has `total`. Raises
    SceneError."""
    made = replace(
        Scene.of(*(order.merges.results[name] for name in PARAMETERS)), antialiased=order.scene.antialiased
    )
    table = np.column_stack([np.concatenate([rows, total + np.arange(made.count)]), order.lives]).astype(
        np.int32
    )
    near = morton_order(np.concatenate([order.scene.means, made.means]))
    write_scene(folder / MERGED, made)
    write_array(folder / ORDER, table[near], keep=False)


def read_order(folder: Path, source: Scene) -> SavedOrder:
    """Reads the files. source: the scene that the order is of. Raises FormatError, SceneError."""
    made = replace(read_scene(folder / MERGED), antialiased=source.antialiased)
    rows, born, gone = _checked(folder / ORDER, source.count + made.count).T.copy()
    most = int((born == 0).sum())
    return SavedOrder(
        concatenated([without_bands(source, made.sh_degree), made]).select(rows),
        born,
        gone,
        least=most - int(gone.max()) + 1,
        most=most,
    )


def _checked(file: Path, rows: int) -> np.ndarray:
    """The array in order.npy, of up to `rows` Gaussians. Raises FormatError if it is another one, or if an
    operation does not take away one Gaussian."""
    try:
        table = np.array(np.load(file, mmap_mode="r", allow_pickle=False))
    except (OSError, ValueError, EOFError) as error:
        raise FormatError(f"{file}: cannot be read ({error})") from None
    if table.ndim != 2 or table.shape[1:] != (3,) or not 0 < len(table) <= rows or table.dtype != np.int32:
        raise FormatError(f"{file}: holds {table.dtype}{table.shape}; expected int32(up to {rows}, 3)")
    row, born, gone = table.T
    if (
        table.min() < 0
        or row.max() >= rows
        or np.bincount(row).max() > 1
        or (born >= gone).any()
        or gone.max() > rows
    ):
        raise FormatError(f"{file}: is damaged; prune again")
    there = np.cumsum(np.bincount(born, minlength=gone.max() + 1) - np.bincount(gone))[:-1]
    if (there != there[0] - np.arange(len(there))).any():
        raise FormatError(f"{file}: is damaged; prune again")
    return table

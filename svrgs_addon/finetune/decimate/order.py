"""An order of removals and merges: one order gives the scene with any number of Gaussians.

What the views see of each Gaussian is summed over all views (Rasterizer.add_visibility). The native library
then orders the operations (svrgs_decimate in svrgs.h). Photographs are not needed: the pictures are those of
the scene itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...files.ply import NORMALS
from ...native.decimation import REMOVED, Merges, decimate
from ...native.rasterizer import VISIBILITY
from ...scene.gaussians import PARAMETERS, Scene
from ...system.errors import SceneError
from ..viewed_scene import ViewedScene

HIDDEN = 0.01  # mean transmittance up to which a Gaussian is hidden
MOST_HIDDEN = 0.3  # share of the Gaussians that placed cameras may leave hidden


@dataclass(frozen=True)
class Order:
    """The order of the operations on a scene of N Gaussians."""

    scene: Scene
    merges: Merges

    @property
    def least(self) -> int:
        """The smallest number of Gaussians that at() gives."""
        return self.scene.count - len(self.merges.a)

    @cached_property
    def lives(self) -> np.ndarray:
        """(N + M, 2) int32: after how many operations a row is there, and is gone again."""
        steps, merged = len(self.merges.a), self.merges.b != REMOVED
        lives = np.zeros((self.scene.count + int(merged.sum()), 2), np.int32)
        lives[self.scene.count :, 0] = np.flatnonzero(merged) + 1
        lives[:, 1] = steps + 1
        lives[self.merges.a, 1] = np.arange(1, steps + 1)
        lives[self.merges.b[merged], 1] = np.flatnonzero(merged) + 1
        return lives

    def at(self, count: int) -> Scene:
        """The scene with `count` Gaussians, least to N: those of the original in their order, then those that
        are merged from several. Further attributes are left out if any were merged."""
        kept, made = self.rows_at(count)
        whole = self.scene.select(kept)
        if not len(made["means"]):
            return whole
        arrays = {name: np.concatenate([getattr(whole, name), made[name]]) for name in PARAMETERS}
        return replace(whole, **arrays, attributes={}, property_order=())

    def rows_at(self, count: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """What at() is made of: rows of the original, (K,) ascending, and arrays of merged Gaussians."""
        done = self.scene.count - count
        born, gone = self.lives.T
        there = np.flatnonzero((born <= done) & (gone > done))
        kept = there[there < self.scene.count]
        return kept, {
            name: self.merges.results[name][there[len(kept) :] - self.scene.count] for name in PARAMETERS
        }


def visibility_sums(viewed: ViewedScene, pictures: bool = True) -> tuple[np.ndarray, list[np.ndarray]]:
    """What all views see of each Gaussian, (N, 9) float64 in the order of VISIBILITY, and the pictures (H, W,
    3) of the views, if they are wanted."""
    sums, seen = np.zeros((viewed.scene.count, len(VISIBILITY))), list[np.ndarray]()
    for _, images in viewed.rendered(outputs=("rgb",) if pictures else ()):
        seen += images.values()
        viewed.rasterizer.add_visibility(sums)
    return sums, seen


def hidden(sums: np.ndarray) -> int:
    """The number of Gaussians of at most HIDDEN mean transmittance. sums (N, 9): of visibility_sums()."""
    columns = dict(zip(VISIBILITY, sums.T, strict=True))
    return int((columns["transmittance"] <= HIDDEN * columns["pixels"]).sum())


def order_of(scene: Scene, sums: np.ndarray, least: int) -> Order:
    """The order that leaves `least`, 1 to N. sums: of visibility_sums(). Raises SceneError if all are 0."""
    columns = dict(zip(VISIBILITY, sums.T, strict=True))
    seen = columns["views"] > 0
    if not seen.any():
        raise SceneError(
            "no view sees any of the Gaussians: all are too faint to be drawn, or the cameras belong to"
            " another scene"
        )
    pixel = float(np.median(np.sqrt(columns["views"][seen] / columns["density"][seen])))
    middle = np.median(scene.means[seen].astype(np.float64), axis=0)
    return Order(scene, decimate(scene, sums, middle, pixel, least))


def lost_columns(source: Scene, small: Scene, expected: Sequence[str] = NORMALS) -> list[str]:
    """A sentence on columns, but `expected` ones, that are lost: merged Gaussians have no values in them."""
    lost = sorted(source.attributes.keys() - small.attributes.keys() - set(expected))
    return [f"these columns of the file were left out: {', '.join(lost)}"] if lost else []

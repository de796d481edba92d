"""The arrays that a run changes: parameters, Adam moments, existence logits. Rows change only through keep(),
reorder() and append()."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..scene.gaussians import PARAMETERS, SH_C0, SH_COEFFICIENTS, Scene
from ..scene.neighbours import nearest_distances
from ..system.errors import SceneError
from .moments import zero_moments

MASK = "mask_logits"
MIN_SQUARED_DISTANCE = 1e-7  # in Camera.unit
NEIGHBOURS = 3
BLOCK_ROWS = 65_536  # rows copied at a time


class Model:
    """N Gaussians in training.

    values: the arrays of Scene by name (raw, shapes as there) and, while masks are learned, mask_logits (N,),
    the existence logits. All have the same dtype, float32 or float64. moments: the Adam moments of each value
    (moments.py), under the same names. origin (N,) int32: row of each Gaussian in the source scene, -1 for
    Gaussians that were added. metadata: the other fields of the source scene.
    """

    def __init__(
        self,
        values: dict[str, np.ndarray],
        moments: dict | None = None,
        origin: np.ndarray | None = None,
        metadata: dict | None = None,
    ):
        self.values = values
        self.moments = moments or {name: zero_moments(array) for name, array in values.items()}
        self.origin = np.arange(len(values["means"]), dtype=np.int32) if origin is None else origin
        self.metadata = metadata or {}

    @classmethod
    def of(cls, scene: Scene, dtype=np.float32, copy: bool = True) -> Model:
        """The model of a scene. copy=False: the model uses the scene's own arrays and changes them."""
        values = {name: getattr(scene, name).astype(dtype, copy=copy) for name in PARAMETERS}
        return cls(
            values, metadata={name: value for name, value in vars(scene).items() if name not in PARAMETERS}
        )

    def __getattr__(self, name: str) -> np.ndarray:  # the rasteriser reads a model as it reads a Scene
        try:
            return self.__dict__["values"][name]
        except KeyError:
            raise AttributeError(name) from None

    @property
    def count(self) -> int:
        return len(self.origin)

    @property
    def dtype(self) -> np.dtype:
        return self.values["means"].dtype

    @property
    def antialiased(self) -> bool:
        """Whether the source scene was trained with the filter of Mip-Splatting."""
        return self.metadata.get("antialiased", False)

    @property
    def learns_masks(self) -> bool:
        return MASK in self.values

    def add_masks(self, init: float):
        """Gives every Gaussian an existence logit of the value `init`."""
        self.add(MASK, np.full(self.count, init, self.dtype))

    def add(self, name: str, values: np.ndarray):
        """Adds one value per Gaussian (N,), or replaces it. Its moments start at zero."""
        self.values[name], self.moments[name] = values, zero_moments(values)

    def remove_extras(self):
        """Removes the existence logits and every other value that add() added."""
        for arrays in (self.values, self.moments):
            for name in arrays.keys() - set(PARAMETERS):
                del arrays[name]

    def keep(self, mask: np.ndarray):
        """Keeps the rows where mask (N,) is True, with moments; in place, for the peak of memory."""
        self._select(np.flatnonzero(mask), compacted)

    def reorder(self, index: np.ndarray):
        """Permutes rows and moments, an array at a time: the new row i is the old row index[i], (N,)."""
        self._select(index, lambda array, rows: array.take(rows, axis=0))

    def _select(self, rows: np.ndarray, selected: Callable[[np.ndarray, np.ndarray], np.ndarray]):
        """Selects `rows` of every array. selected(array, rows) returns array[rows]."""
        for arrays in (self.values, self.moments):
            for name in arrays:
                arrays[name] = selected(arrays[name], rows)
        self.origin = self.origin[rows]

    def first(self, count: int) -> Model:
        """The first `count` rows as a model that shares the arrays: training it changes this one."""
        values, moments = (
            {name: array[:count] for name, array in arrays.items()} for arrays in (self.values, self.moments)
        )
        return Model(values, moments, self.origin[:count], self.metadata)

    def append(self, rows: dict[str, np.ndarray]):
        """Adds Gaussians with zero moments. rows: one array per name in `values`."""
        added = len(rows["means"])
        for name, new in rows.items():
            new = new.astype(self.dtype)
            self.values[name] = np.concatenate([self.values[name], new])
            self.moments[name] = np.concatenate([self.moments[name], zero_moments(new)])
        self.origin = np.concatenate([self.origin, np.full(added, -1, np.int32)])

    def into_scene(self, source_order: bool = True) -> Scene:
        """The model as a Scene, at the end of a run. It takes the arrays out of the model, so the model is
        empty afterwards.

        Rows have the order of the source; added Gaussians follow. source_order=False: rows have the model's
        order. The other fields of the source are kept; its attributes only if no Gaussian was added. An array
        that is already in this order is not copied.
        """
        self.moments = {}
        rows: np.ndarray | slice = slice(None)
        if source_order:
            order = np.argsort(np.where(self.origin < 0, np.iinfo(np.int32).max, self.origin), kind="stable")
            rows = order if (np.diff(order) <= 0).any() else rows
        arrays: dict[str, Any] = {
            name: np.ascontiguousarray(self.values.pop(name)[rows], np.float32) for name in PARAMETERS
        }
        if (self.origin < 0).any():
            return Scene(**arrays, **(self.metadata | {"attributes": {}, "property_order": ()}))
        attributes = {
            name: column[self.origin[rows]] for name, column in self.metadata.get("attributes", {}).items()
        }
        return Scene(**arrays, **(self.metadata | {"attributes": attributes}))


def compacted(array: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """array[rows] for ascending rows, written in place: a view of the first rows of the array."""
    for start in range(0, len(rows), BLOCK_ROWS):
        part = rows[start : start + BLOCK_ROWS]
        array[start : start + len(part)] = array[part]
    return array[: len(rows)]


def scene_from_points(
    points: np.ndarray,
    colors: np.ndarray,
    sh_degree: int = 3,
    opacity: float = 0.1,
    size: float = 1.0,
    unit: float = 1.0,
) -> Scene:
    """Initialisation of 3DGS: one isotropic Gaussian per point, with opacity 0.1 and the size of the distance
    to its neighbours.

    points (P, 3): world coordinates; colors (P, 3) uint8. scale = size sqrt(mean squared distance to the 3
    nearest points). unit: Camera.unit. Raises SceneError for fewer than 4 points.
    """
    n = len(points)
    if n <= NEIGHBOURS:
        raise SceneError(
            f"the dataset has too few sparse points: {n}; training needs at least {NEIGHBOURS + 1}"
        )
    squared = (nearest_distances(points, NEIGHBOURS) ** 2).mean(axis=1)
    squared = np.maximum(squared, MIN_SQUARED_DISTANCE * unit**2)
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    sh = np.zeros((n, SH_COEFFICIENTS[sh_degree], 3), np.float32)
    sh[:, 0] = (colors / 255.0 - 0.5) / SH_C0
    return Scene(
        means=np.array(points, np.float32, order="C"),
        log_scales=np.repeat((0.5 * np.log(squared) + np.log(size))[:, None], 3, axis=1).astype(np.float32),
        quats=quats,
        opacity_logits=np.full(n, np.log(opacity / (1 - opacity)), np.float32),
        sh=sh,
    )

"""The arrays a run changes: parameters, Adam moments, mask logits. Every move of rows goes through keep(), reorder() or append()."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import SceneError
from ..scene import SH_C0, SH_COEFFICIENTS, Scene
from .moments import none_yet

PARAMETERS = ("means", "log_scales", "quats", "opacity_logits", "sh")
MASK = "mask_logits"
MIN_SQUARED_DISTANCE = 1e-7
NEIGHBOURS = 3
BLOCK_ROWS = 65_536  # moved at a time
INITIAL_OPACITY = 0.1


class Model:
    """N Gaussians in training: `values`, and their Adam `moments` (moments.py) under the same names.

    Values are the arrays of Scene (raw, shapes as there) and, while masks are learned, mask_logits (N,); all of one
    real dtype. origin (N,) int32: the row of the source scene each Gaussian came from, -1 for new ones. metadata: the
    source scene's other fields.
    """

    def __init__(self, values: dict[str, np.ndarray], moments: dict | None = None, origin: np.ndarray | None = None, metadata: dict | None = None):
        self.values = values
        self.moments = moments or {name: none_yet(array) for name, array in values.items()}
        self.origin = np.arange(len(values["means"]), dtype=np.int32) if origin is None else origin
        self.metadata = metadata or {}

    @classmethod
    def of(cls, scene: Scene, dtype=np.float32, copy: bool = True) -> Model:
        """copy=False: takes over the scene's own arrays, and changes them."""
        values = {name: getattr(scene, name).astype(dtype, copy=copy) for name in PARAMETERS}
        return cls(values, metadata={name: value for name, value in vars(scene).items() if name not in PARAMETERS})

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
    def learns_masks(self) -> bool:
        return MASK in self.values

    def add_masks(self, init: float):
        """Gives every Gaussian an existence logit, all alike."""
        self.add(MASK, np.full(self.count, init, self.dtype))

    def add(self, name: str, values: np.ndarray):
        """Gives every Gaussian one more value (N,), or another in its place; its moments start at zero."""
        self.values[name], self.moments[name] = values, none_yet(values)

    def forget_extras(self):
        """Masks, and whatever else was added."""
        for arrays in (self.values, self.moments):
            for name in arrays.keys() - set(PARAMETERS):
                del arrays[name]

    def keep(self, mask: np.ndarray):
        """Keeps the rows where mask (N,) is True, moments included. Within the arrays' own memory: a copy would be the run's peak."""
        self._move(np.flatnonzero(mask), moved_up)

    def reorder(self, index: np.ndarray):
        """Row i becomes what row index[i] was, moments included; index (N,): a permutation. Copies one array at a time."""
        self._move(index, lambda array, rows: array.take(rows, axis=0))

    def _move(self, rows: np.ndarray, moved: Callable[[np.ndarray, np.ndarray], np.ndarray]):
        """moved(array, rows) is array[rows]."""
        for arrays in (self.values, self.moments):
            for name in arrays:
                arrays[name] = moved(arrays[name], rows)
        self.origin = self.origin[rows]

    def append(self, rows: dict[str, np.ndarray]):
        """Adds new Gaussians with zero moments; rows: an array for every name in `values`."""
        added = len(rows["means"])
        for name, new in rows.items():
            new = new.astype(self.dtype)
            self.values[name] = np.concatenate([self.values[name], new])
            self.moments[name] = np.concatenate([self.moments[name], none_yet(new)])
        self.origin = np.concatenate([self.origin, np.full(added, -1, np.int32)])

    def into_scene(self) -> Scene:
        """The end of a run: the model as a Scene, rows in the source's order and new ones after them, and the source's other
        fields as far as they still fit. The model gives up its arrays, one after the other; where they are in that order, none is copied.
        """
        self.moments = {}
        rows = self._source_order()
        arrays: dict[str, Any] = {name: np.ascontiguousarray(self.values.pop(name)[rows], np.float32) for name in PARAMETERS}
        if (self.origin < 0).any():
            return Scene(**arrays, **(self.metadata | {"attributes": {}, "property_order": ()}))
        attributes = {name: column[self.origin[rows]] for name, column in self.metadata.get("attributes", {}).items()}
        return Scene(**arrays, **(self.metadata | {"attributes": attributes}))

    def _source_order(self) -> np.ndarray | slice:
        """Index of the rows as the source had them, new ones last in their present order; a slice of all where they are so already."""
        order = np.argsort(np.where(self.origin < 0, np.iinfo(np.int32).max, self.origin), kind="stable")
        return slice(None) if (np.diff(order) > 0).all() else order


def moved_up(array: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """array[rows] for ascending rows, in the first part of the array's own memory."""
    for start in range(0, len(rows), BLOCK_ROWS):
        part = rows[start : start + BLOCK_ROWS]
        array[start : start + len(part)] = array[part]
    return array[: len(rows)]


def scene_from_points(points: np.ndarray, colors: np.ndarray, sh_degree: int = 3) -> Scene:
    """3DGS initialisation: one isotropic Gaussian a point, opacity 0.1, as large as its three neighbours are far.

    points (P, 3) world; colors (P, 3) uint8. log-scale = log sqrt(mean squared distance to the 3 nearest points).
    Raises SceneError for fewer than 4 points, or where scipy is not installed.
    """
    try:
        from scipy.spatial import cKDTree
    except ImportError:
        raise SceneError(f"training from sparse points needs the package scipy: run {sys.executable} -m pip install scipy") from None
    n = len(points)
    if n <= NEIGHBOURS:
        raise SceneError(f"{n} sparse points are too few to start training from: at least {NEIGHBOURS + 1} are needed")
    distance, _ = cKDTree(points).query(points, k=NEIGHBOURS + 1)
    squared = np.maximum((distance[:, 1:] ** 2).mean(axis=1), MIN_SQUARED_DISTANCE)
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    sh = np.zeros((n, SH_COEFFICIENTS[sh_degree], 3), np.float32)
    sh[:, 0] = (colors / 255.0 - 0.5) / SH_C0
    return Scene(
        means=np.array(points, np.float32, order="C"),
        log_scales=np.repeat(0.5 * np.log(squared)[:, None], 3, axis=1).astype(np.float32),
        quats=quats,
        opacity_logits=np.full(n, np.log(INITIAL_OPACITY / (1 - INITIAL_OPACITY)), np.float32),
        sh=sh,
    )

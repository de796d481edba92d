"""Exposure and white balance of each photograph: a 3 x 4 colour matrix, fitted while the splat is trained,
as in 3DGS.

    seen = A c + b      c: the rendered colour of a pixel, display sRGB; (A | b): of its photograph

The matrices count relative to their mean, so that the mean correction is the identity: the splat keeps its
own colours, and the matrices hold only what differs from photograph to photograph. They stand beside the
result and are never baked into it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files.atomic import write_json
from ..files.images import srgb_to_linear
from .photo_adam import PhotoAdam

FIRST, LAST = 0.01, 0.001  # learning rates at the first and at the last step, log-linear in between (3DGS)
IDENTITY = np.eye(3, 4)


@dataclass
class Exposures(PhotoAdam):
    """The matrices of V photographs with their Adam state: values (V, 3, 4)."""

    values: np.ndarray

    @classmethod
    def identities(cls, count: int) -> Exposures:
        values = np.tile(IDENTITY, (count, 1, 1))
        return cls(np.zeros_like(values), np.zeros_like(values), np.zeros(count, np.int64), values)

    @property
    def matrices(self) -> np.ndarray:
        """(V, 3, 4), whose mean is the identity."""
        return self.values - self.values.mean(axis=0) + IDENTITY

    def update(self, number: int, grad: np.ndarray, rate: float):
        """An Adam step of one photograph. grad: dL/d(its matrix), (3, 4)."""
        self.values[number] += self.change(number, grad, rate)


def stops(matrices: np.ndarray) -> np.ndarray:
    """By how many stops (EV) each matrix brightens middle grey, (V,): log2 of its linear brightness."""
    grey = 0.5
    seen = (matrices[:, :, :3].sum(axis=2) * grey + matrices[:, :, 3]).clip(1e-3, None)
    return np.log2(srgb_to_linear(seen).mean(axis=1) / srgb_to_linear(np.array(grey)))


def file_of(out: Path) -> Path:
    """Where the matrices of a result are written."""
    return out.with_name(f"{out.name}_exposure.json")


def write(path: Path, names: list[str], matrices: np.ndarray):
    """As 3DGS writes exposure.json: the matrix of each photograph by its name. Raises SceneError."""
    write_json(path, dict(zip(names, matrices.tolist(), strict=True)), indented=True)

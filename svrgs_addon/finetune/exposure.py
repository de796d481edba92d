"""Exposure and white balance of each photograph: a 3 x 4 colour matrix, fitted while the splat is trained,
as in 3DGS.

    seen = A c + b      c: the rendered colour of a pixel, display sRGB; (A | b): of its photograph

The matrices count relative to their mean, so that the mean correction is the identity: the splat keeps its
own colours, and the matrices hold only what differs from photograph to photograph. They stand beside the
result and are never baked into it.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..files.atomic import atomic_write
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


def exposed(rgb: np.ndarray, matrix: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Rendered colours (H, W, 3) as the photograph would show them; 0 where pixels do not count. matrix
    (3, 4); valid (H, W), None: all count."""
    rows = _wide(rgb)
    pixels = rows.shape[1] // 3
    seen = rows @ np.kron(np.eye(pixels), matrix[:, :3].T).astype(rgb.dtype)
    by_rows = seen.reshape(rgb.shape[0], -1)  # sums along long rows are three times as fast
    by_rows += np.tile(matrix[:, 3], rgb.shape[1]).astype(rgb.dtype)
    seen = seen.reshape(rgb.shape)
    return seen if valid is None else seen * valid[..., None]


def exposed_vjp(
    d_seen: np.ndarray, rgb: np.ndarray, matrix: np.ndarray, valid: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """dL/drgb (H, W, 3) and dL/dmatrix (3, 4) float64, of dL/dseen (H, W, 3)."""
    rows, colours = _wide(d_seen if valid is None else d_seen * valid[..., None]), _wide(rgb)
    pixels = rows.shape[1] // 3
    of_pixels = (rows.T @ colours).astype(np.float64).reshape(pixels, 3, pixels, 3)
    sums = (np.ones(len(rows), rows.dtype) @ rows).astype(np.float64).reshape(pixels, 3).sum(axis=0)
    d_rgb = rows @ np.kron(np.eye(pixels), matrix[:, :3]).astype(rgb.dtype)
    return d_rgb.reshape(rgb.shape), np.column_stack([np.einsum("kikj->ij", of_pixels), sums])


def _wide(image: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) with up to four pixels a row: products of matrices with three columns are slow."""
    return np.ascontiguousarray(image).reshape(-1, 3 * math.gcd(image.shape[0] * image.shape[1], 4))


def stops(matrices: np.ndarray) -> np.ndarray:
    """By how many stops (EV) each matrix makes middle grey brighter, (V,): log2 of the ratio of its linear
    brightness."""
    grey = 0.5
    seen = (matrices[:, :, :3].sum(axis=2) * grey + matrices[:, :, 3]).clip(1e-3, None)
    return np.log2(srgb_to_linear(seen).mean(axis=1) / srgb_to_linear(np.array(grey)))


def file_of(out: Path) -> Path:
    """Where the matrices of a result are written."""
    return out.with_name(f"{out.stem}_exposure.json")


def write(path: Path, names: list[str], matrices: np.ndarray):
    """As 3DGS writes exposure.json: the matrix of each photograph by its name. Raises SceneError."""
    with atomic_write(path) as file:
        file.write(json.dumps(dict(zip(names, matrices.tolist(), strict=True)), indent=1).encode() + b"\n")

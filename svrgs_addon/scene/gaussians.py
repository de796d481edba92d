"""A splat scene: the raw parameters of 3DGS (logits, logarithms), and the further contents of its file."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..system.errors import SceneError

SH_C0 = 0.28209479177387814
SH_COEFFICIENTS = (1, 4, 9, 16)
PARAMETERS = ("means", "log_scales", "quats", "opacity_logits", "sh")  # arrays of a scene


def parameter_shapes(count: int, coefficients: int) -> dict[str, tuple[int, ...]]:
    """The shapes of the PARAMETERS of `count` Gaussians. coefficients: SH coefficients per channel, K."""
    widths: tuple[tuple[int, ...], ...] = ((3,), (3,), (4,), (), (coefficients, 3))
    return {name: (count, *width) for name, width in zip(PARAMETERS, widths, strict=True)}


@dataclass(frozen=True)
class Scene:
    """N Gaussians as 3DGS stores them. All parameter arrays are float32 and C-contiguous.

    The values are raw. The activated values are exp(log_scales), sigmoid(opacity_logits) and quats / |quats|.
    Coordinate frame and unit of length are those of the source file (the COLMAP world for a trained scene).
    Raises SceneError if an array has another shape, dtype or layout than stated.
    """

    means: np.ndarray  # (N, 3)
    log_scales: np.ndarray  # (N, 3)
    quats: np.ndarray  # (N, 4) w x y z, of any length > 0
    opacity_logits: np.ndarray  # (N,)
    sh: np.ndarray  # (N, K, 3), coefficient-major; K = 1, 4, 9 or 16 coefficients per channel
    # trained with opacity compensated for the 2-D low-pass filter, "antialiased" in gsplat
    antialiased: bool = False
    # further columns of the file, (N,) each, as read
    attributes: dict[str, np.ndarray] = field(default_factory=dict)
    comments: tuple[str, ...] = ()  # header comments of the source file; written back
    property_order: tuple[str, ...] = ()  # order of columns in the source file; empty: the order of 3DGS

    def __post_init__(self):
        n, k = len(self.means), self.sh.shape[1] if self.sh.ndim == 3 else -1
        if k not in SH_COEFFICIENTS:
            raise SceneError(f"sh has shape {self.sh.shape}; expected (N, K, 3) with K in {SH_COEFFICIENTS}")
        for name, shape in parameter_shapes(n, k).items():
            array = getattr(self, name)
            if array.shape != shape or array.dtype != np.float32 or not array.flags.c_contiguous:
                raise SceneError(
                    f"{name} is {array.dtype}{array.shape}; expected C-contiguous float32{shape}"
                )
        for name, column in self.attributes.items():
            if column.shape != (n,):
                raise SceneError(f"attribute {name} has shape {column.shape}; expected ({n},)")

    @classmethod
    def of(cls, means, log_scales, quats, opacity_logits, sh) -> Scene:
        """From arrays of any real type and memory layout. Raises SceneError for other shapes."""
        arrays = (means, log_scales, quats, opacity_logits, sh)
        return cls(*(np.ascontiguousarray(array, np.float32) for array in arrays))  # type: ignore[arg-type]

    @property
    def count(self) -> int:
        """Number of Gaussians N."""
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return SH_COEFFICIENTS.index(self.sh.shape[1])

    def select(self, index: np.ndarray | slice) -> Scene:
        """The scene with the Gaussians that a boolean mask (N,) marks, or that an integer array lists, in
        this order; or those of a slice, which are not copied if they follow each other."""
        arrays: dict[str, Any] = {
            name: np.ascontiguousarray(getattr(self, name)[index]) for name in PARAMETERS
        }
        attributes = {name: np.ascontiguousarray(column[index]) for name, column in self.attributes.items()}
        return replace(self, **arrays, attributes=attributes)

"""The order in which Gaussians are removed or merged, by the native library.

`native/include/svrgs.h` (svrgs_decimate) is the manual; names, shapes and units here are the same.
"""

from __future__ import annotations

import ctypes as c
from dataclasses import dataclass

import numpy as np

from ..scene.gaussians import Scene, parameter_shapes
from .library import DecimationStruct, MergesStruct, best_level, call_library, check, levels
from .rasterizer import VISIBILITY

REMOVED = np.uint32(2**32 - 1)  # in the place of b: a is removed


@dataclass(frozen=True)
class Merges:
    """S operations, M of them merges. Row N + m is the result of the m-th merge; the other rows are those of
    the scene."""

    a: np.ndarray  # (S,) uint32: row that is removed, or the first row that is merged
    b: np.ndarray  # (S,) uint32: the second row, or REMOVED
    costs: np.ndarray  # (S,) float32: growth of the sum of squared errors over all views, colours in 0..1
    results: dict[str, np.ndarray]  # the arrays of Scene by name, (M, ...) float32


def decimate(
    scene: Scene,
    visibility: np.ndarray,
    middle: np.ndarray,
    unit: float,
    least: int,
    level: str | None = None,
    cancel: np.ndarray | None = None,
) -> Merges:
    """The order of operations that leaves `least` of the N Gaussians, 1 to N.

    visibility: (N, 9) float64, the sums of Rasterizer.add_visibility() over all views. middle: (3,), unit: a
    point and a length of about a pixel, in the scene's units. level: SIMD level that computes costs; default:
    the fastest. cancel: (1,) int32; another thread may set it to 1. Raises NativeError, Cancelled, and
    TypeError for arrays of another type or shape.
    """
    n, steps = scene.count, max(scene.count - least, 0)  # the library refuses a wrong `least`
    shapes = parameter_shapes(n, scene.sh.shape[1])
    request = DecimationStruct(
        n,
        scene.sh.shape[1],
        scene.antialiased,
        *(check(getattr(scene, name), name, shape, np.float32) for name, shape in shapes.items()),
        check(visibility, "visibility", (n, len(VISIBILITY)), np.float64),
        (c.c_double * 3)(*map(float, middle)),
        unit,
        least,
    )
    a, b, costs = np.empty(steps, np.uint32), np.empty(steps, np.uint32), np.empty(steps, np.float32)
    results = {name: np.empty((steps, *shape[1:]), np.float32) for name, shape in shapes.items()}
    out = MergesStruct(*(array.ctypes.data for array in (a, b, costs, *results.values())))
    done, merges = c.c_int64(), c.c_int64()
    flag = None if cancel is None else check(cancel, "cancel", (1,), np.int32)
    number, references = levels()[level or best_level()], map(c.byref, (out, done, merges))
    call_library("svrgs_decimate", number, c.byref(request), flag, *references)
    made = {name: array[: merges.value] for name, array in results.items()}
    return Merges(a[: done.value], b[: done.value], costs[: done.value], made)

"""One scene of several: their Gaussians follow each other."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from .gaussians import Scene, parameter_shapes


def concatenated(scenes: Sequence[Scene], columns: bool = False) -> Scene:
    """All Gaussians of at least one scene in the same coordinates, in the order of the scenes.

    SH coefficients of lower degrees are padded with zeros. The result is antialiased only if all scenes are,
    because one render pass treats all Gaussians alike. columns: with the further attributes of any scene, 0
    where a scene has none of that name and type, and with the comments of the first; else without both.
    """
    first = scenes[0]
    if len(scenes) == 1:
        return first if columns else replace(first, attributes={}, comments=(), property_order=())
    ends = np.cumsum([scene.count for scene in scenes])
    shapes = parameter_shapes(ends[-1], max(scene.sh.shape[1] for scene in scenes))
    arrays: dict[str, Any] = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}

    def copy(scene: Scene, end: int):
        rows = slice(end - scene.count, end)
        for name in shapes.keys() - {"sh"}:
            arrays[name][rows] = getattr(scene, name)
        arrays["sh"][rows, : scene.sh.shape[1]] = scene.sh

    with ThreadPoolExecutor(os.cpu_count()) as threads:  # the memory is new, and most of the time is for that
        list(threads.map(copy, scenes, ends))
    whole = Scene(**arrays, antialiased=all(scene.antialiased for scene in scenes))
    if not columns:
        return whole
    alike = all(scene.property_order == first.property_order for scene in scenes)
    return replace(
        whole,
        attributes=_columns(scenes),
        comments=first.comments,
        property_order=first.property_order if alike else (),
    )


def _columns(scenes: Sequence[Scene]) -> dict[str, np.ndarray]:
    """The further columns of all scenes. Of columns of one name, the type of the first one counts."""
    dtypes: dict[str, np.dtype] = {}
    for scene in scenes:
        for name, column in scene.attributes.items():
            dtypes.setdefault(name, column.dtype)
    columns: dict[str, np.ndarray] = {}
    for name, dtype in dtypes.items():
        parts = []
        for scene in scenes:
            part = scene.attributes.get(name)
            if part is None or part.dtype != dtype:
                part = np.zeros(scene.count, dtype)
            parts.append(part)
        columns[name] = np.concatenate(parts)
    return columns

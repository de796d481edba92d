"""Merges several scenes into one, so that one render shows them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .gaussians import Scene


def merged(scenes: Sequence[Scene]) -> Scene:
    """All Gaussians of at least one scene in the same coordinates, in the order of the scenes. Further
    attributes are left out.

    SH coefficients of lower degrees are padded with zeros. The result is antialiased only if all scenes are,
    because one render pass treats all Gaussians alike.
    """
    coefficients = max(scene.sh.shape[1] for scene in scenes)
    sh = [np.pad(scene.sh, ((0, 0), (0, coefficients - scene.sh.shape[1]), (0, 0))) for scene in scenes]
    arrays = {
        name: np.concatenate([getattr(scene, name) for scene in scenes])
        for name in ("means", "log_scales", "quats", "opacity_logits")
    }
    return Scene(**arrays, sh=np.concatenate(sh), antialiased=all(scene.antialiased for scene in scenes))


def joined(scenes: Sequence[Scene]) -> Scene:
    """As merged(), with further attributes: those of any scene, 0 where a scene has none of that name and
    type. Comments are the first's."""
    kinds = {(name, column.dtype): None for scene in scenes for name, column in scene.attributes.items()}
    columns: dict[str, np.ndarray] = {}
    for name, dtype in kinds:
        parts = [scene.attributes.get(name) for scene in scenes]
        if name not in columns:
            fitting = [
                part if part is not None and part.dtype == dtype else np.zeros(scene.count, dtype)
                for part, scene in zip(parts, scenes, strict=True)
            ]
            columns[name] = np.concatenate(fitting)
    first = scenes[0]
    order = (
        first.property_order if all(scene.property_order == first.property_order for scene in scenes) else ()
    )
    return replace(merged(scenes), attributes=columns, comments=first.comments, property_order=order)

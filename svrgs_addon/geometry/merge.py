"""Merges several scenes into one, so that one render shows them all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene import Scene


def merged(scenes: Sequence[Scene]) -> Scene:
    """All Gaussians of at least one scene in the same coordinates, in the order of the scenes. Further attributes are left out.

    SH coefficients of lower degrees are padded with zeros. The result is antialiased only if all scenes are, because one render
    pass treats all Gaussians alike.
    """
    coefficients = max(scene.sh.shape[1] for scene in scenes)
    sh = [np.pad(scene.sh, ((0, 0), (0, coefficients - scene.sh.shape[1]), (0, 0))) for scene in scenes]
    arrays = {name: np.concatenate([getattr(scene, name) for scene in scenes]) for name in ("means", "log_scales", "quats", "opacity_logits")}
    return Scene(**arrays, sh=np.concatenate(sh), antialiased=all(scene.antialiased for scene in scenes))

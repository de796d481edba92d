"""Several scenes as one, for a picture that holds them all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene import Scene


def merged(scenes: Sequence[Scene]) -> Scene:
    """All Gaussians of scenes in the same coordinates, one scene after the other; further attributes stay behind.

    Lower SH degrees are padded with zeros. One pass knows one low-pass rule: the result counts as antialiased if all are.
    """
    coefficients = max(scene.sh.shape[1] for scene in scenes)
    sh = [np.pad(scene.sh, ((0, 0), (0, coefficients - scene.sh.shape[1]), (0, 0))) for scene in scenes]
    arrays = {name: np.concatenate([getattr(scene, name) for scene in scenes]) for name in ("means", "log_scales", "quats", "opacity_logits")}
    return Scene(**arrays, sh=np.concatenate(sh), antialiased=all(scene.antialiased for scene in scenes))

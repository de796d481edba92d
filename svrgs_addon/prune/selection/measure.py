"""How much a scene needs each Gaussian, and how sure its rank is: attributes of a file.

Pruning removes the Gaussians with the lowest removal error (finetune/saliency.py). The rank of a Gaussian, 0
to 1, is the share of the Gaussians with a lower one. Where it moves little from one look to another, the
decision about the Gaussian is sure.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from ...finetune.saliency import removal_errors
from ...finetune.viewed_scene import ViewedScene
from ...native.rasterizer import Rasterizer
from ...scene.camera import Camera, spaced
from ...scene.gaussians import PARAMETERS, Scene
from ...system.errors import SceneError

EXACT_VIEWS = 8  # views in which float64 is compared: it takes 16 times as long
ERROR, RANK, VIEW, VIEWS, BY_VIEWS, BY_SIZE, BY_PRECISION = NAMES = (
    "removal_error", "removal_rank", "deciding_view", "deciding_views", "rank_spread_views",
    "rank_spread_size", "rank_spread_precision",
)  # fmt: skip
SPREADS = (BY_VIEWS, BY_SIZE, BY_PRECISION)


def measured(scene: Scene, cameras: list[Camera], all_looks: bool = True) -> dict[str, np.ndarray]:
    """The attributes NAMES of each Gaussian, (N,) each, by name. Raises SceneError for fewer than two views.

    removal_error: float32, squared error of the colours without this Gaussian, summed over the views, at the
    size at which pruning looks. removal_rank: float32, its rank by it. deciding_view: int32, number of the
    view with the largest part of it; -1: none sees the Gaussian. deciding_views: float32, how many views
    share it, (sum of e)^2 / sum of e^2. rank_spread_views: float32, how far the rank moves between every
    second view and the others. With all_looks also rank_spread_size, between the size at which pruning looks
    and the full one, and rank_spread_precision, between float32 and float64, in EXACT_VIEWS views.
    """
    if len(cameras) < 2:
        raise SceneError("at least two views are needed to tell how sure a rank is")
    n, viewed = scene.count, ViewedScene.of(scene, cameras)
    halves, squares, largest = np.zeros((2, n)), np.zeros(n), np.zeros(n)
    deciding = np.full(n, -1, np.int32)
    for number, camera in enumerate(cameras):
        errors = removal_errors(replace(viewed, cameras=[camera]))
        halves[number % 2] += errors
        squares += errors**2
        deciding[errors > largest] = number
        np.maximum(largest, errors, out=largest)
    total = halves.sum(axis=0)
    found = {
        ERROR: total.astype(np.float32),
        RANK: _rank(total).astype(np.float32),
        VIEW: deciding,
        VIEWS: np.divide(total**2, squares, out=np.zeros(n), where=squares > 0).astype(np.float32),
        BY_VIEWS: _moved(*halves),
    }
    if all_looks:
        some = replace(viewed, cameras=spaced(cameras, EXACT_VIEWS))
        arrays = {name: getattr(scene, name).astype(np.float64) for name in PARAMETERS}
        precise = SimpleNamespace(**arrays, count=n)
        exact = replace(some, scene=precise, rasterizer=Rasterizer("float64"))
        found |= {
            BY_SIZE: _moved(total, removal_errors(viewed, reduction=1)),
            BY_PRECISION: _moved(removal_errors(some), removal_errors(exact)),
        }
    return found


def summary(attributes: dict[str, np.ndarray]) -> dict[str, float]:
    """What the attributes of measured() say of the whole scene.

    share_of_tenth: of the sum of all removal errors, that of the tenth of the Gaussians with the highest
    ones. deciding_views: median of the Gaussians that a view sees. Of each rank: the value that nine of ten
    Gaussians do not exceed.
    """
    errors, seen = np.sort(attributes[ERROR].astype(np.float64)), attributes[VIEW] >= 0
    return {
        "share_of_tenth": float(errors[-max(1, len(errors) // 10) :].sum() / max(errors.sum(), 1e-300)),
        VIEWS: float(np.median(attributes[VIEWS][seen])) if seen.any() else 0.0,
        **{name: float(np.quantile(attributes[name], 0.9)) for name in SPREADS if name in attributes},
    }


def _moved(errors: np.ndarray, others: np.ndarray) -> np.ndarray:
    """How far the rank of each Gaussian is from that by the other errors, (N,) float32."""
    return np.abs(_rank(errors) - _rank(others)).astype(np.float32)


def _rank(errors: np.ndarray) -> np.ndarray:
    """The share of the Gaussians with a lower error, (N,) float64; the same for equal errors."""
    return np.searchsorted(np.sort(errors), errors) / max(1, len(errors))

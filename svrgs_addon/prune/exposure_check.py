"""Whether the exposure of photographs varies: each is compared with what the splat shows in its view."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..files.images import srgb_to_linear
from ..scene.gaussians import Scene
from ..views.dataset import Dataset
from .compared_views import compared_views

VIEWS = 64  # that are compared, at most
DARK, BRIGHT = 0.05, 0.95  # display values that are compared
LEAST = 0.02  # share of a picture, or of a patch of it, that must have them
PATCHES = 3  # per side of a picture: how far they differ says how exact the picture's own value is
VARIES = 0.05  # EV: with a larger spread, exposure is fitted; photographs that are as far off are counted
NORMAL = 1.4826  # standard deviation over the median absolute deviation


@dataclass(frozen=True)
class Spread:
    """stops: of each photograph that was compared, by how many EV it is brighter than the median of all.
    error: how exact they are, EV. of: how many photographs there are to train on."""

    stops: np.ndarray
    error: float
    of: int

    @property
    def spread(self) -> float:
        """Standard deviation in EV, as outliers do not move it, without that of the errors."""
        found = NORMAL * np.median(np.abs(self.stops)) if len(self.stops) else 0.0
        return math.sqrt(max(0.0, found**2 - self.error**2))

    @property
    def varies(self) -> bool:
        return self.spread > VARIES

    def sentence(self) -> str:
        """For the user, if it varies."""
        off = round(float((np.abs(self.stops) > VARIES).mean()) * self.of)
        return (
            f"exposure varies by ±{self.spread:.2f} EV over {off} of {self.of} photographs, so it is fitted"
        )


def spread_of(scene: Scene, dataset: Dataset) -> Spread:
    """Raises FormatError, SceneError."""
    stops, errors = list[float](), list[float]()
    for photo, shown, comparable in compared_views(scene, dataset, VIEWS):
        brighter = np.where(comparable, _brighter(photo, shown), np.nan)
        if np.isfinite(brighter).mean() > LEAST:
            stops.append(float(np.nanmedian(brighter)))
            errors += _errors(brighter)
    found = np.array(stops)
    error = float(np.median(errors)) if errors else 0.0
    return Spread(found - np.median(found) if stops else found, error, len(dataset.train_indices))


def _brighter(photo: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """By how many EV each pixel of the photograph is brighter, (H, W); NaN where one of them is too dark or
    too bright to tell."""
    both = np.stack([photo, shown]) @ np.full(3, 1 / 3, np.float32)
    light = srgb_to_linear(both.clip(DARK, BRIGHT))
    return np.where(((both > DARK) & (both < BRIGHT)).all(axis=0), np.log2(light[0] / light[1]), np.nan)


def _errors(brighter: np.ndarray) -> list[float]:
    """The standard error of a picture's value, from its patches; empty if there are too few."""
    strips = np.array_split(brighter, PATCHES)
    patches = [patch for strip in strips for patch in np.array_split(strip, PATCHES, axis=1)]
    enough = lambda patch: patch.size and np.isfinite(patch).mean() > LEAST
    values = [np.nanmedian(patch) for patch in filter(enough, patches)]
    return [float(np.std(values, ddof=1) / math.sqrt(len(values)))] if len(values) > 1 else []

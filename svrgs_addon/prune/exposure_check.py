"""Whether the exposure of photographs varies: each is compared with what the splat shows in its view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..files.images import srgb_to_linear
from ..finetune.view_order import photo_of
from ..native.rasterizer import Rasterizer
from ..render.metrics.evaluate import picture_options
from ..scene.camera import evenly
from ..scene.gaussians import Scene
from ..views.dataset import Dataset

VIEWS, SIDE = 100, 200  # views that are compared, at most, and their longer side in pixels, about
DARK, BRIGHT, LEAST = (
    0.05,
    0.95,
    0.02,
)  # display values that are compared; share of a picture that must have them
VARIES = 0.05  # EV: with a larger spread, exposure is fitted; photographs that are as far off are counted
NORMAL = 1.4826  # standard deviation over the median absolute deviation


@dataclass(frozen=True)
class Spread:
    """stops: of each photograph that was compared, by how many EV it is brighter than the median of all. of:
    how many photographs there are to train on."""

    stops: np.ndarray
    of: int

    @property
    def spread(self) -> float:
        """Standard deviation in EV, as outliers do not move it."""
        return float(NORMAL * np.median(np.abs(self.stops))) if len(self.stops) else 0.0

    @property
    def varies(self) -> bool:
        return self.spread > VARIES

    def sentence(self) -> str:
        """For the user."""
        if not self.varies:
            return f"the exposure of the photographs is even (±{self.spread:.2f} EV), so it is not fitted"
        off = round(float((np.abs(self.stops) > VARIES).mean()) * self.of)
        return (
            f"exposure varies by ±{self.spread:.2f} EV over {off} of {self.of} photographs, so it is fitted"
        )


def spread_of(scene: Scene, dataset: Dataset) -> Spread:
    """Raises FormatError, SceneError."""
    rasterizer, options, found = Rasterizer(), picture_options(scene, dataset.background), []
    for index in evenly(dataset.train_indices, VIEWS):
        camera = dataset.cameras[index]
        factor = max(1, max(camera.width, camera.height) // SIDE)
        camera = camera.reduced(factor)
        photo = photo_of(camera, dataset.image(index), np.dtype(np.float32), factor)
        shown = rasterizer.forward(scene, camera, options)["rgb"]
        both = np.stack([photo.mean(axis=2), shown.mean(axis=2)])
        usable = ((both > DARK) & (both < BRIGHT)).all(axis=0)
        if usable.mean() > LEAST:
            photo_light, scene_light = srgb_to_linear(both[:, usable])
            found.append(float(np.median(np.log2(photo_light / scene_light))))
    stops = np.array(found)
    return Spread(stops - np.median(stops) if len(stops) else stops, len(dataset.train_indices))

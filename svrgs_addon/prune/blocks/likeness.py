"""How much a divided scene looks like the original: on views that were held out, against the original's own
pictures or photographs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from statistics import fmean

import numpy as np

from ...files.images import to_float
from ...native.rasterizer import Rasterizer
from ...render.metrics import flip, psnr, ssim
from ...render.metrics.evaluate import picture_options, rounded_to_8_bits
from ...scene.camera import Camera, evenly
from ...views.dataset import Dataset
from .divided import Divided, Tell
from .visible import seen

EQUAL = 100.0  # dB, counts as the PSNR of equal pictures
LOOKS = 8  # views, at most


class Likeness:
    """How much divided scenes look like the original in LOOKS of the views. Its pictures are rendered when
    they are first needed."""

    def __init__(
        self,
        original: Divided,
        views: Sequence[Camera],
        told: Callable[[str], Tell] = lambda _: lambda *_: None,
    ):
        """told: of the name of a step."""
        self.views, self.background = evenly(views, LOOKS), (0.0, 0.0, 0.0)
        self._original, self._told = original, told

    def psnrs(self, scene: Divided, step: str = "compare") -> list[float]:
        """PSNR in dB of each view. Raises SplatError."""
        return [min(psnr(one, other), EQUAL) for one, other in self._pairs(scene, step)]

    def psnr(self, scene: Divided) -> float:
        """Mean PSNR in dB; NaN without views. Raises SplatError."""
        return fmean(self.psnrs(scene)) if self.views else math.nan

    def measured(self, scene: Divided) -> dict[str, float]:
        """Means over the views of psnr (dB), ssim and flip; NaN without views. Raises SplatError."""
        pairs = list(self._pairs(scene, "measure"))
        metrics: dict[str, Callable[[np.ndarray, np.ndarray], float]] = {
            "psnr": lambda one, other: min(psnr(one, other), EQUAL),
            "ssim": ssim,
            "flip": flip,
        }
        return {
            name: fmean(metric(*pair) for pair in pairs) if pairs else math.nan
            for name, metric in metrics.items()
        }

    @cached_property
    def _originals(self) -> list[np.ndarray]:
        return list(pictures_of(self._original, self.views, self.background, self._told("look")))

    def _pairs(self, scene: Divided, step: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        originals = self._originals
        return zip(pictures_of(scene, self.views, self.background, self._told(step)), originals, strict=True)


class PhotographLikeness(Likeness):
    """The same against photographs: on test views, or on training views if none is held out."""

    def __init__(self, dataset: Dataset, told: Callable[[str], Tell] = lambda _: lambda *_: None):
        """told: as for Likeness."""
        self._dataset, self._told = dataset, told
        self._indices = evenly(dataset.test_indices or dataset.train_indices, LOOKS)
        self.views, self.background = [dataset.cameras[index] for index in self._indices], dataset.background

    @cached_property
    def _originals(self) -> list[np.ndarray]:
        return [to_float(self._dataset.image(index)) for index in self._indices]


def pictures_of(
    divided: Divided,
    cameras: Sequence[Camera],
    background: tuple[float, float, float],
    tell: Tell = lambda *_: None,
) -> Iterator[np.ndarray]:
    """What each view shows, (H, W, 3), rounded to 8 bits. Raises SplatError."""
    rasterizer = Rasterizer()
    for number, camera in enumerate(cameras):
        tell(f"looks at the view {camera.name or number}", number / len(cameras))
        scene, _ = seen(divided, camera, rasterizer)
        yield rounded_to_8_bits(rasterizer.forward(scene, camera, picture_options(scene, background))["rgb"])

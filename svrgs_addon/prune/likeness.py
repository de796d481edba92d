"""How much scenes look like the original in some views: against its own pictures, or against photographs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from statistics import fmean
from typing import Any

import numpy as np

from ..files.images import to_float
from ..finetune.quality import quality_views
from ..render.metrics import psnr
from ..render.metrics.allowed_loss import ASSUMED, EQUAL
from ..render.metrics.evaluate import (
    Renderable,
    Renderer,
    mean_figures,
    picture_options,
    quality_of_view,
    rounded_to_8_bits,
)
from ..render.metrics.measures import almost_empty, with_error
from ..render.metrics.worst import Worst, worst_of
from ..scene.camera import Camera, evenly
from ..system.errors import SceneError
from ..views.dataset import Dataset
from ..views.rendered import PHOTOGRAPHED
from .belonging import measuring_notes
from .blocks.divided import ProgressOf

Colour = tuple[float, float, float]
VIEWS = 8  # of a scene that is divided into blocks, at most
SILENT: ProgressOf = lambda _: lambda *_: None

NO_VIEWS = (
    "an allowed loss is measured in views that are held out, and none shows the splat: give more cameras, or"
    " --target"
)


class Likeness:
    """Compares scenes with the pictures of the original, which are rendered when they are first needed.

    Scenes are in memory or divided, as their renderer takes them. Pictures are rounded to 8 bits. Views that
    show almost nothing of the original are left out, because any two pictures are alike there.
    """

    def __init__(
        self,
        original: Renderable,
        views: Sequence[Camera],
        renderer_of: Callable[[], Renderer],
        background: Colour = (0.0, 0.0, 0.0),
        progress_of: ProgressOf = SILENT,
        others: Sequence[Camera] = (),
        lpips: Callable | None = None,
    ):
        """renderer_of: gives what renders the views once. background: display sRGB 0..1. progress_of: of
        the name of a step. others: views of deciding. lpips: (picture, original) -> LPIPS; None: not
        measured."""
        self._views, self._original, self._background, self._others = views, original, background, others
        self._lpips = lpips
        self._renderer_of, self._progress_of = renderer_of, progress_of

    @cached_property
    def deciding(self) -> Likeness:
        """In the other views: in those in which something was decided, nothing is measured."""
        return Likeness(self._original, self._others, self._renderer_of, self._background, self._progress_of)

    def psnrs(self, scene: Renderable, step: str = "compare") -> list[float]:
        """PSNR in dB of each view; infinite where the pictures are equal. Raises SplatError."""
        pairs = self._pairs(scene, step)
        return [psnr(picture, original, camera.valid_share) for camera, picture, original, _ in pairs]

    def psnr(self, scene: Renderable) -> float:
        """Mean PSNR in dB, that of equal pictures as EQUAL, of at least one view. Raises SplatError."""
        return fmean(min(value, EQUAL) for value in self.psnrs(scene))

    def quality(self, scene: Renderable, measure: str) -> float:
        """What an allowed loss is taken from, the higher the better: mean quality_of_view(); PSNR as if the
        original had the error PHOTOGRAPHED. measure: a key of MEASURES. Raises SplatError."""
        if measure == "psnr":
            return assumed_psnr(self.psnrs(scene))
        return fmean(
            quality_of_view(picture, original, camera, measure, 0.0, number)
            for number, (camera, picture, original, _) in enumerate(self._pairs(scene, "compare"))
        )

    def worst(self, scene: Renderable) -> Worst | None:
        """Where a scene differs most. Raises SplatError."""
        pairs = self._pairs(scene, "compare")
        return worst_of((camera.name, original, picture) for camera, picture, original, _ in pairs)

    def measured(self, scene: Renderable) -> dict[str, Any]:
        """Means over the views: psnr (dB, that of equal pictures as EQUAL), ssim, lpips (None if it is not
        measured), flip, and ms_per_frame, the milliseconds to render one; None without views. Raises
        SplatError."""
        milliseconds: list[float] = []

        def pairs() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray | None]]:
            for camera, picture, original, seconds in self._pairs(scene, "measure"):
                milliseconds.append(1e3 * seconds)
                yield picture, original, camera.valid

        figures = mean_figures(pairs(), self._lpips, EQUAL)
        return {**figures, "ms_per_frame": fmean(milliseconds) if milliseconds else None}

    @property
    def views(self) -> list[Camera]:
        """Those that are compared. Raises SplatError."""
        return [camera for camera, _ in self._originals]

    def refuse_without_views(self):
        """Raises SceneError if there are no views in which an allowed drop could be measured."""
        if not self.views:
            raise SceneError(NO_VIEWS)

    def notes(self) -> list[str]:
        """What the user must know of the views. Raises SplatError."""
        return measuring_notes(len(self._originals), len(self._views))

    @cached_property
    def _originals(self) -> list[tuple[Camera, np.ndarray]]:
        pictures = self._pictures(self._original, self._views, "original")
        return [
            (camera, picture)
            for camera, (picture, _) in zip(self._views, pictures, strict=True)
            if not almost_empty(picture, self._background)
        ]

    def _pairs(self, scene: Renderable, step: str) -> Iterator[tuple[Camera, np.ndarray, np.ndarray, float]]:
        """Of each view its camera, the picture of the scene, that of the original, and the seconds of the
        first one."""
        pictures = self._pictures(scene, self.views, step)
        for (picture, seconds), (camera, original) in zip(pictures, self._originals, strict=True):
            yield camera, picture, original, seconds

    def _pictures(
        self, scene: Renderable, views: Sequence[Camera], step: str
    ) -> Iterator[tuple[np.ndarray, float]]:
        """What each view shows, (H, W, 3), rounded to 8 bits, and the seconds to render it."""
        renderer, progress = self._renderer_of(), self._progress_of(step)
        options = picture_options(scene, self._background)
        for number, camera in enumerate(views):
            progress(f"renders the view {camera.name or number}", number / len(views))
            started = time.perf_counter()
            picture = rounded_to_8_bits(renderer.forward(scene, camera, options)["rgb"])
            yield picture, time.perf_counter() - started


class PhotographLikeness(Likeness):
    """The same against the photographs of test views; of training views, if none is held out."""

    def __init__(
        self,
        dataset: Dataset,
        renderer_of: Callable[[], Renderer],
        progress_of: ProgressOf = SILENT,
        indices: Sequence[int] | None = None,
        lpips: Callable | None = None,
    ):
        """As for Likeness. indices: of the views; None: VIEWS of those that measure."""
        self.dataset, self._lpips = dataset, lpips
        self._indices = indices or evenly(dataset.test_indices or dataset.train_indices, VIEWS)
        self._views, self._background = [dataset.cameras[i] for i in self._indices], dataset.background
        self._renderer_of, self._progress_of = renderer_of, progress_of

    @cached_property
    def deciding(self) -> Likeness:
        decide = evenly(quality_views(self.dataset), VIEWS)
        return PhotographLikeness(self.dataset, self._renderer_of, self._progress_of, decide)

    @cached_property
    def _originals(self) -> list[tuple[Camera, np.ndarray]]:
        photographs = (to_float(self.dataset.image(index)) for index in self._indices)
        return list(zip(self._views, photographs, strict=True))


def assumed_psnr(psnrs: Sequence[float], errors: Sequence[float] | None = None) -> float:
    """Mean PSNR in dB if the original had the error PHOTOGRAPHED. psnrs: against the original, of each view.
    errors: further mean squared errors of the views."""
    return fmean(
        with_error(value, PHOTOGRAPHED + error)
        for value, error in zip(psnrs, errors or [0.0] * len(psnrs), strict=True)
    )


def assumed_drop(psnr: float) -> float:
    """The drop in dB of a result with this mean PSNR against the original, if that had the error
    PHOTOGRAPHED."""
    return ASSUMED - with_error(psnr, PHOTOGRAPHED)

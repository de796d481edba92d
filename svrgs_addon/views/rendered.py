"""A dataset whose photographs are a scene's own pictures, rendered when they are asked for."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..files.images import to_bytes
from ..native.rasterizer import Rasterizer, RenderOptions
from ..scene.camera import Camera
from ..scene.gaussians import PARAMETERS, Scene
from .dataset import Dataset
from .rig.around import middle_and_radius

MOST_EXTENT = 6.0  # of the radius around the mass of a scene; around scenes of usual size it is 2 to 5 of it
PHOTOGRAPHED = 1e-3  # mean squared error of a usual splat against photographs of what it shows: 30 dB


@dataclass(kw_only=True)
class RenderedDataset(Dataset):
    """Views of a scene. Pictures are rounded to 8 bits, as photographs are, and cached as those."""

    scene: Scene
    facts: dict = field(default_factory=dict)  # what a JSON result says about the cameras
    rasterizer: Any = field(default_factory=Rasterizer, repr=False)  # what renders the scene
    _rendering: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @classmethod
    def of(cls, scene: Any, train: list[Camera], test: list[Camera], **more: Any) -> RenderedDataset:
        """The dataset of some views to train on and others to test on. scene: a Scene, or what
        more["rasterizer"] renders. more: further fields."""
        points, colors = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
        views = list(range(len(train) + len(test)))
        split = views[: len(train)], views[len(train) :]
        return cls(train + test, points, colors, *split, scene=scene, **more)

    @property
    def extent(self) -> float:
        """As of photographs, but no larger than MOST_EXTENT times the scene: cameras that are given may stand
        far away, and steps of positions are in proportion to the extent."""
        return min(super().extent, MOST_EXTENT * middle_and_radius(self.scene)[1])

    @property
    def unexplained(self) -> float:
        """What it does not explain of the photographs that it was trained on: PHOTOGRAPHED."""
        return PHOTOGRAPHED

    def inputs(self) -> Iterator[bytes]:
        yield from super().inputs()
        digest = hashlib.sha256()
        for name in PARAMETERS:
            digest.update(np.ascontiguousarray(getattr(self.scene, name)).data)
        yield digest.digest()

    def _pixels(self, index: int) -> np.ndarray:
        options = RenderOptions(
            antialiased=self.scene.antialiased, background=self.background, picture_only=True
        )
        with self._rendering:
            rgb = self.rasterizer.forward(self.scene, self.cameras[index], options)["rgb"]
            return to_bytes(rgb)

"""What a method may read of a run. Run (run.py) is the only implementation; methods and controllers know no more of it than this."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..camera import Camera
from ..native import Rasterizer, RenderOptions
from .model import Model
from .settings import Settings

Keep = np.ndarray | None  # (N,) bool, True for the Gaussians that stay; None: all


class RunView(Protocol):
    """A run between two steps."""

    model: Model
    iteration: int  # steps done
    initial_count: int  # Gaussians at the start
    target: int  # Gaussians to keep; 0: none asked for, or not known yet

    @property
    def settings(self) -> Settings:
        """The numbers of the run."""

    @property
    def extent(self) -> float:
        """Size of the scene, world units: Dataset.extent."""

    @property
    def strength(self) -> float:
        """Factor on the weights of the method's terms: StrengthController.strength, or 1."""

    @property
    def psnr_before(self) -> float:
        """PSNR in dB on a few training views before the first step. Known where the settings allow a drop, else 0."""

    @property
    def training_cameras(self) -> list[Camera]:
        """The cameras of all training views."""

    @property
    def rasterizer(self) -> Rasterizer:
        """For scores. A step overwrites its buffers."""

    @property
    def score_options(self) -> RenderOptions:
        """Options for scores: all SH bands, no masks."""

    def psnr(self, kept: Keep) -> float:
        """PSNR in dB on a few training views, of the Gaussians `kept`."""

    def current_mask(self) -> Keep:
        """The Gaussians that would stay if the method decided now and had no target."""

    def expected_count(self) -> float:
        """The number of Gaussians that the learned masks expect to stay."""

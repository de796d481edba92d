"""The protocol through which methods and controllers read a run. Run (run.py) is its only implementation."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from .model import Model
from .settings import Settings
from .viewed_scene import ViewedScene

Keep = np.ndarray | None  # (N,) bool, True for the Gaussians that stay; None: all


class RunView(Protocol):
    """The state of a run between two steps."""

    model: Model
    iteration: int  # steps done
    initial_count: int  # Gaussians at the start
    target: int  # Gaussians to keep; 0: no target, or not known yet

    @property
    def plan(self) -> Settings:
        """The numbers of the run."""

    @property
    def extent(self) -> float:
        """Size of the scene in world units (Dataset.extent)."""

    @property
    def strength(self) -> float:
        """Factor on the weights of the method's terms (StrengthController.strength), or 1."""

    @property
    def quality_before(self) -> float:
        """quality(None) before the first step. 0 if the settings allow no loss: then it is not measured."""

    @property
    def viewed(self) -> ViewedScene:
        """The model in all training views, for scores: with all SH bands and no spatial mask, by the engine's
        rasterizer, whose buffers the next step overwrites."""

    @property
    def own(self) -> Keep:
        """(N,) bool: the Gaussians that a target counts (Settings.own). None: all."""

    @property
    def protected(self) -> Keep:
        """(N,) bool: Gaussians that stay as they are: not its own, unless masks are learned. None: none."""

    def quality(self, kept: Keep) -> float:
        """What an allowed loss is taken from (mean_quality()), the higher the better: PSNR in dB, or minus
        FLIP or LPIPS, on a few views (quality_views), rendered with the Gaussians `kept` (N,) bool; None:
        with all."""

    def current_mask(self) -> Keep:
        """(N,) bool: the Gaussians that would stay if the method decided now and had no target."""

    def expected_count(self) -> float:
        """Expected number of its own Gaussians under the learned masks: the sum of their probabilities."""

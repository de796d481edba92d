"""Base class of methods that rank: one cut keeps those of highest score, as the target; then recovery."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene.gaussians import Scene
from ..masks import refuse_emptying
from ..run_view import Keep, RunView
from ..scores import top
from ..settings import Settings
from ..viewed_scene import ViewedScene
from .base import Method


@dataclass
class Ranked(Method):
    """A method that ranks."""

    ranks: bool = True

    def ranking_passes(self, settings: Settings, steps: int, share: float) -> list[tuple[float, float]]:
        return [(0.0, share)]

    def cut(self, viewed: ViewedScene, count: int) -> np.ndarray:
        """(N,) bool: the `count` Gaussians that stay."""
        return top(self.score(viewed), count)

    def reduced(self, viewed: ViewedScene, count: int) -> Scene:
        keep = self.cut(viewed, count)
        refuse_emptying(keep, viewed.scene.count, count)
        return viewed.scene.select(keep)

    def final_mask(self, run: RunView) -> Keep:
        return self.cut(run.viewed, run.target)

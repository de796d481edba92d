"""Removals and merges in the order of what they change in the pictures (finetune/decimate/order.py), in one
cut; a recovery with larger rates follows.

Merged Gaussians start where one pair is best replaced, so all values are trained on: the rates are those of
refit.py, and fall more slowly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...scene.camera import evenly
from ...scene.gaussians import PARAMETERS, Scene
from ..decimate.order import Order, order_of, visibility_sums
from ..refit import FASTER, LAST, POSITION, middle_scale, pace_at
from ..run_view import Keep, RunView
from ..settings import Phase, Rates
from ..viewed_scene import ViewedScene
from .base import Method

MAX_VIEWS = 32  # training views in which the order is measured
RATE_FALLS = 16  # in the recovery


@dataclass
class Merge(Method):
    ranks: bool = True
    merges: bool = True
    middle: float = 0.0  # state: middle scale of the Gaussians after the cut
    kept: float = 1.0  # state: share of the Gaussians that the cut leaves

    def recovering(self, steps: int, *_: float) -> list[Phase]:
        rates = Rates(decay=LAST ** (1 / RATE_FALLS), decay_every=max(1, steps // RATE_FALLS))
        return [replace(phase, rates=rates) for phase in super().recovering(steps)]

    def rates(self, run: RunView, phase: Phase, number: int) -> dict[str, float]:
        """After the cut, positions change by fractions of the middle scale, whatever the extent."""
        rates = super().rates(run, phase, number)
        if phase.active:
            return rates
        self.middle = self.middle or middle_scale(run.model.log_scales)
        pace = pace_at(self.kept)
        rates |= {name: pace * factor * rates[name] for name, factor in FASTER.items()}
        falls = number // phase.rates.decay_every
        return rates | {"means": pace * POSITION * self.middle * phase.rates.decay**falls}

    def reduced(self, viewed: ViewedScene, count: int) -> Scene:
        count = min(count, viewed.scene.count)
        return self._order(viewed.scene, viewed, count).at(count)

    def final_mask(self, run: RunView) -> Keep:
        """The Gaussians that stay at the end of training; merged ones are added to the model."""
        model, count = run.model, min(run.target, run.model.count)
        arrays = Scene.of(*(getattr(model, name) for name in PARAMETERS))
        scene = replace(arrays, antialiased=model.antialiased)
        rows, made = self._order(scene, run.viewed, count).rows_at(count)
        keep = np.zeros(model.count, bool)
        keep[rows] = True
        model.append(made)
        return np.concatenate([keep, np.ones(len(made["means"]), bool)])

    def _order(self, scene: Scene, viewed: ViewedScene, count: int) -> Order:
        """The order that leaves `count`, by some of the views, evenly spread in the list. viewed: has the
        arrays of the scene."""
        self.kept = count / scene.count
        some = replace(viewed, cameras=evenly(viewed.cameras, MAX_VIEWS))
        return order_of(scene, visibility_sums(some, pictures=False)[0], count)

    def state(self) -> dict:
        return {"middle": self.middle, "kept": self.kept}

    def restore(self, state: dict):
        self.middle, self.kept = state["middle"], state["kept"]


METHODS = (
    Merge(
        "merge",
        "removes and merges Gaussians, in one cut, by what each operation changes in the pictures",
        27,
        "Merging",
        source="this project",
    ),
)

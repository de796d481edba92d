"""What a method may do otherwise than plain 3DGS. The loop calls these hooks and knows no method by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...camera import Camera
from ...native import Rasterizer, RenderOptions
from ...scene import Scene
from ..model import Model
from ..settings import Densify, Phase, Rates, Settings, recovery_phase

if TYPE_CHECKING:
    from ..loop import Run

Keep = np.ndarray | None  # (N,) bool; None: all


@dataclass
class Method:
    """Plain 3DGS: every step minimises the image loss alone, nothing is pruned beside what 3DGS itself drops.

    One object a run: what it learns about the run and must survive a checkpoint is in state().
    """

    lambda_f: float = 0.0  # default weight of mean F^2; 0: the method has no spatial mask
    lambda_m: float = 0.0  # default weight of the method's term of all masks
    mask_kind: str = "none"  # spatial mask and gradient while masks are learned: a name of native.MASK_KINDS
    mask_init: float = 9.0  # existence logit at the start
    share: float = 0.0  # of the Gaussians, kept where no target is asked for
    prunes: bool = True
    learns_masks: bool = False
    ranks: bool = False  # decides by score() alone
    holds_drop: bool = False  # can stop where settings.max_drop dB are lost
    drop_held_by: str = ""  # the method that takes over in pruning where max_drop is asked for; empty: itself
    first_cut: bool = False  # pruning a trained scene starts with what contributes next to nothing to any view

    # --- the schedule

    def train_phases(self, iterations: int, recovery: int, densify: Densify, coarse_until: int) -> list[Phase]:
        """`svrgs train`: 3DGS from the sparse points, the method at work all the time or at its end, and recovery."""
        train = Phase("train", iterations, Rates(), densify, active=self.prunes, sh_every=1_000, coarse_until=coarse_until)
        return [train, *_recovery(recovery, Rates().at(iterations, 1.0)["means"])]

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        """`svrgs prune`: of a method that is not at work on a trained scene, recovery alone."""
        return _recovery(recovery)

    def weights(self, trained: bool) -> tuple[float, float]:
        """Default lambda_f and lambda_m; trained: the run starts from a trained scene."""
        return self.lambda_f, self.lambda_m

    def weighs(self, settings: Settings) -> bool:
        """Whether settings.lambda_f has a say in such a run."""
        return self.lambda_f > 0

    # --- a step of an active phase

    def enter(self, model: Model, settings: Settings):
        """Before each step: gives the model the parameters the method learns, where it has not got them."""

    def terms(self, run: Run, phase: Phase, number: int) -> dict:
        """Fields of engine.Step in which step `number` of the phase differs from a plain one."""
        return {}

    # --- pruning

    def survivors(self, run: Run) -> Keep:
        """What a pruning event spares; densification is one too."""
        return None

    def after_step(self, run: Run, phase: Phase, number: int) -> Keep:
        """What is left after a step outside densification, and after the phase's last."""
        due = phase.prune_every and (number == phase.steps or number % phase.prune_every == 0)
        return self.survivors(run) if due else None

    def decided(self, run: Run) -> Keep:
        """What stays when an active phase ends."""
        return None

    def existing(self, model: Model) -> Keep:
        """What would stay if it ended now and no target were asked for."""
        return None

    def expected(self, model: Model) -> float:
        """How many Gaussians exist, as far as masks have decided; of methods that learn masks."""
        raise NotImplementedError

    def score(self, scene: Scene | Model, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> np.ndarray:
        """(N,) importance of every Gaussian to the cameras' views; of methods that rank."""
        raise NotImplementedError

    # --- checkpoints

    def state(self) -> dict:
        """What a resumed run must know, as JSON holds it."""
        return {}

    def restore(self, state: dict):
        """Takes up what state() gave."""


def _recovery(steps: int, *rates: float) -> list[Phase]:
    return [recovery_phase(steps, *rates)] if steps else []

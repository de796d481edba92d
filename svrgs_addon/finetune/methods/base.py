"""What a method may do that plain 3DGS does not. The run calls these hooks and knows no method by name."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...camera import Camera
from ...native import Rasterizer, RenderOptions
from ...scene import Scene
from ..model import Model
from ..run_view import Keep, RunView
from ..settings import Densify, Phase, Rates, Settings, recovery_phase

__all__ = ["Keep", "Method", "RunView"]

LEARN = "Learning which Gaussians are needed"


@dataclass
class Method:
    """Plain 3DGS: every step minimises the image loss alone, and nothing is pruned but what 3DGS itself prunes.

    Each run has its own object. What it learns about the run, and must survive a checkpoint, is in state().
    """

    name: str  # of --method
    help: str = field(repr=False)  # one sentence: what it does
    number: int = field(repr=False)  # of Blender's menu, stored in .blend files: never changed, never used again
    label: str = field(default="", repr=False)  # in Blender's menu; empty: the name
    lambda_f_help: str = field(default="", repr=False)  # what lambda_F means here
    lambda_f: float = 0.0  # default weight of mean F^2; 0: the method has no spatial mask
    lambda_m: float = 0.0  # default weight of the method's term over all masks or opacities
    mask_kind: str = "none"  # spatial mask and its gradient while masks are learned: a name of native.mask_kinds()
    mask_init: float = 9.0  # existence logit at the start
    share: float = 0.0  # share of the Gaussians to keep where no target is asked for
    prunes: bool = True
    learns_masks: bool = False
    ranks: bool = False  # decides by score() alone
    supports_max_drop: bool = False  # can stop at a drop of settings.max_drop dB
    max_drop_method: str = ""  # the method that prunes instead where a drop is asked for; empty: itself
    first_cut: bool = False  # pruning starts with the Gaussians that contribute next to nothing to any view
    image_weights: tuple[float, float] = (0.8, 0.2)  # of L1 and of 1 - SSIM

    # --- the schedule

    def train_phases(self, iterations: int, recovery: int, densify: Densify, coarse_until: int) -> list[Phase]:
        """`svrgs train`: 3DGS from the sparse points, the method active all the time, then recovery."""
        train = Phase(
            "train", iterations, Rates(), densify, active=self.prunes, sh_every=1_000, coarse_until=coarse_until, label="Training from the photographs"
        )
        return [train, *_recovery(recovery, Rates().at(iterations, 1.0)["means"])]

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        """`svrgs prune`: recovery alone, for a method that decides at once."""
        return _recovery(recovery)

    def weights(self, trained: bool) -> tuple[float, float]:
        """Default lambda_F and lambda_m. trained: the run starts from a trained scene."""
        return self.lambda_f, self.lambda_m

    def uses_lambda_f(self, settings: Settings) -> bool:
        """Whether settings.lambda_f has an effect on such a run."""
        return self.lambda_f > 0

    # --- a step of an active phase

    def budget(self, run: RunView) -> int:
        """The Gaussians to keep where none is asked for; called before the first step. 0: the method needs none."""
        return 0

    def prepare(self, run: RunView, phase: Phase, number: int):
        """Before step `number` (from 1): changes what the method needs, in the model and in itself."""

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        """The fields of engine.Step that differ from a plain step. Changes nothing."""
        return {}

    # --- pruning

    def survivors(self, run: RunView) -> Keep:
        """The Gaussians that stay after a pruning event. Densification is one, too."""
        return None

    def after_step(self, run: RunView, phase: Phase, number: int) -> Keep:
        """The Gaussians that stay after a step outside densification."""
        due = phase.prune_every and (number == phase.steps or number % phase.prune_every == 0)
        return self.survivors(run) if due else None

    def final_mask(self, run: RunView) -> Keep:
        """The Gaussians that stay when an active phase ends."""
        return None

    def current_mask(self, model: Model) -> Keep:
        """The Gaussians that would stay if the method decided now and had no target."""
        return None

    def expected_count(self, model: Model) -> float:
        """The number of Gaussians that the learned masks expect to stay; of methods that learn masks."""
        raise NotImplementedError

    def score(self, scene: Scene | Model, cameras: list[Camera], rasterizer: Rasterizer, options: RenderOptions) -> np.ndarray:
        """(N,): importance of every Gaussian, the higher the more important; of methods that rank."""
        raise NotImplementedError

    # --- checkpoints

    def state(self) -> dict:
        """What a resumed run must know, as JSON."""
        return {}

    def restore(self, state: dict):
        """Takes over what state() returned."""


def learning_phase(steps: int, rates: Rates, prune_every: int) -> list[Phase]:
    """The active phase of `svrgs prune`; none for 0 steps."""
    return [Phase("prune", steps, rates, active=True, prune_every=prune_every, label=LEARN)] if steps else []


def _recovery(steps: int, *rates: float) -> list[Phase]:
    return [recovery_phase(steps, *rates)] if steps else []

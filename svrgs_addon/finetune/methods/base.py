"""The base class of methods. Its hooks are where one may differ from plain 3DGS; a run knows none by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ...scene.gaussians import Scene
from ..model import Model
from ..run_view import Keep, RunView
from ..settings import Densify, Phase, Rates, Settings, rates_for, recovery_phase
from ..viewed_scene import ViewedScene

# the SH degree rises after so many steps of training; at least after this part of them
SH_EVERY, SH_PARTS = 1_000, 7
# labels of pruning phases: masks or events decide; opacities fade
DECIDE, REMOVE = "Deciding which Gaussians to remove", "Removing Gaussians"


@dataclass
class Method:
    """Plain 3DGS: every step minimises the image loss alone, and only the pruning of 3DGS itself takes place.

    Each run has its own object. state() returns what a checkpoint must hold of it. CONTRIBUTING.md says how
    to add a method.
    """

    name: str  # value of --method
    # what the method does, in one sentence without a full stop: shown in --help and in Blender's menu
    help: str = field(repr=False)
    # number in Blender's menu, stored in .blend files: never change it, never use it again
    number: int = field(repr=False)
    label: str = field(repr=False)  # how menus and --help call it
    source: str = field(default="", repr=False, kw_only=True)  # the paper, for `svrgs methods`
    # number of steps that win back half of a removal (quality.py), measured; 0: unknown, nothing is foreseen
    halved: float = field(default=0.0, repr=False, kw_only=True)
    lambda_f_help: str = field(default="", repr=False)  # the meaning of lambda_F for this method
    lambda_f: float = 0.0  # default of lambda_F; 0: the method does not use it
    lambda_m: float = 0.0  # default weight of the method's term over all masks or opacities
    mask_kind: str = "none"  # spatial mask and its gradient in active phases: a name of native.mask_kinds()
    mask_init: float = 9.0  # existence logit at the start
    share: float = 0.0  # share of the Gaussians to keep without a target
    prunes: bool = True
    learns_masks: bool = False
    # bound on the factor that strength_controller.py puts on lambda_F and lambda_m
    largest_strength: float = 1e4
    ranks: bool = False  # decides by score() alone
    # what score() gives, unless a subclass defines that
    ranking: Callable[[ViewedScene], np.ndarray] | None = field(default=None, repr=False)
    merges: bool = False  # its cut merges Gaussians, too
    supports_max_loss: bool = False  # --max-drop is allowed
    first_cut: bool = False  # `svrgs prune` starts by removing Gaussians whose alpha T is small in every view
    image_weights: tuple[float, float] = (0.8, 0.2)  # weights of the mean absolute error and of 1 - SSIM

    # --- the schedule

    def train_phases(
        self, iterations: int, recovery: int, densify: Densify, coarse_until: int
    ) -> list[Phase]:
        """The phases of `svrgs train`: 3DGS from sparse points, the method always active; then recovery."""
        rates = Rates(position_steps=max(1, min(iterations, Rates.position_steps)))
        train = Phase(
            "train",
            iterations,
            rates,
            densify,
            active=self.prunes,
            sh_every=sh_every(iterations),
            coarse_until=coarse_until,
            label="Training from the photographs",
        )
        return [train, *self.recovering(recovery, rates.at(iterations, 1.0)["means"])]

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        """The phases of `svrgs prune`."""
        return [*(self.deciding(iterations, prune_every) if iterations else []), *self.recovering(recovery)]

    def deciding(self, iterations: int, prune_every: int) -> list[Phase]:
        """The phase in which the method decides. Here none: it decides before the steps."""
        return []

    def recovering(self, steps: int, *rates: float) -> list[Phase]:
        """The recovery, an empty list for 0 steps. rates: that of position at its start."""
        return [recovery_phase(steps, *rates)] if steps else []

    def paced(self, phases: list[Phase]) -> list[Phase]:
        """The phases, with the learning rates that their numbers of steps call for. It depends on nothing
        else, so it may be called again. Here those of training from points."""
        paced = lambda phase: replace(phase, rates=rates_for(phase.steps, phase.rates))
        return [paced(phase) if phase.densify else phase for phase in phases]

    def weights(self, trained: bool) -> tuple[float, float]:
        """Defaults of lambda_F and lambda_m. trained: whether the run starts from a trained scene."""
        return self.lambda_f, self.lambda_m

    def uses_lambda_f(self, settings: Settings) -> bool:
        """Whether settings.lambda_f has an effect in a run with these settings."""
        return self.lambda_f > 0

    def ranking_passes(self, settings: Settings, steps: int, share: float) -> list[tuple[float, float]]:
        """The ranking passes of an active phase that keeps the share `share` of the Gaussians: each measures
        all Gaussians in all training views. (share of the steps before it, roughly the share of the Gaussians
        after it) each. For methods that rank, those of their cut. Empty: Gaussians go gradually.
        prune/duration.py foresees the time of a run with it."""
        return []

    def rates(self, run: RunView, phase: Phase, number: int) -> dict[str, float]:
        """The learning rates of step `number` of the phase, by parameter name."""
        return phase.rates.at(number, run.extent)

    # --- a step of an active phase

    def budget(self, run: RunView) -> int:
        """The number to keep without a target, asked before steps of an active phase; 0: none needed."""
        return 0

    def prepare(self, run: RunView, phase: Phase, number: int):
        """Called before step `number` (from 1). It may change the model and the method's own state."""

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        """The fields of engine.Step, by name, that differ from a step of plain 3DGS. It changes nothing."""
        return {}

    # --- pruning

    def survivors(self, run: RunView) -> Keep:
        """The Gaussians that stay after a pruning event. Each densification is a pruning event too."""
        return None

    def after_densification(self, run: RunView, phase: Phase, number: int) -> Keep:
        """The Gaussians that stay after step `number`, its densification and survivors()."""
        return None

    def after_step(self, run: RunView, phase: Phase, number: int) -> Keep:
        """The Gaussians that stay after a step outside densification."""
        due = phase.prune_every and (number == phase.steps or number % phase.prune_every == 0)
        return self.survivors(run) if due else None

    def final_mask(self, run: RunView) -> Keep:
        """The Gaussians that stay at the end of an active phase."""
        return None

    def current_mask(self, model: Model) -> Keep:
        """The Gaussians that would stay if the method decided now and had no target."""
        return None

    def expected_count(self, logits: np.ndarray) -> float:
        """The expected number of Gaussians with these existence logits. Only where masks are learned."""
        raise NotImplementedError

    def score(self, viewed: ViewedScene) -> np.ndarray:
        """The score of each Gaussian, (N,); the highest stay. Only where methods rank or cut in events."""
        assert self.ranking is not None
        return self.ranking(viewed)

    def reduced(self, viewed: ViewedScene, count: int) -> Scene:
        """The scene with `count` Gaussians, of methods that rank. Raises SceneError for almost none."""
        raise NotImplementedError

    # --- checkpoints

    def state(self) -> dict:
        """The state that a checkpoint must hold, as values that JSON can hold."""
        return {}

    def restore(self, state: dict):
        """Restores what state() returned."""


def learning_phase(steps: int, rates: Rates, prune_every: int = 0, label: str = DECIDE) -> list[Phase]:
    """The pruning phase of `svrgs prune`, in which the method is active."""
    return [Phase("prune", steps, rates, active=True, prune_every=prune_every, label=label)]


def sh_every(iterations: int) -> int:
    """Steps after which the SH degree rises: SH_EVERY, fewer if the training is too short for them."""
    return max(1, min(SH_EVERY, iterations // SH_PARTS))

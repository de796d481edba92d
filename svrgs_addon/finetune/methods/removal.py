"""Iterative removal: the default method `removal`, and `saliency` (docs/methods.md, "`removal`, the
default").

Budget: the target, or the number of Gaussians with a saliency above lambda_F. PASSES times, spread evenly
over the phase, all Gaussians are ranked, and those that rank lowest are removed. The first passes remove
most, because these Gaussians are needed least; the last ones remove few. Each ranks anew, because only one of
two Gaussians that can replace each other may go. Between the passes and in the recovery the others are
trained, with the position rate that 3DGS begins with: the few that stay must move to where the others were,
and grow. A short run takes larger steps, else they would not get there, and so does one that keeps few
Gaussians, which must reach farther; otherwise large steps stretch Gaussians that few views see.

Before the first pass all opacities are lowered once; after that nothing but the image loss acts on a
Gaussian. What the photographs need, the steps raise again, with larger steps at first; what only fitted a few
photographs too closely stays faint, and is removed. A scene whose opacities were kept low in training, as
MCMC does, is left as it is.

The result is the mean of the values over the last steps, which keep moving about the best ones because the
steps are large.

With an allowed drop, the budget is the fewest Gaussians that are foreseen to hold it at the end of the run
(quality.py); the recovery removes more if it has dB to spare (recovery_pruning.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np

from .. import masks
from ..densify import lower_opacity
from ..model import Model
from ..quality import fewest_within, psnr_removed
from ..run_view import Keep, RunView
from ..saliency import removal_errors, saliency, views_that_see
from ..scores import top
from ..settings import LARGEST, LARGEST_OF_POSITION, Phase, Rates, Settings, rates_for
from ..viewed_scene import ViewedScene
from .base import REMOVE, Method, learning_phase

PASSES, FEWEST = 16, 4  # ranking passes in a long phase, and in a short one
# a pass takes as long as 20 to 40 steps: more passes in a short phase would leave few steps in the same time
STEPS_PER_PASS = 36
# share of the iterations of `svrgs train` in which Gaussians are removed: the last ones, as in GNS
SHARE_OF_TRAINING = 8 / 23
# share of the Gaussians; if fewer are left, the other rates grow by the root of the ratio, up to LARGEST
MANY = 0.25
# least factors by which opacities, and then their odds, are lowered before the phase
MIN_OPACITY_FACTOR, MIN_ODDS_FACTOR = 0.1, 0.1
# if fewer Gaussians than this share are so opaque, opacities were kept low in training: nothing is lowered
OPAQUE, OPAQUE_SHARE = 0.9, 0.05
# steps of the phase that see a Gaussian; with more, opacities are lowered too; with fewer, their odds less
RISING = 60
OPACITY_RATE = 0.025  # learning rate of opacity logits in the phase: half of that of 3DGS
# factor on this rate at first, so that opacities rise again; steps to 1, at most half the phase
FIRST_RATE, FIRST_STEPS = 8, 150
# budget of an allowed drop: share of the drop that is spent; more steps hardly win back more
SPENT, FORESEEN_STEPS = 0.75, 800
POSITION_LAST = 5e-5  # learning rate of positions at the end of the recovery
HALVED = 10.0  # steps that win back half of a removal, measured with `removal`
AVERAGED = 0.25  # share of the recovery, its last steps, over which the values are averaged


@dataclass
class Removal(Method):
    """The method. ranking: what a pass measures; the lowest are removed."""

    ranking: Callable[[ViewedScene], np.ndarray] = field(default=removal_errors, repr=False)
    lambda_f: float = 1e-4
    lambda_f_help: str = field(default="the saliency above which a Gaussian stays", repr=False)
    supports_max_loss: bool = True
    count: int = 0  # state: number of Gaussians before the first pass
    lowered: bool = False  # state: whether opacities were lowered

    def train_phases(self, iterations, recovery, densify, coarse_until) -> list[Phase]:
        """Plain 3DGS, then in the last 8/23 of the iterations removal, then recovery, as in `svrgs prune`."""
        removal = round(iterations * SHARE_OF_TRAINING)
        train, *_ = super().train_phases(iterations, 0, densify, coarse_until)
        return [
            replace(train, steps=iterations - removal, active=False),
            *self.prune_phases(removal, recovery, 0),
        ]

    def deciding(self, iterations: int, prune_every: int) -> list[Phase]:
        return learning_phase(iterations, Rates(opacity=OPACITY_RATE), label=REMOVE)

    def recovering(self, steps: int, *rates: float) -> list[Phase]:
        return [replace(phase, averaged=AVERAGED) for phase in super().recovering(steps, *rates)]

    def paced(self, phases: list[Phase]) -> list[Phase]:
        """Also of the phase and the recovery: they begin with the rates of a training with as many steps."""
        own = [phase for phase in phases if phase.densify is None]
        steps = sum(phase.steps for phase in own)
        return [
            replace(phase, rates=_rates(phase, steps)) if phase in own else phase
            for phase in super().paced(phases)
        ]

    def rates(self, run: RunView, phase: Phase, number: int) -> dict[str, float]:
        """Larger where few are left: distances on a surface grow with the root of what went."""
        rates = super().rates(run, phase, number)
        if phase.densify:
            return rates
        if phase.active and self.lowered:
            rates["opacity_logits"] *= _opacity_rate_factor(phase.steps, number)
        more, already = sqrt(max(1.0, MANY * self.count / run.model.count)), phase.rates.scale / Rates().scale
        others = min(more, max(1.0, LARGEST / already))
        larger = dict.fromkeys(("log_scales", "quats", "sh", "sh_rest"), others)
        larger["means"] = min(more, max(1.0, LARGEST_OF_POSITION / already))
        return rates | {name: factor * rates[name] for name, factor in larger.items()}

    def uses_lambda_f(self, settings: Settings) -> bool:
        return not (settings.target or settings.share or settings.max_loss)

    def budget(self, run: RunView) -> int:
        """The number of Gaussians with a saliency above lambda_F. Raises SceneError if almost none has. With
        an allowed drop: the fewest that are foreseen to hold it at the end of the run."""
        if run.plan.max_loss:
            floor = floor_of_drop(run.quality_before, run.plan)
            return int(fewest_within(run, self.score(run.viewed), floor).sum())
        value = saliency(run.viewed)
        stays = value > run.plan.lambda_f
        stays = stays if run.protected is None else stays | run.protected
        masks.refuse_emptying(stays, run.initial_count)
        return int(stays.sum())

    def prepare(self, run: RunView, phase: Phase, number: int):
        """Before the first step, lowers opacities of Gaussians that are seen and not protected."""
        if number == 1:
            self.lowered = _has_opaque(run.model)
            if self.lowered:
                seen = views_that_see(run.viewed)
                steps = phase.steps * seen.mean() / len(run.viewed.cameras)
                lowered = seen > 0 if run.protected is None else (seen > 0) & ~run.protected
                lower_opacity(run.model, lowered, *lowering(steps))

    def after_step(self, run: RunView, phase: Phase, number: int) -> Keep:
        """A pass after the first step of each of number_of_passes() equal parts of the phase."""
        passes = number_of_passes(phase.steps)
        earlier, these = ((number - back) * passes // phase.steps for back in (2, 1))
        if earlier == these:
            return None
        self.count = self.count or run.model.count
        return self.stays(run, (these + 1) / passes)

    def stays(self, run: RunView, done: float) -> np.ndarray:
        """The Gaussians that stay after a pass, (N,) bool. done: share of the passes, with this one."""
        rank = self.score(run.viewed)
        rank = rank if run.protected is None else np.where(run.protected, np.inf, rank)
        return top(rank, round(self.count * (min(run.target, self.count) / self.count) ** sqrt(done)))

    def ranking_passes(self, settings: Settings, steps: int, share: float) -> list[tuple[float, float]]:
        """The lowering and the budget of a drop take a pass each, that of lambda_F two."""
        passes = number_of_passes(steps)
        before = 1 + bool(settings.max_loss) + 2 * self.uses_lambda_f(settings)
        return [(0.0, 1.0)] * before + [(k / passes, share ** sqrt((k + 1) / passes)) for k in range(passes)]

    def state(self) -> dict:
        return {"count": self.count, "lowered": self.lowered}

    def restore(self, state: dict):
        self.count, self.lowered = state["count"], state.get("lowered", False)


def number_of_passes(steps: int) -> int:
    """The number of passes in a phase of so many steps: PASSES, in a short phase one in STEPS_PER_PASS steps,
    but FEWEST if there are as many steps."""
    return min(PASSES, max(FEWEST, steps // STEPS_PER_PASS), steps)


def floor_of_drop(before: float, settings: Settings) -> float:
    """The quality that a removal may leave without any learning: a PSNR with which the run is foreseen to
    spend SPENT of the allowed drop. For FLIP and LPIPS, of which nothing is foreseen, all that is allowed may
    be lost; the recovery removes more. before: quality of now."""
    if settings.measure != "psnr":
        return before - settings.max_loss
    return psnr_removed(
        before, before - SPENT * settings.max_loss, min(settings.total, FORESEEN_STEPS), HALVED
    )


def _has_opaque(model: Model) -> bool:
    """Whether at least OPAQUE_SHARE of the Gaussians have an opacity above OPAQUE."""
    return bool(np.mean(model.opacity_logits > np.log(OPAQUE / (1 - OPAQUE))) >= OPAQUE_SHARE)


def lowering(steps: float) -> tuple[float, float]:
    """The factors on opacities and on their odds before the phase. steps: the number of steps of the phase
    that see a Gaussian, in the mean. More steps can raise opacities further again, so with more steps the
    factors are smaller."""
    share = max(steps, 1e-9) / RISING
    return max(MIN_OPACITY_FACTOR, sqrt(min(1.0, 1 / share))), MIN_ODDS_FACTOR ** min(1.0, share)


def _opacity_rate_factor(steps: int, number: int) -> float:
    """The factor on the rate of opacities in step `number` of a phase of so many steps."""
    return 1 + (FIRST_RATE - 1) * max(0.0, 1 - number / min(FIRST_STEPS, steps / 2))


def _rates(phase: Phase, steps: int) -> Rates:
    """The rates of the phase or of the recovery, which have so many steps together. The rate of position does
    not fall in the phase, and less than in 3DGS in the recovery, because its values are averaged."""
    rates = rates_for(steps, phase.rates)
    return replace(rates, position_last=rates.position_first if phase.active else POSITION_LAST)


METHODS = (
    Removal(
        "removal",
        "removes the Gaussians that the photographs need least, step by step",
        0,
        "Recommended",
        source="this project; parts of GaussianPOP and SVR-GS",
        halved=HALVED,
    ),
    Removal(
        "saliency",
        "as Recommended, ranked by removal error over mask penalty, the objective of SVR-GS",
        6,
        "Saliency",
        ranking=saliency,
        source="this project; parts of GaussianPOP and SVR-GS",
    ),
)

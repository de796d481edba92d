"""How long a job takes, foreseen from the speed of a few steps and views on this machine. time_plan.py
inverts it.

A job reads the splat, measures its quality, does the steps of the plan, and measures and writes the result.
Between the steps the method looks at all training views to rank the Gaussians, and the PSNR of the curves is
measured. With the share n of the Gaussians

    a step takes  step * n^power,  a ranking pass takes  ranking * n^RANKING_POWER,

because a part of both depends on the pixels alone. `power` is measured with every sixteenth Gaussian. Those
that stay in a run grow, and cover more pixels, so it is lowered: in runs on seven scenes it was 0.12 to 0.30
less than measured, between 0.16 and 0.67. RANKING_POWER is fitted to runs on three scenes (0.5 to 0.8). A
training starts with small Gaussians, so there it is not measured: 0.3 to 0.45 in runs on three scenes.
Photographs that are read for the first time are read beside the steps, by all threads. Not foreseen: other
programs that use the processor.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from statistics import fmean

import numpy as np

from ..finetune.engine import NativeEngine
from ..finetune.loop import CURVE_POINTS, CURVE_VIEWS, LEAST_BETWEEN
from ..finetune.methods import method_named
from ..finetune.model import Model
from ..finetune.nested import SIZES
from ..finetune.plan import Plan, prune_plan
from ..finetune.quality import VIEWS, quality_views
from ..finetune.recovery_pruning import CUTS
from ..finetune.run import Run
from ..finetune.saliency import removal_errors
from ..finetune.settings import MCMC, Phase
from ..finetune.strength_controller import UPDATES
from ..finetune.viewed_scene import ViewedScene
from ..native import library
from ..render.metrics import worst
from ..render.metrics.evaluate import BLOCKS, evaluate, mean_quality
from ..scene.gaussians import Scene
from ..views.dataset import READER_THREADS, Dataset
from ..views.rendered import RenderedDataset
from .quality_forecast import in_time, spread

TRAINING_POWER, RANKING_POWER = 0.4, 0.65
# power: measured with 1/SOME of the Gaussians, lowered by GROWN, within these limits
SOME, GROWN, POWERS = 16, 0.3, (0.1, 0.6)
# the same of a method that merges; measured with the share that stays
MERGED_GROWN, MERGED_POWERS = 0.05, (0.1, 1.0)
# time limit of measuring steps after one that is not; most and fewest that are measured
STEP_SECONDS, STEPS, LEAST_STEPS = 0.5, 8, 3
# views of which the time of a ranking pass and of the measures of quality are measured
RANKED_VIEWS, MEASURED = 3, 2
# densifications, and how much longer a step takes after them: means over seven scenes
GROWTH = (0, 3, 10, 40, 145), (1.0, 1.0, 2.2, 4.0, 5.5)
GROWTH_POWER = 0.27  # of the number of Gaussians in this
UNKNOWN_SHARE = 0.3  # of the Gaussians of a training, those that stay if a method decides
PARTS = 16  # parts of a phase in which the number of Gaussians is taken as constant
# with all Gaussians, that take as long as a cut that merges: measured with 150,000 and 500,000
MERGING_STEPS = 60
CUT_CHECKS = 2  # measurements of a cut that finds nothing to spare
BISECTION = 10  # measurements that find the fewest Gaussians that hold a loss (finetune/quality.py)


@dataclass(frozen=True)
class Pace:
    """Speeds on this machine with all Gaussians of a scene, in seconds, and the numbers of Gaussians and
    views."""

    count: int
    step: float  # one step, its photograph in memory
    power: float  # of the share of the Gaussians in a step
    ranking: float  # one ranking pass over all training views; 0: the method has none
    drawn: float  # rendering a view and measuring its PSNR
    point: float  # a point of the curves
    measured: float  # all measures of the quality of a view
    photograph: float  # reading a photograph
    train_views: int
    test_views: int  # views on which the quality is measured
    uncached: float  # share of the training photographs that do not stay in memory
    # of the quality: before pruning, unless the photographs are the splat's own pictures, and after
    measurements: int = 2
    judged: float = 0.0  # measuring what an allowed loss is taken from, in all views that decide

    def pruning(self, plan: Plan, share: float, recorded: tuple[int, int] = (0, 0)) -> float:
        """Seconds of `svrgs prune` without reading and writing the splat. share: of the Gaussians, those that
        stay. recorded: further views that are rendered for each point of the curves, and once."""
        return (
            self._measuring(self.measurements)
            + self._cut(plan, share)
            + self._run(plan, share, recorded[0])
            + (recorded[1] + 2 * min(worst.VIEWS, self.test_views)) * self.drawn
        )

    def training(self, plan: Plan, recorded: tuple[int, int] = (0, 0)) -> float:
        """Seconds of `svrgs train` without reading the points and writing the splat. recorded: as for
        pruning()."""
        longest = max((growth(phase, self.count)[1] for phase in plan.phases), default=1.0)
        grown = longest ** (1 / GROWTH_POWER) * self.count
        share = plan.share or (plan.target / grown if plan.target else UNKNOWN_SHARE)
        return self._measuring(1) + self._run(plan, min(1.0, share), recorded[0])

    def _run(self, plan: Plan, share: float, recorded: int) -> float:
        """Seconds of all steps of the plan and of what is done between them."""
        points = min(CURVE_POINTS / max(1, plan.total), 1 / LEAST_BETWEEN)  # of the curves, for each step
        point = (self.point + recorded * self.drawn) * points
        total, grown, left = 0.0, 1.0, share if plan.method.ranks and not plan.prunes else 1.0
        for phase in plan.phases:
            passes = plan.method.ranking_passes(plan, phase.steps, share) if phase.active else []
            if plan.method.ranks:  # in training, the cut comes last
                passes = [(1.0, after) for _, after in passes]
            parts = gradual(share) if phase.active and not passes else between(passes, left)
            mean, grown = growth(phase, self.count) if phase.densify else (grown, grown)
            fraction = sum(length * n**self.power for length, n in parts)
            total += phase.steps * (self.step + point) * mean * fraction
            total += grown * self._ranking_seconds(passes, left)
            left = share if phase.active else left
        return total + self._ordering(plan, left) + self._drop(plan, share) + self._reading(plan.total)

    def _measuring(self, times: int) -> float:
        """Seconds of measuring the quality so many times; the photographs are read once."""
        return self.test_views * (times * self.measured + self.photograph)

    def _cut(self, plan: Plan, share: float) -> float:
        """Seconds of what precedes the steps: the first cut, and the cut of a method that ranks."""
        first = self.train_views * self.drawn if plan.min_contribution else 0.0
        merging = MERGING_STEPS * plan.method.merges * self.step
        passes = plan.method.ranking_passes(plan, 0, share) if plan.method.ranks else []
        return first + merging + self._ranking_seconds(passes, 1.0)

    def _ranking_seconds(self, passes: list[tuple[float, float]], left: float) -> float:
        """Seconds of ranking passes. left: Gaussians before the first one."""
        return sum(
            self.ranking * n**RANKING_POWER for n in [left, *(after for _, after in passes)][: len(passes)]
        )

    def _ordering(self, plan: Plan, left: float) -> float:
        """Seconds of the order of a nested result: ranking passes over fewer and fewer Gaussians.
        Its quicker steps are not foreseen."""
        sizes = range(1, SIZES + 1) if plan.nested else ()
        return self._ranking_seconds([(0.0, left * plan.nested ** (k / SIZES)) for k in sizes], left)

    def _drop(self, plan: Plan, share: float) -> float:
        """Seconds of holding a loss of quality: its measure on a few views, and ranking passes in the
        recovery."""
        if not plan.max_loss:
            return 0.0
        decisions, cuts = sum(phase.active for phase in plan.phases), 0 if plan.nested else len(CUTS)
        # without a law, the decision spends what is allowed, and most cuts find nothing to spare
        in_cut = BISECTION if plan.measure == "psnr" else CUT_CHECKS
        times = BISECTION * decisions + in_cut * cuts * share**self.power
        times += UPDATES * plan.method.learns_masks
        return self.judged * times + cuts * self.ranking * share**RANKING_POWER

    def _reading(self, steps: int) -> float:
        """Seconds of reading photographs beside the steps."""
        read = min(steps, self.train_views) + max(0, steps - self.train_views) * self.uncached
        return read * max(self.photograph / library.threads(), self.photograph / READER_THREADS - self.step)


def pace_of(scene: Scene, dataset: Dataset, plan: Plan, lpips: Callable | None = None) -> Pace:
    """Measures the speeds, within one or two seconds, on a copy of the scene. Raises FormatError,
    SceneError."""
    train = dataset.train_indices or list(range(len(dataset.cameras)))
    test = dataset.test_indices or dataset.train_indices
    shown, photograph = _read_some(dataset, spread(train))
    ranked_views = [dataset.cameras[index] for index in spread(train)[:RANKED_VIEWS]]
    views, viewed = spread(test)[:MEASURED], ViewedScene.of(scene, ranked_views, dataset.background)
    rasterizer, options = viewed.rasterizer, viewed.options
    _read_some(dataset, views)
    passes = bool(plan.method.ranking_passes(plan, max(1, plan.total), 1.0))
    look = plan.method.score if passes else removal_errors
    drawn = _seconds(lambda: mean_quality(scene, dataset, views, rasterizer, options)) / len(views)
    measure = lambda: evaluate(
        scene, dataset, views, rasterizer, lpips, plan.exposure == "on", plan.refine_poses == "on"
    )
    judge = lambda: mean_quality(scene, dataset, views, rasterizer, options, measure=plan.measure)
    judging = min(len(quality_views(dataset)), BLOCKS if plan.measure == "lpips" else VIEWS) / len(views)
    in_memory = sum(3 * dataset.cameras[index].width * dataset.cameras[index].height for index in train)
    step = _step(scene, replace(dataset, train_indices=shown), plan)
    return Pace(
        count=scene.count,
        ranking=_seconds(lambda: look(viewed)) * len(train) / len(ranked_views)
        if passes or plan.nested
        else 0.0,
        drawn=drawn,
        point=drawn * min(CURVE_VIEWS, len(dataset.test_indices)),
        measured=_seconds(measure, warm=True) / len(views),
        measurements=1 if isinstance(dataset, RenderedDataset) else 2,
        judged=_seconds(judge) * judging if plan.max_loss else 0.0,
        photograph=photograph,
        train_views=len(train),
        test_views=len(test),
        uncached=max(0.0, 1 - dataset.memory_budget / in_memory),
        step=step,
        power=_power(step, scene, replace(dataset, train_indices=shown), plan),
    )


def growth(phase: Phase, count: int) -> tuple[float, float]:
    """How much longer a step takes because of the Gaussians that a phase adds to `count`: in the mean of its
    steps, and in its last one. Steps on reduced photographs take the less time."""
    rule = phase.densify
    if rule is None or not phase.steps:
        return 1.0, 1.0

    def at(step: float) -> float:
        rounds = max(0.0, min(step, rule.until) - rule.start) / rule.every
        if isinstance(rule, MCMC):
            return max(1.0, min(rule.cap / count, rule.growth**rounds)) ** GROWTH_POWER
        return float(np.interp(rounds, *GROWTH))

    steps = [(part + 0.5) / PARTS * phase.steps for part in range(PARTS)]
    return fmean(at(step) / phase.reduction(round(step)) for step in steps), at(phase.steps)


def between(passes: list[tuple[float, float]], left: float) -> list[tuple[float, float]]:
    """(length, Gaussians) of the parts of a phase with these ranking passes; shares. left: Gaussians before
    the first pass."""
    starts, lefts = [0.0, *(when for when, _ in passes), 1.0], [left, *(after for _, after in passes)]
    return [(end - start, n) for start, end, n in zip(starts, starts[1:], lefts, strict=False)]


def gradual(share: float) -> list[tuple[float, float]]:
    """As between(), for a phase in which Gaussians go gradually until the share `share` is left."""
    return [(1 / PARTS, 1 + (share - 1) * (part + 0.5) / PARTS) for part in range(PARTS)]


def _read_some(dataset: Dataset, views: list[int]) -> tuple[list[int], float]:
    """Reads photographs of the first views, as many as time allows. Returns the views, and the seconds of
    one."""
    some = in_time(views[:STEPS], STEP_SECONDS, LEAST_STEPS)
    seconds = [_seconds(partial(dataset.image, view), warm=True) for view in some]
    return views[: len(seconds)], statistics.median(seconds)


def _seconds(work: Callable[[], object], warm: bool = False) -> float:
    """Seconds of a call; unless `warm`, after one that fills caches."""
    if not warm:
        work()
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def _power(step: float, scene: Scene, dataset: Dataset, plan: Plan) -> float:
    """The power of the share of the Gaussians in a step. step: seconds with all."""
    if any(phase.densify for phase in plan.phases):
        return TRAINING_POWER
    every, grown, limits = SOME, GROWN, POWERS
    if plan.method.merges:
        share = plan.share or plan.target / scene.count or 1 / SOME
        every, grown, limits = min(SOME, max(2, round(1 / share))), MERGED_GROWN, MERGED_POWERS
    some = scene.select(np.arange(scene.count) % every == 0)
    return float(np.clip(math.log(step / _step(some, dataset, plan)) / math.log(every) - grown, *limits))


def _step(scene: Scene, dataset: Dataset, plan: Plan) -> float:
    """Seconds of a step. For methods that learn no masks, steps of plain 3DGS are measured, which are nearly
    the same."""
    method = plan.method if plan.method.learns_masks else method_named("3dgs")
    same = {name: getattr(plan, name) for name in ("background", "exposure", "refine_poses")}
    steps = prune_plan(method, STEPS + 2, STEPS + 2, **same)
    run = Run(Model.of(scene), dataset, steps, NativeEngine())
    try:
        run.advance()
        some = in_time(range(STEPS), STEP_SECONDS, LEAST_STEPS)
        return statistics.median([_seconds(run.advance, warm=True) for _ in some])
    finally:
        run.close()

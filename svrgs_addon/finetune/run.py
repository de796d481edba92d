"""One fine-tuning run: which view, which rates, which masks; when to densify, prune, recover. Deterministic for a given seed."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Generator, Iterator
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from .. import memory
from ..camera import Camera
from ..errors import SceneError
from ..geometry.morton_order import morton_order
from ..metrics.evaluate import mean_psnr
from ..native import Rasterizer, RenderOptions
from ..photographs.dataset import Dataset
from . import densify, masks
from .engine import Step, StepResult
from .model import Model
from .plan import Plan
from .quality import quality_views
from .recovery_pruning import RecoveryPruning
from .settings import Densify, Phase
from .strength_controller import controller_for
from .views import Views, as_real, fitting_reduction

SMOOTHING = 0.05  # of the loss shown
RESETS_NEED = 3  # opacities need a third of the steps between two resets to recover; a later reset is left out
REORDER_SHARE = 0.1  # rows are put in Morton order again when so many were added since


@dataclass
class Curves:
    """Values over iterations, for plots."""

    iteration: list[int] = field(default_factory=list)
    count: list[int] = field(default_factory=list)
    loss: list[float] = field(default_factory=list)
    psnr: list[float | None] = field(default_factory=list)


class Run:
    """One fine-tuning run: model, position in the schedule, statistics. `advance()` does one iteration."""

    def __init__(self, model: Model, dataset: Dataset, settings: Plan, engine, antialiased: bool = False):
        self.model, self.dataset, self.settings, self.engine = model, dataset, settings, engine
        self.antialiased = antialiased
        self.method = copy(settings.method)
        self.controller = controller_for(settings, self.method.learns_masks)
        self.recovery_pruning = RecoveryPruning() if settings.max_drop else None
        self.drop: float | None = None  # dB lost, once the run is over, where a loss is allowed
        self.target = settings.target  # 0: none, or a share of a number not known yet
        self.iteration = 0
        self.statistics = densify.Statistics(model.count)
        self.views = Views(dataset.train_indices, settings.seed, settings.views_by_loss)
        self.initial_count = model.count
        self.unordered = 0  # Gaussians added since rows were last put in order
        self.curves = Curves()
        self.loss = math.nan
        self.nonfinite = 0  # Gaussian rows whose gradient was not finite and was left out
        self.held_back = 0  # densifications that added nothing, for want of memory
        self.seconds: dict[str, float] = {}  # by phase
        self.whole = True  # no step is half done
        self._photographs: Generator | None = None  # of this epoch

    @cached_property
    def extent(self) -> float:
        return self.dataset.extent

    @property
    def finished(self) -> bool:
        return self.iteration >= self.settings.total

    def phase(self) -> tuple[Phase, int]:
        """The phase of the next iteration, and its number within it (from 1)."""
        return self.settings.at(self.iteration)

    def advance(self):
        """One iteration: loss and gradients, then densification or the optimiser step, then pruning events."""
        started = time.perf_counter()
        phase, number = self.phase()
        (view, reduction), target = self._next_photograph()  # which may fail: nothing has changed yet
        self.whole = False
        if not self.iteration:
            self._into_order()
        self._prepare(phase, number)
        step = self._step(phase, number, self.dataset.cameras[view].reduced(reduction), target)
        result = self.engine.step(self.model, step)
        self._record(result, step, view)
        self.iteration += 1
        self._density_control(phase, number, step, result)
        self._prune(phase, number)
        self.whole = True
        self.seconds[phase.name] = self.seconds.get(phase.name, 0.0) + time.perf_counter() - started

    def close(self):
        """Ends the reading threads."""
        if self._photographs is not None:
            self._photographs.close()
            self._photographs = None

    def _next_photograph(self) -> tuple[tuple[int, int], np.ndarray]:
        """((view, reduction), target) of the next step."""
        if self._photographs is None:
            self._photographs = self.dataset.stream(self._looks(), self._target)
        try:
            return next(self._photographs)
        except StopIteration:  # the epoch is over
            self._photographs = None
            return self._next_photograph()

    def _looks(self) -> Iterator[tuple[int, int]]:
        """(view, reduction) of each step left in this epoch."""
        for iteration, view in enumerate(self.views.rest(), self.iteration):
            if iteration == self.settings.total:
                return
            phase, number = self.settings.at(iteration)
            camera = self.dataset.cameras[view]
            yield view, fitting_reduction(phase.reduction(number), camera.width, camera.height)

    def _target(self, look: tuple[int, int]) -> np.ndarray:
        view, reduction = look
        return as_real(self.dataset.image(view), self.model.dtype, reduction)

    def _prepare(self, phase: Phase, number: int):
        """Before a step: notes where the run starts from, and lets the method change what it needs."""
        if self.recovery_pruning:
            self.recovery_pruning.before_step(self)
        if not phase.active:
            self.model.forget_extras()
            return
        if self.settings.share and not self.target and not _grows(phase, number):
            self.target = max(1, round(self.settings.share * self.model.count))
        self.target = self.target or self.method.budget(self)
        self.method.prepare(self, phase, number)
        if self.controller and not _grows(phase, number):
            self.controller.before_step(self)

    def _step(self, phase: Phase, number: int, camera: Camera, target: np.ndarray) -> Step:
        s = self.settings
        step = Step(
            camera=camera,
            target=target,
            number=self.iteration + 1,
            rates=phase.rates.at(number, self.extent),
            options=self.render_options(phase, number),
            l1_weight=s.l1_weight,
            ssim_weight=s.ssim_weight,
            update=not self._densifies(phase, number),
            want_means2d=phase.densify is not None and number < phase.densify.until,
        )
        if rate := phase.dropout_rate(number, len(self.dataset.train_indices)):
            step.masks = masks.dropout_masks(self.model.count, rate, s.seed, self.iteration)
        return replace(step, **self.method.terms(self, phase, number)) if phase.active else step

    def render_options(self, phase: Phase, number: int) -> RenderOptions:
        s = self.settings
        kind = self.method.mask_kind if phase.active else "none"
        degree = number // phase.sh_every if phase.sh_every else 3
        return RenderOptions(min(degree, 3), self.antialiased, s.full, kind, background=s.background)

    # --- what methods and controllers read: RunView

    @property
    def strength(self) -> float:
        return self.controller.strength if self.controller else 1.0

    @property
    def psnr_before(self) -> float:
        return self.recovery_pruning.start if self.recovery_pruning else 0.0

    @property
    def rasterizer(self) -> Rasterizer:
        return self.engine.rasterizer

    def psnr(self, kept: np.ndarray | None) -> float:
        views = quality_views(self.dataset.train_indices)
        return mean_psnr(self.model, self.dataset, views, self.rasterizer, self.score_options, None if kept is None else kept.astype(np.uint8))

    def current_mask(self) -> np.ndarray | None:
        return self.method.current_mask(self.model)

    def expected_count(self) -> float:
        return self.method.expected_count(self.model)

    @property
    def score_options(self) -> RenderOptions:
        return RenderOptions(antialiased=self.antialiased, full=self.settings.full, background=self.settings.background)

    @property
    def training_cameras(self) -> list[Camera]:
        return [self.dataset.cameras[i] for i in self.dataset.train_indices]

    @staticmethod
    def _densifies(phase: Phase, number: int) -> bool:
        rule = phase.densify
        return rule is not None and rule.start < number < rule.until and number % rule.every == 0

    def _record(self, result: StepResult, step: Step, view: int):
        loss = result.loss(step)
        if not math.isfinite(loss):
            raise SceneError(f"the loss is not finite at iteration {self.iteration + 1} (view {step.camera.name}): the scene or its images hold bad values")
        self.loss = loss if math.isnan(self.loss) else self.loss + SMOOTHING * (loss - self.loss)
        self.nonfinite += result.nonfinite
        self.views.shown(view, result.image_loss(step))

    def _density_control(self, phase: Phase, number: int, step: Step, result: StepResult):
        rule = phase.densify
        if rule is None or number >= rule.until or result.means2d is None:
            return
        self.statistics.add(result.visible, result.means2d, step.camera.width, step.camera.height)
        if self._densifies(phase, number):
            self._densify(phase, number, rule)
        if number % rule.reset_every == 0 and number + rule.reset_every // RESETS_NEED <= phase.steps:
            densify.reset_opacity(self.model)

    def _densify(self, phase: Phase, number: int, rule: Densify):
        before = self.model.count
        rng = np.random.default_rng([self.settings.seed, 1, self.iteration])
        keep = densify.densify(self.model, self.statistics, rule, self.extent, rng, self._fits)
        self.unordered += self.model.count - before
        keep &= densify.worth_keeping(self.model, rule, self.extent, number > rule.reset_every)
        survivors = self.method.survivors(self) if phase.active else None
        self._keep(keep if survivors is None else keep & survivors)
        last = number + rule.every >= rule.until
        if self.unordered > (0 if last else REORDER_SHARE * self.model.count):
            self._into_order()
        self.statistics = densify.Statistics(self.model.count)

    def _fits(self, born: int) -> bool:
        """Whether memory holds so many more Gaussians; said once if not, and training goes on with those there are."""
        count, coefficients, _ = self.model.sh.shape
        sentence = memory.shortage(f"growing beyond {count:,} Gaussians", memory.growing(count, born, coefficients, self.dataset.cameras))
        if sentence and not self.held_back:
            logging.warning("iteration %d: %s; training goes on without growing", self.iteration, sentence)
        self.held_back += bool(sentence)
        return not sentence

    def _into_order(self):
        """Puts near Gaussians into near rows (geometry/morton_order.py), where statistics are empty or about to be: they are not moved along."""
        if self.settings.spatial_order:
            self.model.reorder(morton_order(self.model.means))
        self.unordered = 0

    def _prune(self, phase: Phase, number: int):
        """After a step: the method prunes outside densification and when its phase ends; recovery prunes where a drop is allowed."""
        last = number == phase.steps
        if phase.active and self.controller and not _grows(phase, number):
            self.controller.after_step(self, phase, number)
        if phase.active and (last or not _grows(phase, number)):
            self._keep(self.method.after_step(self, phase, number))
        if phase.active and last:
            self._keep(self.method.final_mask(self))
        if self.recovery_pruning and not phase.active:
            self._keep(self.recovery_pruning.cut(self, phase, number))

    def _keep(self, keep: np.ndarray | None):
        if keep is None:
            return
        masks.refuse_emptying(keep, self.initial_count, self.settings.target)
        if not keep.all():
            self.model.keep(keep)
            self.statistics = densify.Statistics(self.model.count)


def _grows(phase: Phase, number: int) -> bool:
    """Whether step `number` of the phase lies within densification, and others follow in it."""
    return phase.densify is not None and number < min(phase.densify.until, phase.steps)

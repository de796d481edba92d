"""One fine-tuning run: it chooses the view, learning rates and masks of each step, and decides when to
densify and prune.

A run is deterministic for a given seed.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Generator, Iterator
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..native.rasterizer import RenderOptions
from ..render.metrics.evaluate import mean_quality
from ..scene.camera import Camera
from ..scene.morton_order import morton_order
from ..system import memory
from ..system.errors import SceneError
from ..views.dataset import Dataset
from ..views.reduced_photos import as_real, fitting_reduction, photo_of
from . import densify, exposure, masks, mcmc, poses
from .averaging import Average
from .engine import Step, StepResult
from .exposure import Exposures
from .model import MASK, Model
from .nested import nested_order, size_of_step
from .photo_adam import rate_at
from .plan import Plan
from .poses import Poses
from .quality import quality_views
from .recovery_pruning import RecoveryPruning
from .settings import MCMC, Densify, Phase
from .strength_controller import controller_for
from .view_order import ViewOrder
from .viewed_scene import ViewedScene

SMOOTHING = 0.05  # weight of the newest loss in the smoothed one
# opacities recover for 1/3 of the steps between two resets; a reset with fewer steps left is skipped
RESETS_NEED = 3
REORDER_SHARE = 0.1  # rows are put in Morton order again when this share of them was added since


@dataclass
class Curves:
    """Number of Gaussians, smoothed loss and PSNR in dB over iterations, for plots."""

    iteration: list[int] = field(default_factory=list)
    count: list[int] = field(default_factory=list)
    loss: list[float] = field(default_factory=list)
    psnr: list[float | None] = field(default_factory=list)

    def add(self, iteration: int, count: int, loss: float, psnr: float | None):
        self.iteration.append(iteration)
        self.count.append(count)
        self.loss.append(loss)
        self.psnr.append(psnr)


class Run:
    """One fine-tuning run: the model, the position in the schedule, and statistics. `advance()` does one
    iteration.

    It implements RunView, which is all that methods and controllers read. checkpoint.py saves and restores
    its state.
    """

    def __init__(self, model: Model, dataset: Dataset, plan: Plan, engine):
        self.model, self.dataset, self.plan, self.engine = model, dataset, plan, engine
        self.method = copy(plan.method)
        self.controller = controller_for(plan, self.method.learns_masks, self.method.largest_strength)
        self.recovery_pruning = RecoveryPruning() if plan.max_loss else None
        self.drop: float | None = None  # PSNR lost in dB, set at the end of a run that allows a drop
        self.target = plan.target  # 0: no target, or a share of a number that is not known yet
        self.iteration = 0
        self.statistics = densify.Statistics(model.count)
        self.views = ViewOrder(dataset.train_indices, plan.seed, plan.views_by_loss)
        self.initial_count = model.count
        self.unordered = 0  # Gaussians added since the rows were last put in Morton order
        self.average = Average()
        self.places = {view: place for place, view in enumerate(dataset.train_indices)}
        self.exposures = Exposures.identities(len(self.places)) if plan.exposure == "on" else None
        self.poses: Poses | None = None
        if plan.refine_poses == "on":
            self.dataset = replace(dataset, cameras=list(dataset.cameras))  # its cameras will move
            self.extent = dataset.extent  # a resumed run must have that of the start
            self.poses = Poses.of(self.training_cameras, model.means)
        self.curves = Curves()
        self.part: Callable[[str, float], None] = lambda *_: None  # told what takes seconds between steps
        self.loss = math.nan
        self.nonfinite = 0  # rows that were not updated because their gradient was not finite
        self.held_back = 0  # densifications that added nothing because memory was short
        self.seconds: dict[str, float] = {}  # by name of the phase
        self.between_steps = True  # False while a step is being done
        self._photographs: Generator | None = None  # those left in this epoch

    @cached_property
    def extent(self) -> float:
        return self.dataset.extent

    @property
    def finished(self) -> bool:
        return self.iteration >= self.plan.total

    def phase(self) -> tuple[Phase, int]:
        """The phase of the next iteration, and the number of its step in this phase (from 1)."""
        return self.plan.at(self.iteration)

    def advance(self):
        """One iteration: loss and gradients, then densification or the optimiser step, then pruning.

        Raises SceneError if the loss is not finite, or if almost no Gaussian would be left; and what reading
        a photograph raises.
        """
        started = time.perf_counter()
        phase, number = self.phase()
        (view, reduction), target = self._next_photograph()  # reading may fail, so it comes before any change
        self.between_steps = False
        if not self.iteration:
            self._into_order()
        self._prepare(phase, number)
        step = self._step(phase, number, self.dataset.cameras[view].reduced(reduction), target)
        step.window = self.dataset.window(view)
        if self.exposures:
            step.exposure = self.exposures.matrices[self.places[view]]
        size = size_of_step(self.plan, phase, self.iteration, self.model.count)
        result = self.engine.step(self.model.first(size) if size < self.model.count else self.model, step)
        self._record(result, step, view)
        self._refine(view, result)
        self.iteration += 1
        self._density_control(phase, number, step, result)
        self._prune(phase, number)
        self._average(phase, number)
        self.between_steps = True
        self.seconds[phase.name] = self.seconds.get(phase.name, 0.0) + time.perf_counter() - started

    def _refine(self, view: int, result: StepResult):
        """A step of the exposure and the pose of the photograph that was shown."""
        place, moment = self.places[view], (self.iteration, self.plan.total)
        if self.exposures and result.exposure is not None:
            rate = rate_at(exposure.FIRST, exposure.LAST, *moment)
            self.exposures.update(place, result.exposure, rate)
        if self.poses and result.camera is not None:
            camera, rate = self.dataset.cameras[view], rate_at(poses.FIRST, poses.LAST, *moment)
            self.dataset.cameras[view] = self.poses.update(place, camera, result.camera, rate)

    def put_back_poses(self, found: Poses):
        """Poses of a checkpoint."""
        self.poses = found
        for view, place in self.places.items():
            camera = self.dataset.cameras[view]
            self.dataset.cameras[view] = replace(camera, viewmat=found.viewmats[place])

    def close(self):
        """Ends the threads that read photographs."""
        if self._photographs is not None:
            self._photographs.close()
            self._photographs = None

    def _next_photograph(self) -> tuple[tuple[int, int], np.ndarray]:
        """((view, reduction), photograph) of the next step."""
        if self._photographs is None:
            self._photographs = self.dataset.stream(self._steps_of_epoch(), self._target)
        try:
            return next(self._photographs)
        except StopIteration:  # the epoch is over
            self._photographs = None
            return self._next_photograph()

    def _steps_of_epoch(self) -> Iterator[tuple[int, int]]:
        """(view, reduction) of each step that is left in this epoch."""
        for iteration, view in enumerate(self.views.rest(), self.iteration):
            if iteration == self.plan.total:
                return
            phase, number = self.plan.at(iteration)
            camera = self.dataset.cameras[view]
            yield view, fitting_reduction(phase.reduction(number), camera.width, camera.height)

    def _target(self, view_and_reduction: tuple[int, int]) -> np.ndarray:
        view, reduction = view_and_reduction
        image, window = self.dataset.image(view), self.dataset.window(view)
        if window is not None:
            return as_real(image[window], self.model.dtype, reduction)
        return photo_of(self.dataset.cameras[view].reduced(reduction), image, self.model.dtype, reduction)

    def _prepare(self, phase: Phase, number: int):
        """What precedes a step: PSNR at the start, target, the method's preparation, the controller's."""
        if self.recovery_pruning:
            self.recovery_pruning.before_step(self)
        if not phase.active:
            self.model.remove_extras()
            if self.plan.nested and phase.name == "recover" and number == 1:
                self.model.reorder(nested_order(self))
            return
        if self.plan.share and not self.target and not _densifying(phase, number):
            self.target = max(1, round(self.plan.share * self.model.count))
        self.target = self.target or self.method.budget(self)
        self.method.prepare(self, phase, number)
        if self.controller and not _densifying(phase, number):
            self.controller.before_step(self)

    def _step(self, phase: Phase, number: int, camera: Camera, target: np.ndarray) -> Step:
        s = self.plan
        step = Step(
            camera=camera,
            target=target,
            number=self.iteration + 1,
            rates=self.method.rates(self, phase, number),
            options=self.render_options(phase, number),
            l1_weight=s.l1_weight,
            ssim_weight=s.ssim_weight,
            update=not self._densifies(phase, number),
            frozen=self.protected if phase.active else None,
            want_camera=self.poses is not None,
            want_means2d=phase.densify is not None
            and number < phase.densify.until
            and not isinstance(phase.densify, MCMC),
        )
        step = replace(step, **self.method.terms(self, phase, number)) if phase.active else step
        if isinstance(phase.densify, MCMC):
            return replace(
                step, penalties=(*mcmc.penalties(phase.densify, step.camera.unit), *step.penalties)
            )
        return step

    def render_options(self, phase: Phase, number: int) -> RenderOptions:
        s = self.plan
        kind = self.method.mask_kind if phase.active else "none"
        degree = number // phase.sh_every if phase.sh_every else 3
        return RenderOptions(min(degree, 3), self.model.antialiased, s.full, kind, background=s.background)

    # --- RunView: what methods and controllers read

    @property
    def strength(self) -> float:
        return self.controller.strength if self.controller else 1.0

    @property
    def quality_before(self) -> float:
        return self.recovery_pruning.start if self.recovery_pruning else 0.0

    @property
    def viewed(self) -> ViewedScene:
        options = RenderOptions(
            antialiased=self.model.antialiased, full=self.plan.full, background=self.plan.background
        )
        return ViewedScene(self.model, self.training_cameras, self.engine.rasterizer, options)

    def quality(self, kept: np.ndarray | None) -> float:
        viewed = self.viewed
        what = self.model, self.dataset, quality_views(self.dataset), viewed.rasterizer, viewed.options
        masks_of_kept = None if kept is None else kept.astype(np.uint8)
        if self.plan.measure == "lpips":
            self.part("measures LPIPS", self.iteration / self.plan.total)
        return mean_quality(*what, masks_of_kept, self.plan.measure, self.dataset.unexplained)

    @property
    def own(self) -> np.ndarray | None:
        if self.plan.own is None:
            return None
        first, end = self.plan.own
        return (self.model.origin >= first) & (self.model.origin < end)

    @property
    def protected(self) -> np.ndarray | None:
        own = None if self.method.learns_masks else self.own
        return None if own is None else ~own

    def current_mask(self) -> np.ndarray | None:
        return self.method.current_mask(self.model)

    def expected_count(self) -> float:
        logits, own = self.model.values[MASK], self.own
        return self.method.expected_count(logits if own is None else logits[own])

    @property
    def training_cameras(self) -> list[Camera]:
        return self.dataset.training_cameras

    @staticmethod
    def _densifies(phase: Phase, number: int) -> bool:
        rule = phase.densify
        return rule is not None and rule.start < number < rule.until and number % rule.every == 0

    def _record(self, result: StepResult, step: Step, view: int):
        loss = result.loss(step)
        if not math.isfinite(loss):
            raise SceneError(
                f"the loss is not finite at iteration {self.iteration + 1} (view {step.camera.name}): the"
                " scene or the photograph has bad values"
            )
        self.loss = loss if math.isnan(self.loss) else self.loss + SMOOTHING * (loss - self.loss)
        self.nonfinite += result.nonfinite
        # a mean over all pixels, of which those that do not count have no loss
        self.views.shown(view, result.image_loss(step) / (step.camera.valid_share or 1.0))

    def _density_control(self, phase: Phase, number: int, step: Step, result: StepResult):
        rule = phase.densify
        if result.means2d is not None:
            self.statistics.add(result.visible, result.means2d, step.camera.width, step.camera.height)
        if rule is not None and self._densifies(phase, number):
            self._densify(phase, number, rule)
        if isinstance(rule, MCMC):
            if number < phase.steps:
                rng = np.random.default_rng([self.plan.seed, 4, self.iteration])
                mcmc.add_noise(self.model, rule, step.rates["means"], rng, step.camera.unit)
        elif rule is not None and number < rule.until and number % rule.reset_every == 0:
            if number + rule.reset_every // RESETS_NEED <= phase.steps:
                densify.reset_opacity(self.model)

    def _densify(self, phase: Phase, number: int, rule: Densify):
        before = self.model.count
        rng = np.random.default_rng([self.plan.seed, 1, self.iteration])
        if isinstance(rule, MCMC):
            self.unordered += mcmc.densify(self.model, rule, rng, self._memory_allows)
            keep = np.ones(self.model.count, bool)
        else:
            keep = densify.densify(self.model, self.statistics, rule, self.extent, rng, self._memory_allows)
            self.unordered += self.model.count - before
            keep &= densify.keep_mask(self.model, rule, self.extent, number > rule.reset_every)
        survivors = self.method.survivors(self) if phase.active else None
        self._keep(keep if survivors is None else keep & survivors)
        self._keep(self.method.after_densification(self, phase, number) if phase.active else None)
        last = number + rule.every >= rule.until
        if self.unordered > (0 if last else REORDER_SHARE * self.model.count):
            self._into_order()
        self.statistics = densify.Statistics(self.model.count)

    def _memory_allows(self, added: int) -> bool:
        """Whether memory holds so many more Gaussians. If not, it warns once; training goes on."""
        count, coefficients, _ = self.model.sh.shape
        sentence = memory.shortage(
            f"growing beyond {count:,} Gaussians",
            memory.growing(count, added, coefficients, self.dataset.cameras),
        )
        if sentence and not self.held_back:
            logging.warning("iteration %d: %s; training goes on without growing", self.iteration, sentence)
        self.held_back += bool(sentence)
        return not sentence

    def _into_order(self):
        """Puts the rows in Morton order (scene/morton_order.py). The densification statistics are not
        reordered, so it is called only when they are empty or are reset next."""
        if self.plan.spatial_order:
            self.model.reorder(morton_order(self.model.means))
        self.unordered = 0

    def _prune(self, phase: Phase, number: int):
        """What follows a step: the controller; pruning by the method, outside densification and at the end of
        its phase; pruning in the recovery, if a drop is allowed."""
        last = number == phase.steps
        if phase.active and self.controller and not _densifying(phase, number):
            self.controller.after_step(self, phase, number)
        if phase.active and (last or not _densifying(phase, number)):
            self._keep(self.method.after_step(self, phase, number))
        if phase.active and last:
            self._keep(self.method.final_mask(self))
        # a nested order is of the Gaussians before the recovery
        if self.recovery_pruning and not phase.active and not self.plan.nested:
            self._keep(self.recovery_pruning.cut(self, phase, number))

    def _average(self, phase: Phase, number: int):
        """Averages values that count; at the end of the phase the average takes their place."""
        if phase.samples(number):
            self.average.add(self.model)
        if number == phase.steps:
            self.average.put_into(self.model)
            self.average = Average()

    def _keep(self, keep: np.ndarray | None):
        if keep is None:
            return
        keep = keep if self.protected is None else keep | self.protected
        masks.refuse_emptying(keep, self.initial_count, self.plan.target)
        if not keep.all():
            self.model.keep(keep)
            self.statistics = densify.Statistics(self.model.count)
            self.average = Average()  # it begins again with those that stay


def _densifying(phase: Phase, number: int) -> bool:
    """Whether step `number` is before the end of densification and not the last of the phase."""
    return phase.densify is not None and number < min(phase.densify.until, phase.steps)

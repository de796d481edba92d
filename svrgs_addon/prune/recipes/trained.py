"""A training from the sparse points of a dataset."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ...files.registry import read_back
from ...finetune.model import Model, scene_from_points
from ...finetune.plan import Plan
from ...finetune.settings import MCMC, Densify
from ...native.library import near_depth
from ...render.metrics.evaluate import any_in_view
from ...system.errors import SceneError
from ...views.dataset import Dataset
from ..context import JobContext
from ..planning import training_within
from .fine_tuned import CANNOT_REACH, Tuned, check_request, refuse_excess


class Trained(Tuned):
    """Trains from the sparse points."""

    def __init__(self, plan: Plan, job: JobContext, read_dataset: Callable[[], Dataset], sh_degree: int = 3):
        """read_dataset: gives the dataset, with its points."""
        super().__init__(plan, job)
        self.read_dataset, self.sh_degree = read_dataset, sh_degree

    def views(self):
        self.dataset = self.read_dataset()

    def check(self):
        dataset, plan = self.dataset, self.plan
        check_request(dataset, plan)
        # there is no splat yet that would show whether photographs need it
        sure = lambda asked: "off" if asked == "auto" else asked
        plan = replace(plan, exposure=sure(plan.exposure), refine_poses=sure(plan.refine_poses))
        self.plan, self.given = plan, dataset
        if (plan.target or plan.share) and not plan.prunes:
            raise SceneError(CANNOT_REACH.format(plan.method.name))
        growth = plan.phases[0].densify
        if isinstance(growth, MCMC) and 0 < growth.cap < len(dataset.points):
            raise SceneError(
                f"the scene starts with {len(dataset.points):,} points, and may grow up to {growth.cap:,}"
                " Gaussians: ask for more"
            )
        refuse_unseen_points(dataset)
        needed = refuse_excess("training", len(dataset.points), (self.sh_degree + 1) ** 2, dataset, plan)
        self.job = self.job.fitting(dataset.cameras, needed)

    def budget(self):
        if self.job.limit:
            self.plan, self.job = training_within(self.plan, self.dataset, self.job, self.sh_degree)

    def select(self):
        dataset, plan = self.dataset, self.plan
        with self.clock.phase("initialise"):
            growth = plan.phases[0].densify or Densify()
            points, unit = (dataset.points, dataset.point_colors), dataset.cameras[0].unit
            start = scene_from_points(*points, self.sh_degree, *growth.INITIAL, unit)
            most = max(start.count, plan.target)
            self.room.hold_for(start, most, plan.averaged_count(most))
            self.model = Model.of(start, copy=False)

    def measure(self) -> dict[str, Any]:
        with self.clock.phase("evaluate"):
            after = self.measured(read_back(self.job.out, self.scene), self.job.out)
            self.notes += self.rounding_notes(after["psnr"])
        return self.timed({**after, **self.facts()})


def refuse_unseen_points(dataset: Dataset):
    """Raises SceneError if no training view sees a sparse point: training would end with black pictures."""
    if not any_in_view(dataset.points, dataset.cameras, dataset.training_cameras):
        count, near = len(dataset.points), near_depth(dataset.cameras[0].unit)
        raise SceneError(
            f"no training view sees any of the {count:,} sparse points more than {near:g} in front of it; run"
            " COLMAP again, or scale the model up"
        )

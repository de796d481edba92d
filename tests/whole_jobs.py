"""Whole jobs of the pipeline with a dataset and a plan that a test has made."""

from __future__ import annotations

from pathlib import Path

from svrgs_addon.finetune.plan import Plan
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.pipeline import run
from svrgs_addon.prune.recipes.fine_tuned import FineTuned
from svrgs_addon.prune.recipes.trained import Trained
from svrgs_addon.views.dataset import Dataset


def prune(scene: Path, dataset: Dataset, plan: Plan, job: JobContext) -> dict:
    return run(FineTuned(scene, plan, job, lambda _: dataset))


def train(dataset: Dataset, plan: Plan, job: JobContext, sh_degree: int = 3) -> dict:
    return run(Trained(plan, job, lambda: dataset, sh_degree))

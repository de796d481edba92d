"""The plan of a job with a time limit: what the job costs on this machine (duration.py), and the schedule
that fits (time_plan.py)."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..files.registry import format_to_write, round_trip
from ..finetune.model import scene_from_points
from ..finetune.plan import Plan, at_schedule
from ..finetune.settings import Densify
from ..scene.gaussians import Scene
from ..views.dataset import Dataset
from .context import JobContext
from .duration import pace_of
from .expected_count import Expected
from .quality_forecast import forecast, is_foreseen
from .report.prune_report import REPORT_VIEWS
from .seen import fewer_bands, seen_from
from .time_plan import TRAINING_MARGIN, TimePlan, fitted, of_checkpoint

PART = 8192  # Gaussians by which it is foreseen how long writing takes


def pruning_within(
    plan: Plan, scene: Scene, read: float, dataset: Dataset, job: JobContext
) -> tuple[Plan, JobContext]:
    """The plan of `svrgs prune` that keeps the time limit of the job, and the context with it. plan: with the
    whole schedule. read: seconds of reading the splat. It tells what it expects. Raises SceneError if the
    time is too short; FormatError."""
    if found := of_checkpoint(job.limit, job.folder) if job.resume else None:
        return _with(found, plan, job, "the job goes on as it was planned")
    banded = fewer_bands(scene, plan.sh_degree, ())
    pace = pace_of(banded, dataset, plan, job.lpips)
    expected = Expected(plan, scene, dataset)
    kept = expected.kept
    # writing a file with all values takes about as long as reading
    others = read + _rounding(banded, dataset, kept, job.out)
    others += 2 * REPORT_VIEWS * pace.measured if job.report else 0.0
    seconds_of = lambda some: pace.pruning(some, kept / scene.count, job.recorded)
    fit = lambda: fitted(job.limit, plan, seconds_of, job.seconds() + others)
    found, quality = fit(), None
    if is_foreseen(some := at_schedule(plan, found.schedule)):
        quality = forecast(scene, dataset, some, expected.order, kept)
        found = fit()  # the forecast has taken some of the time
    psnr = f"PSNR about {quality.after:.1f} dB or more (now {quality.before:.1f} dB)" if quality else ""
    return _with(found, plan, job, f"about {kept:,} of {scene.count:,} Gaussians stay", psnr)


def _rounding(scene: Scene, dataset: Dataset, kept: int, out: Path) -> float:
    """Seconds of writing the result in a format that rounds, by those of a part of the splat. Raises
    SceneError, FormatError."""
    if (splat_format := format_to_write(out)).lossless:
        return 0.0
    part = scene.select(np.linspace(0, scene.count - 1, min(kept, PART)).astype(int))
    started = time.perf_counter()
    seen = seen_from(part, dataset.training_cameras, out)
    round_trip(part, splat_format, seen=seen)
    return (time.perf_counter() - started) * kept / part.count


def training_within(plan: Plan, dataset: Dataset, job: JobContext, sh_degree: int) -> tuple[Plan, JobContext]:
    """As pruning_within(), for `svrgs train`. How many Gaussians a training adds is not known before, so it
    is less exact."""
    if found := of_checkpoint(job.limit, job.folder) if job.resume else None:
        return _with(found, plan, job, "the job goes on as it was planned")
    growth = plan.phases[0].densify or Densify()
    points, unit = (dataset.points, dataset.point_colors), dataset.cameras[0].unit
    start = scene_from_points(*points, sh_degree, *growth.INITIAL, unit)
    pace = pace_of(start, dataset, plan, job.lpips)
    seconds_of = lambda some: pace.training(some, job.recorded)
    found = fitted(job.limit, plan, seconds_of, job.seconds(), TRAINING_MARGIN)
    return _with(found, plan, job, "a quarter more or less, as the scene grows")


def _with(found: TimePlan, plan: Plan, job: JobContext, *foreseen: str) -> tuple[Plan, JobContext]:
    """The plan with the schedule that was found, and the context with both. It tells what is foreseen."""
    chosen = at_schedule(plan, found.schedule)
    job.tell(found, found.sentence(chosen, *foreseen))
    return chosen, replace(job, planned=found)

"""An estimate, within a few seconds, of how many Gaussians pruning would keep, how good the result would be
and how long it would take.

It renders some views and measures the speed of a few steps. Child process: `python -m
svrgs_addon.jobs.estimate`. It reads {"scene": file, "options": options of a job, "suffix": of a file} as JSON
from stdin and writes the result of estimate(), or {"error": sentence}, to stdout.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from ..files.registry import USUAL, format_to_write, invisible, load_scene
from ..files.splat_format import SplatFormat
from ..finetune.plan import Plan, at_schedule
from ..finetune.quality import hold_apart
from ..finetune.scores import top
from ..native import library
from ..prune.belonging import check_dataset
from ..prune.context import PROCESS
from ..prune.door import check_view_options, check_views, check_visible
from ..prune.duration import pace_of
from ..prune.expected_count import Expected
from ..prune.file_size import asked_size, bytes_of
from ..prune.options import PruneOptions
from ..prune.photographs import in_its_colours
from ..prune.plans import dataset_of_pruning, plan_of_pruning
from ..prune.quality_forecast import forecast
from ..prune.recipes.quick import like_quick
from ..prune.seen import fewer_bands
from ..prune.time_plan import fitted
from ..render.overdraw import overdraw
from ..scene.camera import spaced
from ..scene.gaussians import Scene
from ..system.errors import SceneError
from ..system.exit_status import answer
from ..system.file_names import extended
from ..system.option_kinds import check_mapping
from ..views.dataset import Dataset
from ..views.rendered import RenderedDataset
from .job_recorder import RECORDED

OVERDRAW_VIEWS = 4  # in which it is counted


def estimate(options: PruneOptions, suffix: str = USUAL.suffixes[0]) -> dict:
    """The estimate, a dict with these keys; suffix: of the format whose size it foresees. Raises SplatError.

    count: Gaussians of the scene; invisible: those with an opacity below 1/255; unseen: those that no
    rendered view sees; faint: those that the first cut removes; kept: roughly how many stay; at_most: whether
    kept is an upper bound; format: its label; bytes_before, bytes_after: the size of a file of all Gaussians
    and of those kept; views: number of rendered views; psnr_before, psnr_removed, psnr_after: as in
    quality_forecast.Forecast, without "psnr_"; psnr_before is None on the splat's own pictures;
    overdraw_before, overdraw_after: Gaussians that a pixel blends (render/overdraw.py), now and of those
    kept; steps: of the run; steps_per_second: with all Gaussians; schedule: that of the options, or the one
    that fits into their time limit; seconds: expected time of the whole job; notes: sentences on the dataset
    and whether the splat belongs to it.
    """
    begun = time.perf_counter()
    library.set_threads(options.threads)
    assert options.scene is not None
    check_view_options(options)
    scene = load_scene(options.scene)
    check_visible(scene, "the splat")
    read = time.perf_counter() - begun
    options, dataset = (
        like_quick(options, scene) if options.quick else (options, dataset_of_pruning(options, scene))
    )
    loaded = time.perf_counter() - begun
    check_views(scene, dataset.cameras, dataset.train_indices, "the splat")
    plan, of_size = _plan(options, scene, dataset)
    toned = in_its_colours(scene, dataset, plan)
    dataset = toned.dataset
    if plan.max_loss:
        dataset = hold_apart(dataset, plan.measure)
    pace, expected = pace_of(scene, dataset, plan), Expected(plan, scene, dataset)
    seen, measured = expected.seen, time.perf_counter() - begun
    kept = expected.kept
    seconds_of = lambda some: pace.pruning(some, kept / scene.count, RECORDED)
    # writing takes about as long as reading; a job with a time limit measures the speed, too
    others = PROCESS + read + (measured if options.time else loaded)
    found = fitted(options.time, plan, seconds_of, others) if options.time else None
    plan = at_schedule(plan, found.schedule) if found else plan
    order = expected.order
    quality = forecast(scene, dataset, plan, order, kept)
    some = spaced(dataset.cameras, OVERDRAW_VIEWS)
    return {
        "count": scene.count,
        "invisible": int(invisible(scene).sum()),
        "unseen": int((seen.hits == 0).sum()),
        "faint": int((seen.peaks < plan.min_contribution).sum()),
        "kept": kept,
        "at_most": bool(plan.max_loss),
        **_sizes(scene, kept, plan, format_to_write(f"x{suffix}")),
        "views": seen.views,
        **{f"psnr_{name}": value for name, value in quality._asdict().items()}
        | ({"psnr_before": None} if isinstance(dataset, RenderedDataset) else {}),
        "overdraw_before": overdraw(scene, some),
        "overdraw_after": overdraw(scene.select(np.flatnonzero(top(order, kept))), some),
        "steps": plan.total,
        "steps_per_second": 1 / pace.step,
        "schedule": found.schedule if found else options.schedule,
        "seconds": others + seconds_of(plan),
        "notes": [*of_size, *dataset.notes, *toned.notes, *_doubts(scene, toned.dataset, options.force)],
    }


def _plan(options: PruneOptions, scene: Scene, dataset: Dataset) -> tuple[Plan, list[str]]:
    """The plan, and what the user must know of it."""
    plan, size = plan_of_pruning(options), asked_size(options)
    return size.planned(plan, scene, dataset.training_cameras) if size else (plan, [])


def _sizes(scene: Scene, kept: int, plan: Plan, kind: SplatFormat) -> dict:
    """Of a file of all Gaussians, and of those kept."""
    after = bytes_of(fewer_bands(scene, plan.sh_degree, ()), kept, kind)
    return {"format": kind.label, "bytes_before": bytes_of(scene, scene.count, kind), "bytes_after": after}


def _doubts(scene: Scene, dataset: Dataset, force: bool) -> list[str]:
    """What is said or refused when the job starts, if views or photographs seem to be of another splat."""
    try:
        return check_dataset(scene, dataset, "the splat", force)[0]
    except SceneError as error:
        return [str(error)]


def _estimate_request(request: dict) -> dict:
    options = check_mapping(PruneOptions, request["options"])
    return estimate(PruneOptions(**options, scene=extended(request["scene"])), request["suffix"])


if __name__ == "__main__":
    sys.exit(answer(_estimate_request))

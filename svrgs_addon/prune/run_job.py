"""From options to a finished job. This module turns options into a plan (method, phases, target); later code
reads only the plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..files import registry
from ..finetune.methods import DEFAULT, method_named, paper_method
from ..finetune.methods.base import Method
from ..finetune.plan import Plan, prune_plan, train_plan
from ..finetune.settings import MCMC, Densify
from ..native import library
from ..render.metrics import load_lpips
from ..system.errors import MemoryShort, SceneError, TooMany
from ..system.option_kinds import default_of, options_of
from ..views.dataset import Dataset, load_dataset
from . import by_blocks, train_and_prune
from .context import JobContext
from .options import MIN_CONTRIBUTION, RECOVERY, DatasetOptions, PruneOptions, TrainOptions, TuningOptions, refuse_time_and_steps
from .planning import pruning_within, training_within
from .progress import Reporter
from .quick import prune_quick
from .rendered_views import rendered_dataset
from .stop_request import StopRequest

# changes the context of the command line; a background job adds its own observer and stop
Adapt = Callable[[JobContext], JobContext]


def train_scene(options: TrainOptions, adapt: Adapt = lambda job: job) -> dict:
    """Does `svrgs train`. Returns the JSON result. Raises SplatError; Cancelled if stopped, after a
    checkpoint."""
    assert options.out is not None
    library.set_threads(options.threads)
    job, plan = _context(options, options.out), plan_of_training(options)
    train_and_prune.check_outputs(job)
    dataset = dataset_of(options, need_points=True)
    with StopRequest() as stop:
        job = adapt(replace(job, stop=stop))
        if options.time:
            plan, job = training_within(options.time, plan, dataset, job, options.sh_degree)
        return train_and_prune.train(dataset, plan, job, options.sh_degree)


def prune_scene(options: PruneOptions, adapt: Adapt = lambda job: job) -> dict:
    """Does `svrgs prune` of options.scene. Returns the JSON result. Raises SplatError; Cancelled if stopped,
    after a checkpoint."""
    library.set_threads(options.threads)
    assert options.out is not None
    reason = (
        f"{options.scene}: its blocks are there from an earlier start" if by_blocks.was_begun(options) else ""
    )
    if not reason:
        try:
            return _prune_whole(options, adapt)
        except (MemoryShort, TooMany) as error:
            if not by_blocks.possible(options):
                raise by_blocks.with_advice(error, options) from None
            # what follows is outside of the except: there, the error still holds the scene in memory
            reason = str(error)
    with StopRequest() as stop:
        return by_blocks.prune_large(options, adapt(JobContext(options.out, stop=stop)), reason)


def _prune_whole(options: PruneOptions, adapt: Adapt) -> dict:
    """With the whole scene in memory. Raises MemoryShort or TooMany before anything is done if that is too
    large."""
    if options.quick:
        assert options.out is not None
        with StopRequest() as stop:
            return prune_quick(options, adapt(JobContext(options.out, stop=stop)))
    assert options.scene is not None and options.out is not None
    job, plan = (
        replace(_context(options, options.out, options.report), levels=options.levels),
        plan_of_pruning(options),
    )
    train_and_prune.check_outputs(job)
    dataset = dataset_of_pruning(options)
    with StopRequest() as stop:
        job = adapt(replace(job, stop=stop))
        if options.time:
            plan, job = pruning_within(options.time, plan, options.scene, dataset, job)
        return train_and_prune.prune(options.scene, dataset, plan, job)


def plan_of_training(options: TrainOptions) -> Plan:
    """The plan of `svrgs train`. Raises SceneError if the options contradict each other."""
    method = method_of(options)
    recovery = options.recovery if options.recovery is not None else RECOVERY * method.prunes
    target = 0 if _target_is_cap(options) else options.target_count or 0
    more: dict[str, Any] = {
        "densify": densify_of(options),
        "coarse_until": options.coarse_until,
        "target": target,
        "share": options.target or 0.0,
    }
    return train_plan(method, options.iterations, recovery, **_settings(options), **more)


def densify_of(options: TrainOptions) -> Densify:
    """The rules by which training adds Gaussians. Raises SceneError if the cap is missing, or has no
    effect."""
    if options.densify != "mcmc":
        if options.cap is not None:
            raise SceneError("--cap limits the growth of --densify mcmc: add it, or leave --cap out")
        return Densify.within(options.iterations, options.densify_until)
    cap = options.cap or (options.target_count if _target_is_cap(options) else None)
    if cap is None:
        raise SceneError("--densify mcmc needs --cap N, the number of Gaussians up to which the scene grows")
    return MCMC.capped(cap, options.iterations, options.densify_until)


def _target_is_cap(options: TrainOptions) -> bool:
    """Whether --target-count says how far the scene grows, because the method prunes nothing."""
    return options.densify == "mcmc" and options.cap is None and not method_of(options).prunes


def plan_of_pruning(options: PruneOptions) -> Plan:
    """The plan of `svrgs prune`. Raises SceneError if the options contradict each other; FormatError if a
    share of the scene is the target and the file cannot be read."""
    method = method_of(options)
    first_cut = (
        options.min_contribution
        if options.min_contribution is not None
        else MIN_CONTRIBUTION * method.first_cut
    )
    more: dict[str, Any] = {
        "target": _target(options, method),
        "max_drop": options.max_drop,
        "min_contribution": first_cut,
        "nested": _nested(options),
    }
    return prune_plan(method, options.iterations, options.recovery, **_settings(options), **more)


def method_of(options: TuningOptions) -> Method:
    """The method of options.method and options.paper. Raises SceneError if it does not exist."""
    # quicker and better than removals, on the splat's own pictures
    merges = options.colmap is None and (options.target or options.target_count)
    method = method_named(options.method or ("merge" if merges else DEFAULT))
    if options.paper and options.method != "svr":
        raise SceneError(
            f"--paper chooses the paper's settings of method 'svr', not of '{method.name}': add --method svr"
        )
    return paper_method() if options.paper else method


def dataset_of_pruning(options: PruneOptions) -> Dataset:
    """The dataset of the options; without one, views of the scene itself. Raises SceneError, FormatError."""
    if options.colmap is None:
        return rendered_dataset(options)
    if options.cameras or options.seen_from_only:
        raise SceneError(
            "--cameras and --seen-from-only are for scenes without photographs: leave them out, or --colmap"
        )
    return dataset_of(options)


def dataset_of(options: DatasetOptions, need_points: bool = False) -> Dataset:
    """The dataset of the options. Raises SceneError, FormatError."""
    assert options.colmap is not None
    return load_dataset(
        options.colmap, options.images or None, holdout=options.holdout, background=options.background, need_points=need_points,
        memory_budget=int(options.image_memory * 1e9),
    )  # fmt: skip


def _settings(options: TuningOptions) -> dict[str, Any]:
    """The settings that training and pruning have in common. Raises SceneError for a time limit together with
    a number of steps."""
    refuse_time_and_steps(
        type(options),
        [
            name
            for name in options_of(type(options))
            if getattr(options, name) != default_of(type(options), name)
        ],
    )
    return {
        "lambda_f": options.lambda_f, "lambda_m": options.lambda_m, "seed": options.seed, "full": not options.visible_mask,
        "background": options.background, "views_by_loss": options.views_by_loss, "schedule": options.schedule,
    }  # fmt: skip


def _target(options: PruneOptions, method: Method) -> int:
    """The number of Gaussians to keep; 0: the method decides."""
    if options.target_count is not None:
        return options.target_count
    share = options.target or (0.0 if options.max_drop else method.share)
    return max(1, round(share * registry.describe(options.scene)["count"])) if share and options.scene else 0


def _nested(options: PruneOptions) -> float:
    """The share of the result down to which smaller numbers of Gaussians are trained; 0: none. Raises
    SceneError if no steps would train them."""
    smallest = min([*options.levels, *([options.nested] if options.nested else [])], default=0.0)
    if smallest and not options.recovery:
        raise SceneError(
            "--nested and --levels train smaller numbers of Gaussians in the recovery: give --recovery a"
            " number above 0"
        )
    return smallest


def _context(options: TuningOptions, out: Path, report: Path | None = None) -> JobContext:
    lpips, missing = load_lpips(options.lpips_weights)
    reporter = Reporter(options.quiet)
    return JobContext(
        out,
        report,
        options.resume,
        options.engine,
        lpips=lpips,
        lpips_missing=missing,
        observe=reporter,
        tell=lambda _, sentence: reporter.say(sentence),
    )

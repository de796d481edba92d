"""From options to a plan: method, phases, target; to the dataset, and to the context of the job."""

from __future__ import annotations

from typing import Any

from ..files import registry
from ..finetune.methods import DEFAULT, method_named, paper_method
from ..finetune.methods.base import Method
from ..finetune.plan import Plan, prune_plan, train_plan
from ..finetune.settings import MCMC, Densify
from ..render.metrics import load_lpips
from ..scene.gaussians import Scene
from ..system.errors import FormatError, SceneError
from ..views.dataset import Dataset, load_dataset
from ..views.rendered import RenderedDataset
from ..views.valid_pixels import MaskOptions
from .context import JobContext
from .door import SIZES, allowed_loss, degree_to_keep, given
from .job_views import without_photographs
from .options import (
    MIN_CONTRIBUTION,
    RECOVERY,
    DatasetOptions,
    PruneOptions,
    TrainOptions,
    TuningOptions,
    refuse_time_and_steps,
)
from .progress import Reporter

# options that a plan takes as they are; and those of a pruning that its context does
SAME = (
    "lambda_f", "lambda_m", "seed", "background", "views_by_loss", "exposure", "refine_poses", "schedule",
)  # fmt: skip
OF_CONTEXT = ("report", "force", "scene", "levels")


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
    method, allowed = method_of(options), allowed_loss(options)
    more: dict[str, Any] = {
        "target": _target(options, method),
        "max_loss": allowed.loss,
        "measure": allowed.measure,
        "min_contribution": first_cut_of(options, method),
        "nested": _nested(options),
        "sh_degree": degree_to_keep(options),
    }
    return prune_plan(method, options.iterations, options.recovery, **_settings(options), **more)


def first_cut_of(options: PruneOptions, method: Method) -> float:
    """The least alpha T that a Gaussian must have in a pixel to pass the first cut; 0: no such cut."""
    given = options.min_contribution
    return MIN_CONTRIBUTION * method.first_cut if given is None else given


def method_of(options: TuningOptions) -> Method:
    """The method of options.method and options.paper. Raises SceneError if it does not exist."""
    # quicker and better than removals, on the splat's own pictures
    merges = options.data is None and any(getattr(options, name, None) for name in SIZES)
    method = method_named(options.method or ("merge" if merges else DEFAULT))
    if options.paper and options.method != "svr":
        raise SceneError(
            f"--paper chooses the paper's settings of method 'svr', not of '{method.name}': add --method svr"
        )
    return paper_method() if options.paper else method


def dataset_of_pruning(options: PruneOptions, scene: Scene) -> Dataset:
    """The dataset of the options; without one, views of the scene itself, which the dataset keeps. Raises
    SceneError, FormatError."""
    if options.data is not None:
        return dataset_of(options)
    train, test, notes, facts = without_photographs(options, scene)
    return RenderedDataset.of(
        scene,
        train,
        test,
        background=options.background,
        memory_budget=int(options.image_memory * 1e9),
        notes=tuple(notes),
        facts=facts,
    )


def dataset_of(options: DatasetOptions, need_points: bool = False) -> Dataset:
    """The dataset of the options. Raises SceneError, FormatError."""
    assert options.data is not None
    return load_dataset(
        options.data,
        options.images or None,
        holdout=options.holdout,
        background=options.background,
        need_points=need_points,
        memory_budget=int(options.image_memory * 1e9),
        masks=mask_options(options),
    )


def mask_options(options: DatasetOptions) -> MaskOptions:
    return MaskOptions(options.masks, options.invert_masks, options.outside)


def _settings(options: TuningOptions) -> dict[str, Any]:
    """The settings that training and pruning have in common. Raises SceneError for a time limit together with
    a number of steps."""
    refuse_time_and_steps(type(options), given(options))
    return {
        **{name: getattr(options, name) for name in SAME},
        "full": not options.visible_mask,
        "mask_distractors": isinstance(options, PruneOptions) and options.mask_distractors,
    }


def _target(options: PruneOptions, method: Method) -> int:
    """The number of Gaussians to keep; 0: the method decides."""
    if options.target_count is not None:
        return options.target_count
    share = options.target or (0.0 if allowed_loss(options).loss else method.share)
    if not (share and options.scene):
        return 0
    facts = registry.describe(options.scene)
    return max(1, round(share * (facts["count"] - facts["nonfinite"])))


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


def context_of(options: TrainOptions | PruneOptions) -> JobContext:
    """Where a job writes, what it reads, and its progress on stderr."""
    assert options.out is not None
    reporter = Reporter(options.quiet)
    of_pruning: dict[str, Any] = {}
    if isinstance(options, PruneOptions):
        of_pruning = {name: getattr(options, name) for name in OF_CONTEXT}
    asked = options.lpips_weights is not None or bool(getattr(options, "max_lpips", 0.0))
    try:  # it takes seconds a view: unasked, it is measured for a report alone
        measured = asked or of_pruning.get("report")
        lpips, missing = load_lpips(options.lpips_weights or (None if measured else ""))
    except FormatError as error:
        if asked:
            raise
        lpips, missing = None, str(error)
    return JobContext(
        options.out,
        resume=options.resume,
        engine=options.engine,
        limit=options.time,
        **of_pruning,
        lpips=lpips,
        lpips_asked=asked,
        lpips_missing=missing,
        observe=reporter,
        part=reporter.part,
        tell=lambda _, sentence: reporter.say(sentence),
    )

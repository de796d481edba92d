"""`svrgs prune` of a scene that is too large for memory. Jobs that remove and merge, and methods with
lambda_F, are done by blocks (prune/blocks/) instead."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import partial

from ..finetune.methods import DEFAULT
from ..system import memory
from ..system.errors import MemoryShort, TooMany
from . import job_views
from .blocks.folder import blocks_of
from .blocks.request import Request, methods, methods_of_drop
from .blocks.tasks import progress
from .context import JobContext
from .door import given
from .options import PruneOptions
from .recipes.by_blocks import Goal, LearnedByBlocks, MergedByBlocks

TAKES = (  # options; with others, the scene must be read as a whole
    "data", "images", "holdout", "cameras", "seen_from_only", "lpips_weights", "threads", "seed", "target",
    "target_count", "quiet", "quick", "force", "method", "scene", "out", "resume",
)  # fmt: skip
OF_QUICK = ("max_drop", "levels")  # options that only a quick job has there
OF_METHODS = (  # those of methods on photographs
    "lambda_f", "iterations", "recovery", "schedule", "min_contribution", "background", "masks",
    "invert_masks", "outside", "image_memory", "visible_mask", "report",
)  # fmt: skip
NEEDS_VISIBLE = (
    "with --visible-mask, or with removal to a number or an allowed drop, it would be pruned by blocks"
)


def possible(options: PruneOptions) -> bool:
    """Whether a job can be done by blocks: a quick one, one that merges without photographs, to a number, or
    one of a method with lambda_F on photographs, if F counts up to where the colours of a ray stop, or does
    not count."""
    if _learns(options):
        held = ("max_drop",) if (options.method or DEFAULT) in methods_of_drop() else ()
        return _has_only(options, (*TAKES, *OF_METHODS, *held)) and (
            options.visible_mask or _to_number(options)
        )
    merges = options.quick or (options.data is None and options.method in ("", "merge"))
    takes = (*TAKES, *OF_QUICK) if options.quick else TAKES
    return merges and bool(options.quick or _number(options)) and _has_only(options, takes)


def was_begun(options: PruneOptions) -> bool:
    """Whether a job that is resumed was begun by blocks."""
    assert options.out is not None
    learns = options.resume and _learns(options) and possible(options)
    return learns and bool(progress(blocks_of(options.out))[0])


def _learns(options: PruneOptions) -> bool:
    return options.data is not None and not options.quick and (options.method or DEFAULT) in methods()


def _number(options: PruneOptions) -> bool:
    return bool(options.target or options.target_count)


def _to_number(options: PruneOptions) -> bool:
    """Whether the method removes down to a number that is given or found, without F."""
    return (options.method or DEFAULT) == DEFAULT and (_number(options) or bool(options.max_drop))


def _has_only(options: PruneOptions, names: Collection[str]) -> bool:
    """Whether only the options with these names differ from their defaults."""
    return set(given(options)) <= set(names)


def with_advice(error: MemoryShort | TooMany, options: PruneOptions) -> MemoryShort | TooMany:
    """The error of a job that cannot be done by blocks, with what can be."""
    sentence = memory.without_advice(str(error))
    visible = _learns(options) and possible(replace(options, visible_mask=True))
    return type(error)(f"{sentence}; {NEEDS_VISIBLE if visible else memory.BY_BLOCKS}")


def recipe_of(options: PruneOptions, job: JobContext, reason: str) -> MergedByBlocks | LearnedByBlocks:
    """The recipe of `svrgs prune` by blocks. reason: why, in a sentence. Raises SplatError."""
    assert options.scene is not None
    goal = Goal(options.target_count or 0, options.target or 0.0, options.max_drop or 0.0, options.levels)
    scene, reason = options.scene, memory.without_advice(reason)
    views_of = partial(job_views.by_blocks, options)
    if _learns(options):
        return LearnedByBlocks(scene, job, goal, views_of, request=Request.of(options), reason=reason)
    return MergedByBlocks(scene, job, goal, views_of, reason=reason)

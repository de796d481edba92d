"""One way to prune and to train: open, views, check, rank, budget, select, tune, write, measure.

Each step is a method of a recipe (recipe.py, recipes/): fine-tuned in memory, quick, a training, or by blocks
on the disk. A recipe keeps what one step hands to the next. The door (door.py) is the same for all.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from ..native import library
from ..system.errors import MemoryShort, TooMany
from . import by_blocks, plans
from .context import JobContext
from .door import check_view_options, outputs
from .file_size import asked_size
from .options import PruneOptions, TrainOptions
from .recipe import Recipe
from .recipes.fine_tuned import FineTuned
from .recipes.quick import Quick
from .recipes.trained import Trained
from .report.page import refuse_other_page
from .stop_request import StopRequest

# changes the context of the command line; a background job adds its own observer and stop
Adapt = Callable[[JobContext], JobContext]


def train_scene(options: TrainOptions, adapt: Adapt = lambda job: job) -> dict[str, Any]:
    """Runs `svrgs train`. Returns the JSON result. Raises SplatError; Cancelled if stopped, after a
    checkpoint."""
    library.set_threads(options.threads)
    job, plan = plans.context_of(options), plans.plan_of_training(options)
    return run(Trained(plan, job, lambda: plans.dataset_of(options, True), options.sh_degree), adapt)


def prune_scene(options: PruneOptions, adapt: Adapt = lambda job: job) -> dict[str, Any]:
    """Runs `svrgs prune` of options.scene. Returns the JSON result. Raises SplatError; Cancelled if
    stopped."""
    library.set_threads(options.threads)
    check_view_options(options)
    with contextlib.ExitStack() as held:
        return _finished(_begun(options, held), adapt)


def _begun(options: PruneOptions, held: contextlib.ExitStack) -> Recipe:
    """The recipe after its first steps: in memory, or by blocks where these find that memory is too short.
    held: closes the recipe at the end."""
    reason = f"{options.scene}: its blocks are there from an earlier start"
    if not by_blocks.was_begun(options):
        try:
            return held.enter_context(_prepared(in_memory(options)))
        except (MemoryShort, TooMany) as error:
            if not by_blocks.possible(options):
                raise by_blocks.with_advice(error, options) from None
            reason = str(error)
    # outside of the except, because there the error holds the scene in memory
    return held.enter_context(_prepared(by_blocks.recipe_of(options, plans.context_of(options), reason)))


def in_memory(options: PruneOptions) -> Recipe:
    """The recipe of a scene that fits into memory. Raises SplatError."""
    job = plans.context_of(options)
    if options.quick:
        return Quick(options, job)
    assert options.scene is not None
    dataset = lambda scene: plans.dataset_of_pruning(options, scene)
    plan, size = plans.plan_of_pruning(options), asked_size(options)
    return FineTuned(options.scene, plan, job, dataset, size)


def run(recipe: Recipe, adapt: Adapt = lambda job: job) -> dict[str, Any]:
    """All steps of a recipe, in order. Returns the JSON result. Raises SplatError; Cancelled if stopped."""
    with _prepared(recipe):
        return _finished(recipe, adapt)


@contextlib.contextmanager
def _prepared(recipe: Recipe) -> Iterator[Recipe]:
    """The recipe after the door and the steps that change nothing. Its outputs are reserved as long as the
    context lasts, and it is closed at the end."""
    job = recipe.job
    further = [job.report / "index.html"] if job.report else []
    with outputs(job.scene, job.outs, [*further, *recipe.further_files()]), contextlib.closing(recipe):
        if job.report:
            refuse_other_page(job.report)
        recipe.open()
        recipe.views()
        recipe.check()
        yield recipe


def _finished(recipe: Recipe, adapt: Adapt) -> dict[str, Any]:
    """The steps that change and write. Ctrl-C stops them in order."""
    with StopRequest() as stop:
        given = recipe.job.stop
        recipe.job = adapt(replace(recipe.job, stop=lambda: given() or stop()))
        recipe.rank()
        recipe.budget()
        recipe.select()
        recipe.tune()
        recipe.write()
        return recipe.measure()

"""By blocks on the disk, for scenes larger than memory: removals and merges, or a method that decides on
photographs."""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ...files.atomic import check_space
from ...files.digests import scene_sha256
from ...files.level_files import holds_levels
from ...finetune.plan import Plan
from ...finetune.quality import MIN_SHARE, NOT_APART
from ...render.metrics.allowed_loss import missed_loss
from ...scene.camera import Camera
from ...scene.gaussians import Scene
from ...system import memory
from ...system.errors import Cancelled
from ..belonging import check_explained, check_seen, seen_of
from ..blocks.allowed_drop import AllowedDrop
from ..blocks.block_rasterizer import BlockRasterizer, opened
from ..blocks.divided import MAX_BLOCK_COUNT, Divided, MaxBlockCount, Progress, ProgressOf, divide
from ..blocks.folder import LEVEL, SCORED, blocks_of, prepare, refuse_foreign, remove, scored_views
from ..blocks.learning import AROUND_SHARE, decide, prepare_around, recover, targets
from ..blocks.merging import CELL, merge, reduce, with_seen
from ..blocks.pruning import finish, finish_learned, join_levels, original_likeness, result_notes, write_left
from ..blocks.request import Request
from ..blocks.sample import sample_of
from ..blocks.scoring import score
from ..blocks.tasks import Overall, Rounds, Tasks
from ..blocks.tuning import EPOCHS, cut, tune
from ..context import JobContext
from ..door import check_visible
from ..job_views import Views
from ..likeness import Likeness, PhotographLikeness, assumed_drop
from ..recipe import Recipe
from ..report.prune_report import write_report_of_files

# bytes: no limit, because fine-tuning on pictures of the scene keeps all of them in memory
PICTURES = 1 << 62
# of the available memory, for fine-tuning a block; the rest is for scores, for reading, and for freed memory
# that the system does not get back
SHARE = 0.5
# space that the steps need at least: for sums and orders, in sizes of all blocks; copies of what stays
SUMS, COPIES = 1.2, 4
FIGURES = ("psnr", "ssim", "lpips", "flip")  # that are measured
ORDER, ALLOWED = "order", "number"  # tasks: the first one that takes long; the number of an allowed drop


@dataclass(frozen=True)
class Goal:
    """How many Gaussians stay: a number, a share, or as few as an allowed drop in dB leaves; and of levels of
    detail, shares of that."""

    count: int = 0
    share: float = 0.0
    max_drop: float = 0.0
    levels: tuple[float, ...] = ()

    def number(self, count: int) -> int:
        """The Gaussians that stay of so many, if no drop is allowed."""
        return self.count or max(1, round((self.share or 1.0) * count))


class ByBlocks(Recipe):
    """What both ways by blocks have in common."""

    divided: Divided  # from rank() on, as the next two
    likeness: Likeness
    overall: Overall

    def __init__(
        self,
        source: Path,
        job: JobContext,
        goal: Goal,
        views_of: Callable[[Scene, float], Views],
        work: Path | None = None,
        block: int | None = None,
        reason: str = "",
    ):
        """views_of: gives the views for a sample of the scene, and by how much its Gaussians are enlarged
        (blocks/sample.py). work: folder for the blocks; None: beside the output. block: Gaussians of a block,
        at most; None: as memory allows. reason: why `svrgs prune` goes over to blocks, a sentence; "": blocks
        were asked for."""
        self.source, self.goal, self.views_of = source.absolute(), goal, views_of
        self.job = replace(job, scene=source, levels=goal.levels)
        self.work, self.block, self.reason = work or blocks_of(job.out), block, reason
        self.begun, self.started = time.perf_counter(), False
        if reason:
            logging.warning("%s; it is pruned by blocks, which takes longer", reason)

    def open(self):
        """The scene is read in parts, by rank()."""
        refuse_foreign(self.work)

    def views(self):
        self.sample, enlarged = sample_of(self.source)
        check_visible(self.sample, str(self.job.scene))
        self.scored, self.measured, self.notes, _ = self.views_of(self.sample, enlarged)

    def check(self):
        del self.sample  # frees memory
        self.job = self.job.fitting(self.compared())

    def compared(self) -> Sequence[Camera]:
        """The views in which the result is measured."""
        return self.measured

    def left_by_a_stop(self) -> str:
        """A sentence on what a job that is stopped leaves; "" for one that can be resumed."""
        return ""

    def progress_of(self, step: str) -> Progress:
        """Reports the progress of a step."""

        def progress(text: str, share: float):
            if self.job.stop():
                raise Cancelled(self.left_by_a_stop())
            self.job.part(f"{step}: {text}", share)

        return progress

    def allowed_drop(self) -> AllowedDrop:
        out, drop = self.job.out, self.goal.max_drop
        return AllowedDrop(self.divided, self.likeness.deciding, drop, out, self.overall)

    def of_prune(self, result: dict[str, Any], how: str) -> dict[str, Any]:
        """The result with what `svrgs prune` adds to that of `svrgs large prune`. how: for the note."""
        if not self.reason:
            return result
        after = _figures(result)
        notes = [f"{self.reason}; so it was pruned by blocks{how}", *self.notes, *result["notes"]]
        facts = {"seconds": time.perf_counter() - self.begun, "notes": notes}
        return {**result, **after, "after": after, **facts}


class MergedByBlocks(ByBlocks):
    """Removes and merges in an order, and fine-tunes what is left on pictures of the original."""

    def __init__(self, *arguments: Any, steps: int | None = None, **more: Any):
        """steps: of fine-tuning; None: EPOCHS for each view."""
        super().__init__(*arguments, **more)
        self.steps = steps

    def check(self):
        self.forced = check_seen(seen_of(self.sample, self.scored), str(self.source), self.job.force)
        super().check()

    def left_by_a_stop(self) -> str:
        what = "the files that are there are complete" if self.goal.levels else "nothing was written"
        steps = "the steps of svrgs large, each of which can be continued"
        return f"stopped; {what}: start it again, or use {steps}"

    def rank(self):
        goal, work, self.started = self.goal, self.work, True
        self.overall = Overall(self.progress_of, Rounds(1 + len(goal.levels)).span)
        prepare(work, self.scored, self.measured)
        self.scored = scored_views(work)
        block = self.block or as_memory_allows(self.scored, PICTURES)
        self.divided = divide(self.source, work, block, self.overall("divide"))
        _check_room(work, self.divided, goal)
        self.likeness = original_likeness(self.divided, self.overall, self.job.lpips)
        self.errors = self.allowed_drop().errors_of_format() if goal.max_drop else []
        _order(self.divided, self.scored, self.overall)

    def budget(self):
        goal, divided = self.goal, self.divided
        self.count = goal.number(divided.count)
        if goal.max_drop:
            self.count = self.allowed_drop().fewest_within(self.scored, self.errors)

    def select(self):
        """write() cuts, tunes and writes each level before the next one, as the disk has room for one."""
        self.shares = (1.0, *self.goal.levels)
        self.streamed = bool(self.goal.levels) and holds_levels(self.job.out)
        levels = [self.divided.folder / LEVEL.format(level) for level in range(len(self.shares))]
        self.files = levels if self.streamed else self.job.outs

    def write(self):
        divided, progress_of, self.results = self.divided, self.overall, []
        for share, path in zip(self.shares, self.files, strict=True):
            left = cut(divided, self.scored, max(1, round(share * self.count)), progress_of("cut"))
            wanted = EPOCHS * len(self.scored) if self.steps is None else self.steps
            for number in range(len(left.blocks)) if wanted and left.count < divided.count else ():
                progress = _part(progress_of("tune"), number, len(left.blocks))
                tune(divided, number, self.scored, wanted, progress)
            write = write_left if self.streamed else partial(finish, progress_of=progress_of)
            self.results.append(write(divided, self.likeness, path))
        if self.streamed:
            joined = join_levels(divided, self.likeness, self.files, self.job.out, progress_of)
            self.results = [result | new for result, new in zip(self.results, joined, strict=True)]

    def measure(self) -> dict[str, Any]:
        goal, results = self.goal, self.results
        levels = [
            {"share": share, "out": result["out"], **_figures(result)}
            for share, result in zip(goal.levels, results[1:], strict=True)
        ]
        notes = [*self.forced, *result_notes(self.likeness, results[0])]
        facts = {"views": len(self.scored), "levels": levels, "drop": None, "notes": notes}
        result = with_seen(self.divided, {**results[0], **facts})
        if goal.max_drop and result["psnr"] is not None:
            result |= _of_drop(result, assumed_drop(result["psnr"]), goal)
        return self.of_prune(result, f", and fine-tuned in {EPOCHS} steps for each view")

    def close(self):
        if self.started:
            remove(self.work)


class LearnedByBlocks(ByBlocks):
    """A method that decides on photographs, block by block, in its own steps.

    If it is stopped or fails later than in its first minutes, the blocks stay, and a resumed job goes on from
    there.
    """

    likeness: PhotographLikeness

    def __init__(self, *arguments: Any, request: Request, **more: Any):
        super().__init__(*arguments, **more)
        self.request, self.finished = request, False

    def views(self):
        if self.goal.max_drop:
            self.request.refuse_drop()
        self.dataset = self.request.dataset()
        super().views()

    def compared(self) -> Sequence[Camera]:
        return self.dataset.cameras

    def identity(self, plan: Plan) -> str:
        """Digest of all that must be the same in a job that is continued; where its files lie may differ.
        Raises SceneError."""
        dataset, cameras = self.dataset, [[one.key for one in some] for some in (self.scored, self.measured)]
        facts = plan, self.goal, self.block, dataset.train_indices, dataset.deciding_indices, cameras
        digest = hashlib.sha256(repr((scene_sha256(self.source), *facts)).encode())
        for part in dataset.inputs():
            digest.update(part)
        return digest.hexdigest()

    def rank(self):
        goal, dataset, plan, source = self.goal, self.dataset, self.request.plan(), self.source
        self.tasks, self.started = Tasks(self.work, self.identity(plan), self.job.resume), True
        self.overall = Overall(self.progress_of, self.tasks.span)

        def divide_anew():
            prepare(self.work, self.scored, self.measured, self.request)
            block = self.block or as_memory_allows(dataset.cameras, dataset.memory_budget)
            divide(source, self.work, block, self.overall("divide"))

        self.tasks.once("divide", divide_anew)
        self.divided = divided = replace(Divided.read(self.work), source=source)
        if ORDER not in self.tasks.done:
            check_explained(divided, dataset, str(source), self.job.force, BlockRasterizer())
            _check_room(self.work, divided, goal, AROUND_SHARE)
        blocks = len(divided.blocks)
        self.wanted = goal.number(divided.count) if goal.count or goal.share else 0
        self.tasks.total = 3 + bool(goal.max_drop) + blocks * (2 if self.request.options.recovery else 1)
        self.likeness = PhotographLikeness(dataset, BlockRasterizer, self.overall, lpips=self.job.lpips)
        if goal.max_drop and ALLOWED not in self.tasks.done:  # may refuse
            self.floor = self.allowed_drop().floor_on_photographs(plan)
        ordered = self.wanted or goal.max_drop or blocks > 1
        self.tasks.once(
            ORDER,
            lambda: _order(divided, scored_views(divided.folder), self.overall) if ordered else None,
        )

    def budget(self):
        if self.goal.max_drop:
            find = lambda: self.allowed_drop().fewest_above(self.floor)
            self.wanted = self.tasks.once(ALLOWED, find) or 0

    def select(self):
        divided, plan = self.divided, self.request.plan()
        self.tasks.once("around", lambda: prepare_around(divided, self.overall("merge")))
        for number, target in enumerate(targets(divided, self.wanted)):
            progress = self.overall("decide")
            work = partial(decide, divided, number, self.dataset, plan, target, progress)
            self.tasks.once(f"decide {number}", work)

    def tune(self):
        plan = self.request.plan()
        for number in range(len(self.divided.blocks) if self.request.options.recovery else 0):
            work = partial(recover, self.divided, number, self.dataset, plan, self.overall("recover"))
            self.tasks.once(f"recover {number}", work)

    def write(self):
        self.result = finish_learned(self.divided, self.likeness, self.request, self.job.out, self.overall)
        self.finished = True

    def measure(self) -> dict[str, Any]:
        result = self.result | {"views": len(self.scored)}
        if self.goal.max_drop:
            result |= _of_drop(result, result["before"]["psnr"] - result["psnr"], self.goal)
            if not self.dataset.deciding_indices:
                result["notes"].append(NOT_APART)
        result["notes"].append("by blocks, tone, exposure and poses of photographs are taken as they are")
        result = self.of_prune(result, "")
        job = self.job
        if job.report:
            write_report_of_files(job.report, self.dataset, result, opened, job.lpips_missing)
        return result

    def close(self):
        if self.started and (self.finished or ORDER not in self.tasks.done):
            remove(self.work)


def as_memory_allows(cameras: Sequence[Camera], kept_photographs: int) -> MaxBlockCount:
    """A function that gives the largest number of Gaussians of a block: MAX_BLOCK_COUNT; or less, but at
    least CELL, where SHARE of the available memory is too little to fine-tune a block and the Gaussians
    around it. cameras, kept_photographs (bytes): as for memory.tuning()."""

    def fitting(count: int, coefficients: int) -> int:
        most = min(MAX_BLOCK_COUNT, count)
        while most >= 2 * CELL:
            # of a level of detail of the others, at most as many as the block has
            tuned = most + min(most, round(AROUND_SHARE * (count - most)))
            needed = memory.tuning(tuned, coefficients, cameras, kept_photographs) / SHARE
            if not memory.shortage("", int(needed)):
                break
            most = -(-most // 2)
        return most

    return fitting


def _order(divided: Divided, scored: Sequence[Camera], progress_of: ProgressOf):
    """Orders removals and merges in all blocks."""
    score(divided, scored, 0, 1, progress_of("score"))
    reduce(divided, scored)
    for number in range(len(divided.blocks)):
        progress_of("merge")(f"block {number}", number / len(divided.blocks))
        merge(divided, number)


def _part(progress: Progress, number: int, parts: int) -> Progress:
    """Tells the share of all parts instead of that of one."""
    return lambda text, share: progress(text, (number + share) / parts)


def _check_room(work: Path, divided: Divided, goal: Goal, more: float = 0.0):
    """more: space that is needed beside that for removals and merges, in sizes of all blocks. Raises
    SceneError if there is less."""
    share = min(1.0, goal.number(divided.count) / divided.count) if not goal.max_drop else MIN_SHARE
    check_space(work / SCORED, int((SUMS + COPIES * share + more) * divided.bytes))


def _of_drop(result: dict[str, Any], lost: float, goal: Goal) -> dict[str, Any]:
    """What an allowed drop adds to a result that has lost so many dB."""
    return {"drop": lost, "notes": [*result["notes"], *missed_loss(lost, goal.max_drop)]}


def _figures(result: dict[str, Any]) -> dict[str, Any]:
    """As `svrgs prune` has them."""
    return {name: result[name] for name in FIGURES} | {"ms_per_frame": None, **result["after"]}

"""All steps of pruning by blocks, one after the other, on this machine."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ...files.atomic import check_space, check_writable, reserved
from ...files.digests import scene_sha256
from ...files.level_files import holds_levels, level_files
from ...files.registry import format_to_write, refuse_input
from ...finetune.quality import LEAST
from ...render.metrics.format_loss import loss_notes
from ...render.metrics.missed_drop import missed_drop
from ...scene.camera import Camera
from ...views.dataset import Dataset
from .allowed_drop import drop, errors_of_format, fewest_above, fewest_within, floor_on_photographs, read_number, write_number
from .block_size import as_memory_allows
from .divided import Divided, Tell, Told, divide
from .folder import LEVEL, SCORED, blocks_of, measured_views, prepare, refuse_foreign, remove, scored_views
from .learning import AROUND_SHARE, decide, prepare_around, recover, targets
from .likeness import Likeness, PhotographLikeness
from .merging import merge, reduce
from .pruning import finish, finish_learned, join_levels, write_left
from .request import Request
from .scoring import score
from .tasks import Overall, Tasks
from .tuning import EPOCHS, cut, tune

# bytes: no limit, because fine-tuning on pictures of the scene keeps all of them in memory
PICTURES = 1 << 62
# space that the steps need at least: for sums and orders, in sizes of all blocks; copies of what stays
SUMS, COPIES = 1.2, 4
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


def check_out(out: Path, source: Path):
    """Raises SplatError if the output cannot be written, or is the scene itself."""
    format_to_write(out)
    check_writable(out)
    refuse_input(out, source)


def prune_by_blocks(
    source: Path, out: Path, views: Callable[[], tuple[Sequence[Camera], Sequence[Camera]]], goal: Goal, steps: int | None, told: Told,
    work: Path | None = None, block: int | None = None, request: Request | None = None, resume: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Removes and merges Gaussians, fine-tunes what is left, writes and measures it.

    views: gives the views that are scored and tuned on, and those on which the result is measured; it is
    called after the outputs are checked. steps: of fine-tuning; None: EPOCHS for each view. work: folder for
    the blocks, which are removed at the end; None: beside the output. block: Gaussians of a block, at most;
    None: as memory allows. request: a method that decides on photographs instead, in its own steps; the goal
    is then a number, an allowed drop, or nothing. If it is stopped or fails later than in its first minutes,
    the blocks stay, and `resume` goes on from there. told: gets the share of the whole job. Returns the JSON
    result. Raises SplatError, and what `told` raises.
    """
    work = work or blocks_of(out)
    outs = [out, *level_files(out, goal.levels).values()]
    for path in outs:
        check_out(path, source)
    with contextlib.ExitStack() as stack:
        for path in outs:
            stack.enter_context(reserved(path))
        refuse_foreign(work)
        if request is not None:
            if goal.max_drop:
                request.refuse_drop()
            return _learned(source.absolute(), out, views(), goal, told, work, block, request, resume)
        told = Overall(told, 1 + len(goal.levels))
        try:
            prepare(work, *views())
            scored = scored_views(work)
            divided = divide(
                source.absolute(), work, block or as_memory_allows(scored, PICTURES), told("divide")
            )
            _check_room(work, divided, goal)
            likeness = Likeness(divided, measured_views(work), told)
            errors = errors_of_format(divided, likeness, goal.max_drop, out, told) if goal.max_drop else []
            _order(divided, scored, told)
            count = (
                fewest_within(divided, scored, likeness, goal.max_drop, errors, told)
                if goal.max_drop
                else goal.number(divided.count)
            )
            return _results(divided, scored, likeness, count, goal, steps, outs, told)
        finally:
            remove(work)


def _order(divided: Divided, scored: Sequence[Camera], told: Told):
    """Orders removals and merges in all blocks."""
    score(divided, scored, 0, 1, told("score"))
    reduce(divided, scored)
    for number in range(len(divided.blocks)):
        told("merge")(f"block {number}", number / len(divided.blocks))
        merge(divided, number)


def _part(tell: Tell, number: int, parts: int) -> Tell:
    """Tells the share of all parts instead of that of one."""
    return lambda text, share: tell(text, (number + share) / parts)


def _check_room(work: Path, divided: Divided, goal: Goal, more: float = 0.0):
    """more: space that is needed beside that for removals and merges, in sizes of all blocks. Raises
    SceneError if there is less."""
    share = min(1.0, goal.number(divided.count) / divided.count) if not goal.max_drop else LEAST
    check_space(work / SCORED, int((SUMS + COPIES * share + more) * divided.bytes))


def _learned(
    source: Path, out: Path, views: tuple[Sequence[Camera], Sequence[Camera]], goal: Goal, told: Told, work: Path, block: int | None, request: Request,
    resume: bool,
) -> dict[str, Any]:  # fmt: skip
    """The result of a method that decides on photographs, as prune_by_blocks()."""

    def divide_anew():
        prepare(work, *views, request)
        divide(
            source, work, block or as_memory_allows(dataset.cameras, dataset.memory_budget), told("divide")
        )

    dataset, finished = request.dataset(), False
    tasks = Tasks(work, _identity(source, views, goal, block, request, dataset), resume)
    told_of_step, told = told, lambda step: tasks.told(step, told_of_step(step))
    try:
        tasks.once("divide", divide_anew)
        divided = replace(Divided.read(work), source=source)
        if ORDER not in tasks.done:
            _check_room(work, divided, goal, AROUND_SHARE)
        _decide_and_recover(divided, request, dataset, goal, out, told, tasks)
        result = finish_learned(divided, request, dataset, out, told)
        finished = True
        return result | (
            _of_drop(result, result["before"]["psnr"] - result["psnr"], goal) if goal.max_drop else {}
        )
    finally:
        if finished or ORDER not in tasks.done:
            remove(work)


def _decide_and_recover(
    divided: Divided, request: Request, dataset: Dataset, goal: Goal, out: Path, told: Told, tasks: Tasks
):
    """All tasks on the blocks that are not done yet."""
    plan, wanted, blocks = (
        request.plan(),
        goal.number(divided.count) if goal.count or goal.share else 0,
        len(divided.blocks),
    )
    tasks.total = 3 + bool(goal.max_drop) + blocks * (2 if request.recovery else 1)
    likeness = PhotographLikeness(dataset, told)
    # may refuse
    floor = (
        floor_on_photographs(divided, likeness, goal.max_drop, plan, out, told)
        if goal.max_drop and ALLOWED not in tasks.done
        else 0.0
    )
    tasks.once(
        ORDER,
        lambda: (
            _order(divided, scored_views(divided.folder), told)
            if wanted or goal.max_drop or blocks > 1
            else None
        ),
    )
    if goal.max_drop:
        tasks.once(
            ALLOWED, lambda: write_number(divided.folder, fewest_above(divided, likeness, floor, told))
        )
        wanted = read_number(divided.folder)
    tasks.once("around", lambda: prepare_around(divided, told("merge")))
    for number, target in enumerate(targets(divided, wanted)):
        tasks.once(
            f"decide {number}", partial(decide, divided, number, dataset, plan, target, told("decide"))
        )
    for number in range(blocks if request.recovery else 0):
        tasks.once(f"recover {number}", partial(recover, divided, number, dataset, plan, told("recover")))


def _of_drop(result: dict[str, Any], lost: float, goal: Goal) -> dict[str, Any]:
    """What an allowed drop adds to a result that has lost so many dB."""
    return {"drop": lost, "notes": [*result["notes"], *missed_drop(lost, goal.max_drop)]}


def _identity(
    source: Path,
    views: tuple[Sequence[Camera], Sequence[Camera]],
    goal: Goal,
    block: int | None,
    request: Request,
    dataset: Dataset,
) -> str:
    """Digest of all that must be the same in a job that is continued; where its files lie may differ. Raises
    SceneError."""
    settings = replace(request, colmap="", images="", image_memory=0.0)
    digest = hashlib.sha256(
        repr(
            (scene_sha256(source), goal, block, settings, [[camera.key for camera in some] for some in views])
        ).encode()
    )
    for part in dataset.inputs():
        digest.update(part)
    return digest.hexdigest()


def _results(
    divided: Divided,
    scored: Sequence[Camera],
    likeness: Likeness,
    count: int,
    goal: Goal,
    steps: int | None,
    outs: Sequence[Path],
    told: Told,
) -> dict[str, Any]:
    """The results with `count` Gaussians and of the levels of detail. steps, told: as for
    prune_by_blocks()."""
    shares, streamed = (1.0, *goal.levels), bool(goal.levels) and holds_levels(outs[0])
    files = [divided.folder / LEVEL.format(level) for level in range(len(shares))] if streamed else outs
    results = []
    for share, path in zip(shares, files, strict=True):
        left = cut(divided, scored, max(1, round(share * count)), told("cut"))
        wanted = EPOCHS * len(scored) if steps is None else steps
        for number in range(len(left.blocks) if wanted and left.count < divided.count else 0):
            tune(divided, number, scored, wanted, _part(told("tune"), number, len(left.blocks)))
        results.append(
            write_left(divided, likeness, path) if streamed else finish(divided, likeness, path, told)
        )
    if streamed:
        results = [
            result | new
            for result, new in zip(results, join_levels(divided, likeness, files, outs[0], told), strict=True)
        ]
    levels = [
        {"share": share, **_figures(result)} for share, result in zip(goal.levels, results[1:], strict=True)
    ]
    result = {
        **results[0],
        "levels": levels,
        "drop": None,
        "notes": loss_notes(results[0]["psnr_values"], results[0]["psnr"]),
    }
    return result | (_of_drop(result, drop(result["psnr"]), goal) if goal.max_drop else {})


def _figures(result: dict[str, Any]) -> dict[str, Any]:
    """Of a level, as `svrgs prune` has them."""
    return (
        {name: result[name] for name in ("out", "psnr", "ssim", "flip")}
        | {"lpips": None, "ms_per_frame": None}
        | result["after"]
    )

"""Decides on photographs, block by block, which Gaussians of a divided scene stay, with a method that has
lambda_F; and recovers the quality.

A block is a run of its own (finetune/run.py): of its Gaussians and of those that are blended around it, in
the views that show the block, on the part of each photograph where it is seen. Of the result, only the
block's own are kept. A run has the steps that the whole scene would have on these views. So a Gaussian is
seen as often, and lambda_F is the same price for all blocks. A number of Gaussians to keep is divided among
the blocks by the costs of merging.py.

All blocks decide from the original. Meanwhile a merged level of detail takes the place of the blocks around
it (around/). It stands in for what these become:

- Masks decide: they decide on the level of detail, too. Gaussians whose neighbours never drop out would seem
  less needed than they are.
- Removal errors or saliencies decide: the level of detail is frozen. If it were trained, it would make up for
  what the block loses.

Then each block recovers with what the others have kept. These are trained, too: if they were frozen, every
block would correct the whole error of a pixel. No block uses what another has learned in the same step, so
any order gives the same bits. A run saves checkpoints (runs/), from which the same task goes on when it is
started again.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from ...finetune import checkpoint, loop
from ...finetune.engine import NativeEngine
from ...finetune.model import Model
from ...finetune.plan import Plan, scaled
from ...finetune.run import Run
from ...scene.gaussians import Scene
from ...system.errors import Cancelled, FormatError, SceneError, system_errors
from ...views.dataset import Dataset
from ..first_cut import first_cut
from .divided import Divided, Progress, clear, gathered, write_block
from .merging import counts
from .surroundings import BLENDED, Around
from .tuning import CUT, TUNED, emptied, level, refuse_tuning, write_own

# folder of the level of detail that takes the place of other blocks, and its share of the Gaussians
AROUND, AROUND_SHARE = "around", 0.25
RUNS = "runs"  # folder of the checkpoints


@dataclass
class BlockViews(Dataset):
    """The views of a dataset that show a block, and the part of each in which it is seen."""

    windows: dict[int, tuple[slice, slice]] = field(default_factory=dict)  # by the number of the view
    extent_of_all: float = 0.0
    share: float = 1.0  # of the training views

    @classmethod
    def of(cls, dataset: Dataset, around: Around) -> BlockViews:
        """around: of the training views."""
        pairs = zip(dataset.train_indices, around.windows, strict=True)
        windows = {view: window.slices for view, window in pairs if window}
        same = {one.name: getattr(dataset, one.name) for one in fields(dataset)}
        same |= {"train_indices": list(windows), "test_indices": []}
        share = len(windows) / len(dataset.train_indices)
        return cls(**same, windows=windows, extent_of_all=dataset.extent, share=share)

    @property
    def extent(self) -> float:
        return self.extent_of_all

    def window(self, index: int) -> tuple[slice, slice] | None:
        return self.windows[index]

    def inputs(self) -> Iterator[bytes]:
        """Texts of all cameras, windows and photographs; of a photograph its name, size and time, because
        each block would read all of them for a digest. Raises SceneError if a photograph is missing."""
        for index, window in self.windows.items():
            photo = self.photos[index]
            with system_errors(SceneError, f"{photo.path}: cannot be read"):
                found = photo.path.stat()
            stamp = photo.path.name, found.st_size, found.st_mtime_ns
            yield repr((self.cameras[index].key, window, stamp)).encode()
            yield b"" if photo.unpainted is None else photo.unpainted.tobytes()


def prepare_around(divided: Divided, progress: Progress = lambda *_: None):
    """Writes the level of detail that takes the place of other blocks, and empties the folders of decide()
    and recover(). Raises SplatError."""
    for name in (AROUND, CUT, TUNED):
        emptied(divided, name)
    if len(divided.blocks) > 1:
        level(divided, max(1, round(AROUND_SHARE * divided.count)), AROUND, progress)


def targets(divided: Divided, wanted: int) -> list[int]:
    """The Gaussians that each block keeps, `wanted` together; zeros if that is 0, because the method decides.
    Raises SplatError."""
    return [sum(cells) for cells in counts(divided, wanted)] if wanted else [0] * len(divided.blocks)


def decide(
    divided: Divided,
    number: int,
    dataset: Dataset,
    plan: Plan,
    target: int,
    progress: Progress = lambda *_: None,
):
    """Writes what is left of a block after the steps in which the method decides. target: Gaussians to keep
    of it; 0: the method decides. Raises SplatError."""
    others = Divided.read(divided.folder / AROUND) if len(divided.blocks) > 1 else None
    around, views = _around(divided, number, dataset, progress, others)
    scene, (first, end) = around.scene, around.own
    inside = np.zeros(scene.count, bool)
    inside[first:end] = True
    kept = ~inside | first_cut(scene, views.training_cameras, plan, target, inside)
    scene, own = scene if kept.all() else scene.select(kept), (first, first + int(kept[first:end].sum()))
    frozen = 0 if plan.method.learns_masks else scene.count - (own[1] - own[0])
    run_plan = _of_part(plan, True, views, own, target and target + frozen)
    rows = np.arange(*own)
    kept_at = divided.folder / RUNS / f"decide.{number}"
    if views.train_indices and run_plan.phases and len(rows) > 1:
        scene, rows = _run(divided, number, scene, views, run_plan, kept_at, progress)
    if not len(rows):
        scene, rows = around.scene, np.array([first + int(np.argmax(around.scene.opacity_logits[first:end]))])
    start = sum(block.count for block in divided.blocks[:number])
    clear(divided.folder / TUNED)  # what an earlier decision led to
    for path in (divided.folder / CUT).glob(BLENDED.format("[0-9]*")):
        path.unlink(missing_ok=True)
    write_block(divided.folder / CUT, number, scene.select(rows), start)
    checkpoint.delete_all(kept_at)


def recover(
    divided: Divided, number: int, dataset: Dataset, plan: Plan, progress: Progress = lambda *_: None
):
    """Writes a block of what was decided on, after the recovery steps. Raises SplatError."""
    left = gathered(divided.folder / CUT, divided)
    around, views = _around(left, number, dataset, progress)
    scene, own = around.scene, around.own
    plan = replace(_of_part(plan, False, views, own, 0), method=copy(plan.method))
    if "count" in plan.method.state():  # of the Gaussians before pruning
        plan.method.restore(plan.method.state() | {"count": round(scene.count * divided.count / left.count)})
    rows, kept_at = np.arange(*own), divided.folder / RUNS / f"recover.{number}"
    if views.train_indices and plan.phases:
        scene, rows = _run(divided, number, scene, views, plan, kept_at, progress)
    write_own(left, number, around.there[number], scene.select(rows))
    checkpoint.delete_all(kept_at)


def _around(
    divided: Divided, number: int, dataset: Dataset, progress: Progress, others: Divided | None = None
) -> tuple[Around, BlockViews]:
    """What is around a block in the training views, with all of the block; and the views that show it.
    others: as for Around.of()."""
    around = Around.of(divided, number, dataset.training_cameras, progress, others)
    around.there[number][:] = True
    return around, BlockViews.of(dataset, around)


def _of_part(plan: Plan, active: bool, views: BlockViews, own: tuple[int, int], target: int) -> Plan:
    """The phases of a plan in which its method decides, or the others, with the share of the steps whose view
    shows the block. So a Gaussian of the block sees as many steps as in the whole phase, and rates are the
    same. own: the rows of the block."""
    phases = [phase for phase in plan.phases if phase.active is active]
    shorter = [
        replace(one, rates=replace(one.rates, mask=phase.rates.mask))
        for one, phase in zip(scaled(phases, views.share or 1.0), phases, strict=True)
    ]
    return replace(plan, phases=tuple(shorter), own=own, target=target)


def _run(
    divided: Divided,
    number: int,
    scene: Scene,
    views: BlockViews,
    plan: Plan,
    kept_at: Path,
    progress: Progress,
) -> tuple[Scene, np.ndarray]:
    """The scene after all steps of the plan, and the rows of the block in it. The arrays of the given scene
    are changed. kept_at: folder of the checkpoints."""
    refuse_tuning(divided, number, scene, views.training_cameras, views.memory_budget)
    run = Run(Model.of(scene, copy=False), views, plan, NativeEngine())
    identity = checkpoint.identity_of(run.model, views, plan, "native")
    try:
        checkpoint.restore(run, kept_at, identity)
    except FormatError:  # of a run with other settings or inputs
        checkpoint.delete_all(kept_at)

    def save():
        try:
            checkpoint.save(run, kept_at, identity)
        except SceneError as error:
            logging.warning("%s; the block %d goes on without a checkpoint", error, number)

    def observe(reached: loop.Progress):
        try:
            text = f"block {number}, {reached.count:,} Gaussians: {reached.label}"
            progress(text, 0.5 + 0.5 * reached.iteration / reached.total)
        except Cancelled:
            save()
            raise

    loop.run_to_end(run, observe, lambda: False, save, lambda: None)
    assert plan.own is not None
    origin = np.sort(run.model.origin)
    return run.model.into_scene(), np.flatnonzero((origin >= plan.own[0]) & (origin < plan.own[1]))

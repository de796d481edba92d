"""`svrgs prune --quick`: a scene with fewer Gaussians within seconds, without photographs.

The pictures are the original's own. Views are those of the dataset, if one is given (its photographs are not
opened), else all around the scene. Quality is measured on views that the result was not fitted to.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...files.level_files import write_with_levels
from ...files.ply import NORMALS
from ...files.registry import (
    format_to_write,
    higher_bands,
    invisible,
    load_scene,
    round_trip,
    size_on_disk,
)
from ...finetune.decimate.order import MOST_HIDDEN, Order, hidden, lost_columns, order_of, visibility_sums
from ...finetune.decimate.saved_order import write_order
from ...finetune.quality import MIN_SHARE, best_share, fewest
from ...finetune.refit import USUAL, TrainingView, interpolated, middle_scale, pace_at, refit
from ...finetune.viewed_scene import ViewedScene
from ...render.metrics.allowed_loss import ASSUMED, MEASURES, loss_notes, missed_loss, refuse_loss
from ...render.metrics.evaluate import render_options
from ...scene.camera import apart
from ...scene.gaussians import Scene
from ...system import memory
from ...system.errors import Cancelled, SceneError
from ...views.rendered import RenderedDataset
from .. import job_views
from ..belonging import Seen, check_seen
from ..context import JobContext
from ..disk_room import ROW
from ..door import SIZES, Allowed, allowed_loss, check_options, check_visible, degree_to_keep, excess_notes
from ..file_size import asked_size
from ..likeness import Likeness, assumed_drop, assumed_psnr
from ..options import PruneOptions
from ..recipe import Recipe
from ..seen import cut_notes, fewer_bands, seen_from

DECIDING = 6  # views in which an allowed drop is held, apart from those in which the result is measured
STEPS, MOST_STEPS = 60, 120  # of fine-tuning, with USUAL of the Gaussians and at most
TAKES = (  # options; others are refused
    "data", "images", "holdout", "background", "threads", "lpips_weights", "seed", "target", "target_count",
    "target_size", "target_format", "max_drop", "max_flip", "max_lpips", "sh_degree", "quiet", "quick",
    "force", "scene", "out", "levels",
)  # fmt: skip
FACTORS = (1.0, 2.0, 4.0)  # on the error in SH, for formats that take one
SMALLEST = 0.01  # share of the Gaussians down to which an order is kept
LIKELY = 0.25  # share of the Gaussians that an allowed drop leaves, to foresee the time
NOT_FINISHED = "stopped; nothing was written, and a quick job has no checkpoint: start it again"


class Quick(Recipe):
    """Removes and merges in the order of what it changes in pictures of the scene, and fine-tunes for
    seconds."""

    def __init__(self, options: PruneOptions, job: JobContext):
        refuse_options(options)
        self.options, self.size, self.begun = options, asked_size(options), time.perf_counter()
        self.job = replace(job, scene=options.scene, levels=options.levels)

    def open(self):
        assert self.options.scene is not None
        self.source = load_scene(self.options.scene)
        check_visible(self.source, str(self.options.scene))
        self.visible = np.flatnonzero(~invisible(self.source))
        self.scene = self.source.select(self.visible)

    def views(self):
        self.cameras, self.test, self.notes, _ = job_views.quick(self.options, self.scene)

    def check(self):
        needed = memory.decimating(self.scene.count, self.scene.sh.shape[1], self.cameras)
        memory.refuse_excess(f"{self.options.scene}: pruning it", needed, memory.BY_BLOCKS)
        self.job = self.job.fitting(self.cameras, needed)

    def rank(self):
        options, scene, job = self.options, self.scene, self.job
        viewed = ViewedScene.of(scene, self.cameras, options.background)
        self.rasterizer = viewed.rasterizer
        sums, self.pictures = visibility_sums(viewed)
        if hidden(sums) > MOST_HIDDEN * scene.count:
            if (instead := job_views.quick_instead(options, scene)) is not None:
                self.cameras, self.test, self.notes, _ = instead
                sums, self.pictures = visibility_sums(replace(viewed, cameras=self.cameras))
        if job.stop():
            raise Cancelled(NOT_FINISHED)
        if self.size:
            count = self.size.count_of(scene, self.cameras)
            self.options = options = replace(options, target_size=None, target_count=count)
        wanted, invisibles = _wanted(options, self.source.count), self.source.count - scene.count
        if invisibles and wanted > scene.count:
            self.notes.append(f"{invisibles:,} Gaussians are invisible, so they are left out")
        self.notes += excess_notes(wanted, self.source.count)
        self.hidden, self.wanted = hidden(sums), min(wanted, scene.count)
        self.seen = Seen(1 - self.hidden / scene.count, len(self.cameras))
        least = max(1, math.floor(min(options.levels, default=1) * self.wanted))
        first = self.hidden and least < scene.count
        others = f"; the other {self.hidden:,} are removed or merged first" if first else ""
        self.notes.append(self.seen.sentence() + others)
        self.notes += check_seen(self.seen, str(options.scene), options.force)
        kept = min(least, math.ceil(SMALLEST * scene.count)) if job.order else least
        degree = degree_to_keep(options)
        banded = fewer_bands(scene, degree, self.cameras)
        self.notes += cut_notes(scene, degree, self.cameras)
        self.order = order_of(banded, sums, kept)

    def budget(self):
        options = self.options
        decide, measure = apart(self.test, DECIDING)
        self.likeness = Likeness(
            self.scene,
            measure,
            lambda: self.rasterizer,
            options.background,
            others=decide,
            lpips=self.job.lpips,
        )
        self.count, self.quantise, self.allowed = self.wanted, 1.0, allowed_loss(options)
        if self.allowed.loss:
            deciding = self.likeness.deciding
            deciding.refuse_without_views()
            quality = lambda scene: deciding.quality(scene, self.allowed.measure)
            if self.order.scene.sh_degree < self.scene.sh_degree:
                refuse_bands(self.order, quality, self.job.out, self.allowed)
            self.count, self.quantise = smallest_file(
                self.order, self.wanted, quality, self.job.out, self.allowed
            )

    def select(self):
        counts = [self.count, *(max(1, round(share * self.count)) for share in self.options.levels)]
        self.scenes = [self.order.at(count) for count in counts]

    def tune(self):
        shown = list(map(TrainingView, self.cameras, self.pictures))
        self.scenes = [self._tuned(small, shown) for small in self.scenes]

    def write(self):
        # an allowed loss was decided without it, because views of each count would have to be rendered
        cameras = [] if self.allowed.loss else self.cameras
        seen = [seen_from(scene, cameras, self.job.out) for scene in self.scenes]
        if self.size:
            self.quantise = self.size.quantise_of(self.scenes[0], seen[0], format_to_write(self.job.out))
        self.written = write_with_levels(self.job.out, self.options.levels, self.scenes, self.quantise, seen)
        if self.job.order:
            self.notes += _kept(self.job.order, self.order, self.visible, self.source.count)

    def measure(self) -> dict[str, Any]:
        options = self.options
        facts: dict[str, Any] = {
            "method": "quick",
            "seconds": time.perf_counter() - self.begun,
            "views": len(self.cameras),
            "invisible": self.source.count - self.scene.count,
            "hidden": self.hidden,
            **self.seen.facts(),
        }
        before = {"count": self.source.count, "bytes": size_on_disk(options.scene or "")}
        after, *levels = (
            self.likeness.measured(one.scene)
            | {"count": one.scene.count, "bytes": one.bytes, "out": str(one.path)}
            for one in self.written
        )
        facts["levels"] = [{"share": share, **one} for share, one in zip(options.levels, levels, strict=True)]
        worst = self.likeness.worst(self.written[0].scene)
        facts["worst"] = worst and worst.facts()
        lost = after[self.allowed.measure] if self.allowed.loss else None
        facts["drop"] = assumed_drop(lost) if lost is not None and self.allowed.measure == "psnr" else lost
        notes = [*self.notes, *self.likeness.notes(), *self._result_notes()]
        facts["notes"] = [*notes, *missed_loss(facts["drop"], *self.allowed)]
        return {**after, "scene": str(options.scene), "before": before, "after": after, **facts}

    def _tuned(self, small: Scene, shown: list[TrainingView]) -> Scene:
        """The scene fine-tuned on the pictures. Where that does harm in other views, it is interpolated with
        the scene before the steps. Raises Cancelled."""
        options, share = self.options, small.count / self.scene.count
        if share == 1 and small.sh_degree == self.scene.sh_degree:
            return small
        steps, pace, middle = _steps(share), pace_at(share), middle_scale(small.log_scales)
        settings = render_options(small, options.background)
        try:
            tuned = refit(small, shown, steps, pace, middle, settings, options.seed, self.job.stop)
        except Cancelled:
            raise Cancelled(NOT_FINISHED) from None
        if not self.likeness.deciding.views:
            return tuned
        mixed = lambda part: interpolated(small, tuned, part) if part < 1 else tuned
        quality = lambda part: assumed_psnr(self.likeness.deciding.psnrs(mixed(part)))
        return mixed(best_share(quality))

    def _result_notes(self) -> Iterator[str]:
        """What the user must know of the result that was written."""
        pruned, stored = self.scenes[0], self.written[0].scene
        if self.size:
            yield from self.size.notes(self.quantise, self.written[0].bytes, format_to_write(self.job.out))
        elif self.quantise != 1:
            yield (
                "spherical harmonics are stored more coarsely, as by svrgs convert --quantise"
                f" {self.quantise:g}: that makes the smallest file"
            )
        yield from lost_columns(self.source, stored, (*NORMALS, ROW))
        yield from higher_bands(self.source, format_to_write(self.job.out))
        if not format_to_write(self.job.out).lossless and self.likeness.views:
            psnr = self.likeness.psnr
            yield from loss_notes(psnr(pruned), psnr(stored))


def refuse_bands(order: Order, quality_of: Callable[[Scene], float], out: Path, allowed: Allowed):
    """Raises SceneError if leaving out SH bands costs all of the allowed loss, before a Gaussian is removed.
    quality_of: as of smallest_file()."""
    measure, degree = MEASURES[allowed.measure], order.scene.sh_degree
    loss = (ASSUMED if allowed.measure == "psnr" else 0.0) - quality_of(order.scene)
    if degree == format_to_write(out).most_degree:
        refuse_loss(out, loss, *allowed)
    if loss >= allowed.loss:
        raise SceneError(
            f"{out}: SH of degree {degree} alone lose {loss:.3g} {measure.unit}, not less than"
            f" {measure.option} allows: keep a higher degree"
        )


def smallest_file(
    order: Order, least: int, quality_of: Callable[[Scene], float], out: Path, allowed: Allowed
) -> tuple[int, float]:
    """(count, quantise) of the smallest file that holds the allowed loss before the steps of
    fine-tuning, which win a part of it back. At least `least` Gaussians. A coarser factor is tried as long as
    it makes a smaller file.

    quality_of: of a scene (Likeness.quality()). Raises SceneError if the format alone loses so much.
    """
    total, best_of_all = order.scene.count, ASSUMED if allowed.measure == "psnr" else 0.0
    floor = best_of_all - allowed.loss
    splat_format, best, smallest = format_to_write(out), (total, 1.0), math.inf
    if splat_format.lossless:
        return fewest(least, total, lambda count: quality_of(order.at(count)) >= floor), 1.0

    def tried_with(count: int, factor: float) -> tuple[float, int]:
        held, size = round_trip(order.at(count), splat_format, factor)
        return quality_of(held), size

    def holds(factor: float, count: int) -> bool:
        return tried_with(count, factor)[0] >= floor

    for factor in FACTORS if splat_format.quantises and order.scene.sh_degree else FACTORS[:1]:
        loss = best_of_all - tried_with(total, factor)[0]
        if factor == FACTORS[0]:
            refuse_loss(out, loss, *allowed)
        elif loss >= allowed.loss:
            break
        count = fewest(least, total, partial(holds, factor))
        size = tried_with(count, factor)[1]
        if size >= smallest:
            break
        best, smallest = (count, factor), size
    return best


def like_quick(options: PruneOptions, scene: Scene) -> tuple[PruneOptions, RenderedDataset]:
    """A fine-tuned job that takes about as long as the quick one, and its views: to foresee the time. Raises
    SceneError, FormatError."""
    refuse_options(options)
    train, test, notes, _ = job_views.quick(options, scene)
    dataset = RenderedDataset.of(scene, train, test, background=options.background, notes=tuple(notes))
    if size := asked_size(options):
        count = size.count_of(scene, dataset.cameras)
        options = replace(options, target_size=None, target_format="", target_count=count)
    if not allowed_loss(options).loss:
        visible = scene.count - int(invisible(scene).sum())
        options = replace(options, target=None, target_count=min(_wanted(options, scene.count), visible))
    share = (options.target_count or LIKELY * scene.count) / scene.count
    return replace(options, quick=False, method="merge", recovery=_steps(min(1.0, share))), dataset


def refuse_options(options: PruneOptions):
    """Raises SceneError for options that the quick way does not have."""
    check_options(options, TAKES, "--quick")
    given = any(getattr(options, name) for name in SIZES) or allowed_loss(options).loss or options.levels
    if not given:
        raise SceneError(
            "--quick needs --target, --target-count, --target-size, an allowed loss or --levels: it does not"
            " choose how many Gaussians to keep"
        )


def _kept(folder: Path, order: Order, rows: np.ndarray, total: int) -> list[str]:
    """Writes the order. The result counts without it: a sentence if it cannot be written."""
    try:
        write_order(folder, order, rows, total)
    except SceneError as error:
        return [f"other numbers of Gaussians cannot be shown: {error}"]
    return []


def _wanted(options: PruneOptions, count: int) -> int:
    """The number of Gaussians that is asked for, of `count` in the file; the smallest one if a loss is
    allowed."""
    if allowed_loss(options).loss:
        return math.ceil(MIN_SHARE * count)
    return options.target_count or max(1, round((options.target or 1.0) * count))


def _steps(share: float) -> int:
    """The number of steps of fine-tuning for this share of the Gaussians: with few of them, a step is quick
    and more is to be gained."""
    return round(min(MOST_STEPS, STEPS * (USUAL / share) ** (0.5 if share < USUAL else 0.25)))

"""Fine-tuning in memory: a method decides what is removed, and the others are trained in between, on
photographs or on the splat's own pictures."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...files.images import to_bytes, to_float
from ...files.ply import NORMALS
from ...files.registry import (
    FORMATS,
    format_to_write,
    higher_bands,
    invisible,
    load_scene,
    read_back,
    size_on_disk,
    write_scene,
)
from ...finetune import checkpoint, exposure, loop, masks, poses
from ...finetune.decimate.order import lost_columns
from ...finetune.engine import NativeEngine
from ...finetune.loop import CURVE_VIEWS
from ...finetune.methods import DEFAULT
from ...finetune.model import Model
from ...finetune.plan import Plan
from ...finetune.quality import NOT_APART, hold_apart, quality_views
from ...finetune.run import Run
from ...finetune.viewed_scene import ViewedScene
from ...native.rasterizer import Rasterizer
from ...render.metrics.allowed_loss import MEASURES, format_loss, loss_notes, missed_loss, rounding_notes
from ...render.metrics.evaluate import (
    evaluate,
    mean_quality,
    picture_options,
    refuse_unseen,
    render_options,
    rounded_to_8_bits,
)
from ...render.metrics.worst import LARGEST, VIEWS, Worst, worst_of
from ...render.pose_alignment import beside
from ...scene.camera import evenly, spaced
from ...scene.gaussians import Scene
from ...system import memory
from ...system.errors import SceneError
from ...system.memory_limits import peak
from ...views.cameras_json import write_cameras_json
from ...views.dataset import Dataset, in_training_views
from ...views.reduced_photos import reduction_to
from ...views.rendered import RenderedDataset
from .. import distractors
from ..belonging import check_dataset
from ..blocks.folder import remove_blocks
from ..context import Clock, JobContext
from ..disk_room import ROW, DiskRoom
from ..door import check_training, check_visible, excess_notes
from ..file_size import FileSize, write_sized
from ..first_cut import first_cut
from ..likeness import NO_VIEWS, assumed_drop
from ..photographs import in_its_colours, prepared
from ..planning import pruning_within
from ..recipe import Recipe
from ..report.prune_report import report_pictures, write_prune_report
from ..seen import cut_notes, fewer_bands, seen_from

CANNOT_REACH = "method '{}' cannot reach a target without iterations in which it prunes"


class Tuned(Recipe):
    """What training and fine-tuning have in common: the steps, the result, and what is told of them."""

    dataset: Dataset  # from views() on
    model: Model  # between select() and tune()
    source: Scene  # between open() and select()
    scene: Scene  # from tune() on
    run: Run
    given: Dataset  # as it was read; from check() on

    def __init__(self, plan: Plan, job: JobContext, size: FileSize | None = None):
        """size: of the file, if that is the goal."""
        self.plan, self.job, self.size = plan, job, size
        self.clock, self.room = Clock(), DiskRoom(job.out, job.folder)
        self.held = 0.0  # PSNR in dB from which an allowed drop counts, in the views that decide
        self.notes: list[str] = []  # for the user, besides those of the dataset

    def further_files(self) -> list[Path]:
        fitted = ((exposure, self.plan.exposure), (poses, self.plan.refine_poses))
        own = [kind.file_of(self.job.out) for kind, way in fitted if way != "off"]
        return [self.job.folder / "manifest.json", *own]

    def tune(self):
        """All phases, with checkpoints."""
        job, plan, dataset = self.job, self.plan, self.dataset
        run = Run(self.model, dataset, plan, make_engine(job.engine))
        run.part = job.part
        if run.recovery_pruning:
            run.recovery_pruning.start = self.held
        identity = checkpoint.identity_of(self.model, self.given, plan, job.engine)
        if job.resume:
            checkpoint.restore(run, job.folder, identity)
            self.clock.earlier = sum(run.seconds.values())
        else:
            checkpoint.delete_all(job.folder)
            remove_blocks(job.out)
        job.begin(run, self.all_notes())

        def save():
            with self.room.for_checkpoint(run.model.count):
                checkpoint.save(run, job.folder, identity, asdict(job.planned) if job.planned else None)

        loop.run_to_end(run, job.observe, job.stop, save, lambda: curve_psnr(run))
        self.clock.phases |= run.seconds
        run.engine = make_engine(job.engine)  # a new engine frees the buffers of the old one
        self.dataset = run.dataset
        self.run, self.scene = run, self.model.into_scene(source_order=not plan.nested)
        del self.model

    def write(self):
        self.room.release()
        with self.clock.phase("write"):
            seen = seen_from(self.scene, self.run.training_cameras, self.job.out)
            self.quantise, notes = write_sized(self.job.out, self.scene, seen, self.size)
            self.notes += notes
            self.write_fitted()
        checkpoint.delete_all(self.job.folder)

    def write_fitted(self):
        """What was fitted to the photographs, beside the result; of an earlier result under this name it
        goes. Without photographs nothing is touched."""
        if isinstance(self.dataset, RenderedDataset):
            return
        run, out, cameras = self.run, self.job.out, self.run.training_cameras
        if run.exposures:
            names = [camera.name for camera in cameras]
            exposure.write(exposure.file_of(out), names, run.exposures.matrices)
        else:
            exposure.file_of(out).unlink(missing_ok=True)
        if run.poses:
            write_cameras_json(poses.file_of(out), cameras)
        else:
            poses.file_of(out).unlink(missing_ok=True)
        if self.plan.mask_distractors:
            distractors.write_masks(distractors.folder_of(out), cameras)

    def close(self):
        self.room.release()

    @property
    def measuring(self) -> list[int]:
        """The views that measure. Those that are trained on do not measure the splat's own pictures."""
        own = isinstance(self.dataset, RenderedDataset)
        return self.dataset.test_indices or ([] if own else self.dataset.train_indices)

    def measured(self, scene: Scene, path: Path) -> dict[str, Any]:
        """The figures of `svrgs eval` for a scene, on photographs in its colours. path: its file, for the
        size in bytes."""
        fitted = self.plan.exposure == "on", self.plan.refine_poses == "on"
        figures = evaluate(scene, self.dataset, self.measuring, Rasterizer(), self.job.lpips, *fitted)
        return {**figures, "bytes": size_on_disk(path)}

    def rounding_notes(self, stored: float | None) -> list[str]:
        """What the format of the output costs. stored: PSNR in dB of what the file holds; None: of equal
        pictures, or without views."""
        if stored is None or format_to_write(self.job.out).lossless:
            return []
        options = render_options(self.scene, self.dataset.background)
        psnr = mean_quality(self.scene, self.dataset, self.measuring, Rasterizer(), options)
        own = isinstance(self.dataset, RenderedDataset)
        return loss_notes(psnr, stored) if own else rounding_notes(self.job.out, psnr, stored)

    def all_notes(self) -> list[str]:
        return [*self.dataset.notes, *in_training_views(self.dataset), *self.notes]

    def facts(self) -> dict[str, Any]:
        """The keys of the JSON result that describe the run, not the quality of the scene."""
        run, plan = self.run, self.run.plan
        tuned = sum(run.seconds.values())
        return {
            "out": str(self.job.out),
            "method": plan.method.name,
            "lambda_f": plan.lambda_f if run.method.uses_lambda_f(plan) else None,
            "lambda_m": plan.lambda_m or None,
            "target": None if plan.max_loss else run.target or None,
            "reached": run.controller.reached if run.controller else None,
            "drop": run.drop,
            "strength": run.strength,
            "seconds": self.clock.total,
            "seconds_by_phase": self.clock.phases,
            "iterations": run.iteration,
            "iterations_per_second": run.iteration / tuned if tuned else None,
            "peak_memory_bytes": peak(),
            "nonfinite_gradients": run.nonfinite,
            "densifications_held_back": run.held_back,
            "seed": plan.seed,
            "exposure": self.fitted_exposure(),
            "photographs": self.of_photographs(),
            "masks": str(distractors.folder_of(self.job.out)) if plan.mask_distractors else None,
            "poses": {"file": str(poses.file_of(self.job.out))} if run.poses else None,
            "notes": self.all_notes(),
            "curves": vars(run.curves),
        }

    def fitted_exposure(self) -> dict[str, Any] | None:
        """What was fitted to the photographs: its file, their number, and their spread in EV."""
        if not self.run.exposures:
            return None
        found = exposure.stops(self.run.exposures.matrices)
        file = str(exposure.file_of(self.job.out))
        return {"file": file, "photographs": len(found), "stops": float(found.std())}

    def of_photographs(self) -> dict[str, dict[str, float]]:
        """By name of a training photograph, as far as something was found: its exposure in EV, by how many
        pixels its camera was moved (what it shows, the median), and the share of its pixels that is
        hidden."""
        run = self.run
        found = {camera.name: dict[str, float]() for camera in run.training_cameras}
        if run.exposures:
            for camera, ev in zip(run.training_cameras, exposure.stops(run.exposures.matrices), strict=True):
                found[camera.name]["exposure_ev"] = float(ev)
        for view, camera in zip(run.places, run.training_cameras, strict=True):
            if run.poses:
                moved = beside(self.given.cameras[view], camera, self.scene.means)
                found[camera.name]["moved_pixels"] = moved
            if camera.valid_bits is not None:
                found[camera.name]["hidden"] = 1 - camera.valid_share
        return {name: figures for name, figures in found.items() if figures}

    def timed(self, result: dict[str, Any]) -> dict[str, Any]:
        """The result, of a job with a time limit with the seconds asked for, foreseen and used, the time
        between a stop and a resume left out, and the schedule that was chosen."""
        planned = self.job.planned
        if planned is None:
            return {**result, "time": None}
        used = self.clock.earlier + self.job.seconds()
        notes = [*result["notes"], *planned.late(used)]
        return {**result, "notes": notes, "time": {**asdict(planned), "used": used}}


class FineTuned(Tuned):
    """Prunes a trained scene with a method, and recovers its quality."""

    def __init__(
        self,
        path: Path,
        plan: Plan,
        job: JobContext,
        dataset_of: Callable[[Scene], Dataset],
        size: FileSize | None = None,
    ):
        """dataset_of: the dataset for the scene of the file `path`. size: as for Tuned."""
        super().__init__(plan, replace(job, scene=path), size)
        self.path, self.dataset_of = path, dataset_of

    def open(self):
        with self.clock.phase("read"):
            self.source = load_scene(self.path)
        check_visible(self.source, str(self.path))

    def views(self):
        self.dataset = self.dataset_of(self.source)

    def check(self):
        source, dataset = self.source, self.dataset
        if self.size:
            self.plan, self.notes = self.size.planned(self.plan, source, dataset.training_cameras)
        plan = self.plan
        check_request(dataset, plan)
        refuse_lost_order(plan, self.job)
        self.notes += excess_notes(plan.target, source.count)
        self.notes += cut_notes(source, plan.sh_degree, dataset.training_cameras)
        refuse_unseen(source, dataset.cameras, str(self.path))
        what, held = f"{self.path}: pruning it", source.sh.shape[1]
        needed = refuse_excess(what, source.count, held, dataset, plan, memory.BY_BLOCKS)
        self.job = self.job.fitting(dataset.cameras, needed)
        self.given = dataset
        with self.clock.phase("compare photographs"):
            toned = in_its_colours(source, dataset, plan)
        dataset = toned.dataset
        found, self.seen = check_dataset(source, dataset, str(self.path), self.job.force)
        for note in found:
            logging.warning("%s", note)
        self.notes += [*toned.notes, *found]
        with self.clock.phase("compare photographs"):
            photographs = prepared(source, dataset, plan, self.job)
        self.dataset, self.plan = dataset, plan = photographs.dataset, photographs.plan
        self.notes += photographs.notes
        self.compared = toned.facts | photographs.facts
        if plan.max_loss:
            self.dataset = dataset = hold_apart(dataset, plan.measure)
            if not self.measuring:
                raise SceneError(NO_VIEWS)
            self.notes += [] if dataset.deciding_indices else [NOT_APART]
        self.notes += higher_bands(source, format_to_write(self.job.out))
        self.room.hold_for(source, source.count, plan.averaged_count(source.count))

    def budget(self):
        source, dataset, job = self.source, self.dataset, self.job
        if job.limit:
            read = self.clock.phases["read"]
            self.plan, self.job = pruning_within(self.plan, source, read, dataset, job)
        with self.clock.phase("evaluate before"):
            self.before = {"count": source.count, "bytes": size_on_disk(self.path)}
            if not isinstance(dataset, RenderedDataset):
                self.before = self.measured(source, self.path)
            self.pictures = report_pictures(source, dataset, Rasterizer()) if job.report else []
            self.originals = list(map(to_bytes, self.pictures_of(source)))
        with self.clock.phase("first cut"):
            self.allowed = self.plan.max_loss
            if self.allowed:
                self.held = quality_of(source, dataset, self.plan)
            self.plan = without_format_loss(source, dataset, self.plan, job.out)

    def select(self):
        source = self.source
        del self.source  # frees memory for the optimiser
        with self.clock.phase("first cut"):
            start = first_scene(source, self.dataset, self.plan)
            self.notes += lost_columns(source, start, (*NORMALS, ROW))
            # the dataset renders the source, so that the steps must not change its arrays
            own = isinstance(self.dataset, RenderedDataset)
            shown = own and np.may_share_memory(start.means, source.means)
            self.model, self.cut = Model.of(start, copy=shown), source.count - start.count

    def write(self):
        super().write()
        self.levels = []
        with self.clock.phase("evaluate after"):
            for share, path in self.job.level_files.items():
                level = self.scene.select(np.arange(max(1, round(share * self.scene.count))))
                seen = seen_from(level, self.run.training_cameras, path)
                write_scene(path, level, quantise=self.quantise, seen=seen)
                figures = self.measured(read_back(path, level), path)
                self.levels.append({"share": share, "out": str(path), **figures})

    def pictures_of(self, scene: Scene) -> Iterator[np.ndarray]:
        """What some of the views that measure show, (H, W, 3), rounded to 8 bits; large ones reduced."""
        rasterizer, options = Rasterizer(), picture_options(scene, self.dataset.background)
        for index in evenly(self.measuring, VIEWS):
            camera = self.dataset.cameras[index]
            camera = camera.reduced(reduction_to(LARGEST, camera))
            yield rounded_to_8_bits(rasterizer.forward(scene, camera, options)["rgb"])

    def worst(self, scene: Scene) -> Worst | None:
        """Where the result differs most from the original."""
        names = (self.dataset.cameras[index].name for index in evenly(self.measuring, VIEWS))
        return worst_of(zip(names, map(to_float, self.originals), self.pictures_of(scene), strict=True))

    def lost(self, after: dict[str, Any]) -> float | None:
        """What a result with these figures has lost, in the views that measure; None if there are none."""
        measure, own = self.plan.measure, isinstance(self.dataset, RenderedDataset)
        if after[measure] is None:
            return None
        if measure == "psnr":
            return assumed_drop(after["psnr"]) if own else self.before["psnr"] - after["psnr"]
        return after[measure] - (0.0 if own else self.before[measure])

    def measure(self) -> dict[str, Any]:
        job, dataset = self.job, self.dataset
        with self.clock.phase("evaluate after"):
            scene = read_back(job.out, self.scene)
            after, worst = self.measured(scene, job.out), self.worst(scene)
            self.run.drop = self.lost(after) if self.allowed else None
            self.notes += self.rounding_notes(after["psnr"])
            self.notes += missed_loss(self.run.drop, self.allowed, self.plan.measure)
        result = {
            **after,
            "scene": str(self.path),
            "before": self.before,
            "after": after,
            "levels": self.levels,
            "first_cut": self.cut,
            "worst": worst and worst.facts(),
            "compared": self.compared,
            **self.facts(),
            **({"rig": dataset.facts} if isinstance(dataset, RenderedDataset) else {}),
            **self.seen,
        }
        if job.report:
            write_prune_report(
                job.report, self.pictures, scene, dataset, self.run, result, job.lpips_missing, worst
            )
        return self.timed(result)


def check_request(dataset: Dataset, plan: Plan):
    """Checks, before any work, that the dataset has training views and that the method can do what the plan
    asks. Raises SceneError."""
    check_training(dataset.train_indices)
    method, asked = plan.method, plan.target or plan.share
    if plan.max_loss and not (method.supports_max_loss and plan.prunes):
        raise SceneError(
            f"method '{method.name}' cannot take {MEASURES[plan.measure].option}: it needs a method that"
            " learns what to prune, and iterations in which it learns"
        )
    if plan.measure == "lpips" and method.learns_masks:
        raise SceneError(
            f"method '{method.name}' cannot take --max-lpips, which it would measure too often: take"
            f" --max-flip, or method '{DEFAULT}'"
        )
    if method.ranks and not asked:
        raise SceneError(
            f"method '{method.name}' needs --target or --target-count: it ranks Gaussians, it does not learn"
            " how many to keep"
        )
    if asked and not method.ranks and not plan.prunes:
        raise SceneError(CANNOT_REACH.format(plan.method.name))


def refuse_lost_order(plan: Plan, job: JobContext):
    """Raises SceneError if the order of the Gaussians is what is asked for, and the format of the output has
    one of its own."""
    if plan.nested and not job.level_files and "order" not in format_to_write(job.out).carries:
        fitting = [one.suffixes[0] for one in FORMATS if one.write and "order" in one.carries]
        raise SceneError(
            f"{job.out}: this format has an order of its own, and a nested result is an order of the"
            f" Gaussians: write a {' or '.join(fitting)}"
        )


def refuse_excess(
    what: str, count: int, coefficients: int, dataset: Dataset, plan: Plan, advice: str = ""
) -> int:
    """Raises MemoryShort if memory is too short for the fine-tuning of so many Gaussians. coefficients: SH
    coefficients per channel. advice: what else can be done. Returns the bytes that are needed."""
    cameras = dataset.cameras
    needed = memory.tuning(count, coefficients, cameras, dataset.memory_budget, plan.averaged_count(count))
    if plan.mask_distractors:
        needed += sum(camera.height * -(-camera.width // 8) for camera in cameras)  # a bit a pixel
    if plan.method.merges:
        needed = max(needed, memory.ordering(count, coefficients, cameras))
    memory.refuse_excess(what, needed, advice)
    return needed


def quality_of(scene: Scene, dataset: Dataset, plan: Plan) -> float:
    """What an allowed loss is taken from, in the views that decide."""
    options = render_options(scene, plan.background)
    what = scene, dataset, quality_views(dataset), Rasterizer(), options
    return mean_quality(*what, measure=plan.measure, error=dataset.unexplained)


def without_format_loss(scene: Scene, dataset: Dataset, plan: Plan, out: Path) -> Plan:
    """The plan, with what the format of the output loses taken off an allowed loss. Raises SceneError if
    nothing is left of it."""
    if not plan.max_loss:
        return plan
    quality = lambda some: quality_of(some, dataset, plan)
    views = dataset.training_cameras
    banded = fewer_bands(scene, plan.sh_degree, views)
    lost = format_loss(out, banded, quality, plan.max_loss, plan.measure, seen_from(banded, views, out))
    return replace(plan, max_loss=plan.max_loss - lost)


def first_scene(scene: Scene, dataset: Dataset, plan: Plan) -> Scene:
    """The scene of the first step: after the first removal and the first cut; of methods that rank, only the
    target count; with the SH bands that stay. Raises SceneError if almost nothing stays."""
    views = dataset.training_cameras
    keep = first_cut(scene, views, plan, plan.target)
    if plan.min_contribution:
        masks.refuse_emptying(keep, scene.count - int(invisible(scene).sum()), plan.target)
    # one selection, because two copies would raise the peak memory of the job
    scene = scene if keep.all() else scene.select(keep)
    if plan.method.ranks:
        scene = plan.method.reduced(ViewedScene.of(scene, views, plan.background), plan.target)
    return fewer_bands(scene, plan.sh_degree, views)


def make_engine(name: str):
    if name == "native":
        return NativeEngine()
    from ...finetune.torch_engine import TorchEngine

    return TorchEngine()


def curve_psnr(run: Run) -> float | None:
    """PSNR in dB on a few test views, of the Gaussians that would stay if pruning ended now. None without
    test views."""
    dataset, model = run.dataset, run.model
    if not (views := spaced(dataset.test_indices, CURVE_VIEWS)):
        return None
    kept = run.method.current_mask(model) if model.learns_masks else None
    mask = None if kept is None else kept.astype(np.uint8)
    options = render_options(model, run.plan.background)
    return mean_quality(model, dataset, views, run.engine.rasterizer, options, mask)

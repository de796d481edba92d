"""Whole jobs: training from sparse points, and pruning of a trained scene. A job checks its inputs and
outputs before it starts to work."""

from __future__ import annotations

import contextlib
import logging
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ..files.atomic import check_writable, reserved
from ..files.registry import FORMATS, format_to_write, invisible, load_scene, refuse_input, size_on_disk, stored, write_scene
from ..finetune import checkpoint, loop, masks, scores
from ..finetune.decimate.order import NORMALS, lost_columns
from ..finetune.engine import NativeEngine
from ..finetune.model import Model, scene_from_points
from ..finetune.plan import Plan
from ..finetune.quality import quality_views
from ..finetune.run import Run
from ..finetune.settings import Densify
from ..native.library import thresholds
from ..native.rasterizer import Rasterizer, RenderOptions
from ..render.metrics.evaluate import any_in_view, evaluate, mean_psnr, refuse_unseen, render_options
from ..render.metrics.explained import mismatch_of
from ..render.metrics.format_loss import format_loss
from ..render.metrics.missed_drop import missed_drop
from ..scene.gaussians import Scene
from ..system import memory
from ..system.errors import SceneError
from ..system.memory_limits import peak
from ..views.dataset import Dataset
from ..views.rendered import RenderedDataset
from .blocks.folder import remove_blocks
from .context import JobContext
from .disk_room import ROW, DiskRoom
from .report.prune_report import report_pictures, write_prune_report

CURVE_VIEWS = 4  # test views on which the PSNR of the curves is measured
CANNOT_REACH = "method '{}' cannot reach a target without iterations in which it prunes"


def train(dataset: Dataset, plan: Plan, job: JobContext, sh_degree: int = 3) -> dict:
    """Trains from the dataset's sparse points and writes job.out. Returns the JSON result. Raises SplatError,
    Cancelled."""
    check_outputs(job)
    with reserved(job.out), DiskRoom(job.out, job.folder) as room:
        return _train(dataset, plan, job, sh_degree, room)


def _train(dataset: Dataset, plan: Plan, job: JobContext, sh_degree: int, room: DiskRoom) -> dict:
    check_request(dataset, plan)
    if (plan.target or plan.share) and not plan.prunes:
        raise SceneError(CANNOT_REACH.format(plan.method.name))
    refuse_unseen_points(dataset)
    clock = Clock()
    refuse_excess("training", len(dataset.points), (sh_degree + 1) ** 2, dataset, plan)
    with clock.phase("initialise"):
        growth = plan.phases[0].densify or Densify()
        start = scene_from_points(dataset.points, dataset.point_colors, sh_degree, *growth.INITIAL)
        most = max(start.count, plan.target)
        room.hold_for(start, most, plan.averaged_count(most))
        model = Model.of(start, copy=False)
    del start  # frees memory as soon as the model has other arrays
    run, scene = fine_tune(model, dataset, plan, job, clock, room)
    with clock.phase("evaluate"):
        after = measured(stored(job.out, scene), dataset, job)
    return {**after, **run_facts(run, job, clock), "time": time_facts(job, clock)}


def prune(scene_path: Path, dataset: Dataset, plan: Plan, job: JobContext) -> dict:
    """Prunes a trained scene and recovers its quality. Writes job.out and, if job.report is set, the report.
    Returns the JSON result. Raises SplatError, Cancelled."""
    check_outputs(job)
    for out in (job.out, *job.level_files.values()):
        refuse_input(out, scene_path)
    with contextlib.ExitStack() as outputs:
        for out in (job.out, *job.level_files.values()):
            outputs.enter_context(reserved(out))
        return _prune(scene_path, dataset, plan, job, outputs.enter_context(DiskRoom(job.out, job.folder)))


def _prune(scene_path: Path, dataset: Dataset, plan: Plan, job: JobContext, room: DiskRoom) -> dict:
    check_request(dataset, plan)
    refuse_lost_order(plan, job)
    clock, allowed = Clock(), plan.max_drop
    with clock.phase("read"):
        source = load_scene(scene_path).scene
        refuse_unseen(source, dataset.cameras, str(scene_path))
        refuse_excess(
            f"{scene_path}: pruning it", source.count, source.sh.shape[1], dataset, plan, memory.BY_BLOCKS
        )
        room.hold_for(source, source.count, plan.averaged_count(source.count))
    with clock.phase("evaluate before"):
        before = facts_before(source, dataset, job, scene_path)
        pictures = report_pictures(source, dataset, Rasterizer()) if job.report else []
    with clock.phase("first cut"):
        held = psnr_to_hold(source, dataset, plan)
        plan = without_format_loss(source, dataset, plan, job.out)
        start = first_cut(source, dataset, plan)
        dataset.notes += tuple(lost_columns(source, start, (*NORMALS, ROW)))
        model, cut = Model.of(start, copy=False), source.count - start.count
        del start
    del source  # frees memory for the optimiser
    run, scene = fine_tune(model, dataset, plan, job, clock, room, held)
    with clock.phase("evaluate after"):
        levels = written_levels(scene, dataset, job)
        scene = stored(job.out, scene)
        after = measured(scene, dataset, job)
        run.drop = held - psnr_to_hold(scene, dataset, plan) if allowed else None
        dataset.notes += tuple(missed_drop(run.drop, allowed))
    result = {
        **after,
        "scene": str(scene_path),
        "before": before,
        "after": after,
        "levels": levels,
        "first_cut": cut,
    }
    result |= run_facts(run, job, clock) | (
        {"rig": dataset.facts} if isinstance(dataset, RenderedDataset) else {}
    )
    if job.report:
        write_prune_report(
            job.report, scene_path.stem, pictures, scene, dataset, run, result, job.lpips_missing
        )
    return {**result, "time": time_facts(job, clock)}


class Clock:
    """Seconds of each phase, in order."""

    def __init__(self):
        self.started = time.perf_counter()
        self.earlier = 0.0  # seconds before the job was resumed
        self.phases: dict[str, float] = {}

    @contextlib.contextmanager
    def phase(self, name: str):
        begun = time.perf_counter()
        yield
        self.phases[name] = time.perf_counter() - begun

    @property
    def total(self) -> float:
        return self.earlier + time.perf_counter() - self.started


def check_outputs(job: JobContext):
    """Checks, before any work, that all results can be written. Raises SceneError."""
    for out in (job.out, *job.level_files.values()):
        format_to_write(out)
        check_writable(out)
    check_writable(job.folder / "manifest.json")
    if job.report:
        check_writable(job.report / "index.html")


def check_request(dataset: Dataset, plan: Plan):
    """Checks, before any work, that the dataset has training views and that the method can do what the plan
    asks. Raises SceneError."""
    if not dataset.train_indices:
        raise SceneError(
            "all views of the dataset are held out for testing, none is left for training: use --holdout 0"
        )
    method, asked = plan.method, plan.target or plan.share
    if plan.max_drop and not (method.supports_max_drop and plan.prunes):
        raise SceneError(
            f"method '{method.name}' cannot take --max-drop: it needs a method that learns what to prune, and"
            " iterations in which it learns"
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
        fitting = [
            splat_format.suffixes[0]
            for splat_format in FORMATS
            if splat_format.write and "order" in splat_format.carries
        ]
        raise SceneError(
            f"{job.out}: this format has an order of its own, and a nested result is an order of the"
            f" Gaussians: write a {' or '.join(fitting)}"
        )


def refuse_unseen_points(dataset: Dataset):
    """Raises SceneError if no training view sees a sparse point: training would end with black pictures."""
    if not any_in_view(dataset.points, dataset.cameras, [dataset.cameras[i] for i in dataset.train_indices]):
        count, near = len(dataset.points), thresholds().near
        raise SceneError(
            f"no training view sees any of the {count:,} sparse points more than {near:g} in front of it; run"
            " COLMAP again, or scale the model up"
        )


def refuse_excess(what: str, count: int, coefficients: int, dataset: Dataset, plan: Plan, advice: str = ""):
    """Raises MemoryShort if memory is too short for the fine-tuning of so many Gaussians. coefficients: SH
    coefficients per channel. advice: what else can be done."""
    needed = memory.tuning(
        count, coefficients, dataset.cameras, dataset.memory_budget, plan.averaged_count(count)
    )
    memory.refuse_excess(
        what,
        max(needed, memory.ordering(count, coefficients, dataset.cameras)) if plan.method.merges else needed,
        advice,
    )


def facts_before(source: Scene, dataset: Dataset, job: JobContext, path: Path) -> dict:
    """The figures of the source scene; without its quality if the photographs are its own pictures. Otherwise
    notes whether both belong together."""
    if isinstance(dataset, RenderedDataset):
        return {"count": source.count, "bytes": size_on_disk(path)}
    before = measured(source, dataset, job, path)
    note_mismatch(source, dataset)
    return before


def note_mismatch(scene: Scene, dataset: Dataset):
    """Warns, and notes in the dataset, if the scene explains little of the photographs."""
    if sentence := mismatch_of(scene, dataset):
        logging.warning("%s", sentence)
        dataset.notes = (*dataset.notes, sentence)


def psnr_to_hold(scene: Scene, dataset: Dataset, plan: Plan) -> float:
    """PSNR in dB from which an allowed drop counts, on the views of finetune/quality.py. 0 if none is
    allowed."""
    if not plan.max_drop:
        return 0.0
    options = render_options(scene, plan.background)
    return mean_psnr(scene, dataset, quality_views(dataset), Rasterizer(), options, error=dataset.unexplained)


def without_format_loss(scene: Scene, dataset: Dataset, plan: Plan, out: Path) -> Plan:
    """The plan, with what the format of the output loses taken off an allowed drop. Raises SceneError if
    nothing is left of it."""
    if not plan.max_drop:
        return plan
    return replace(
        plan,
        max_drop=plan.max_drop
        - format_loss(out, scene, lambda some: psnr_to_hold(some, dataset, plan), plan.max_drop),
    )


def first_cut(scene: Scene, dataset: Dataset, plan: Plan) -> Scene:
    """The scene after the first removal and the first cut (docs/methods.md, "What all methods share"). Raises
    SceneError if almost nothing stays.

    First removal: Gaussians with an opacity below 1/255; no picture changes. First cut: those whose alpha T
    is below plan.min_contribution in every pixel of every training view, but never below a target count.
    Methods that rank keep only the target count here.

    Both masks are applied in one selection, before other arrays exist: two copies would raise the peak memory
    of the job.
    """
    method, faint = plan.method, invisible(scene)
    views = [dataset.cameras[i] for i in dataset.train_indices]
    keep = ~faint
    if plan.min_contribution:
        _, peaks, _ = scores.contribution(scene, views, Rasterizer(), render_options(scene, plan.background))
        keep &= (peaks >= plan.min_contribution) | scores.top(np.where(faint, -1, peaks), plan.target)
        masks.refuse_emptying(keep, scene.count - int(faint.sum()), plan.target)
    scene = scene if keep.all() else scene.select(keep)
    if not method.ranks:
        return scene
    return method.reduced(scene, views, Rasterizer(), render_options(scene, plan.background), plan.target)


def make_engine(name: str):
    if name == "native":
        return NativeEngine()
    from ..finetune.torch_engine import TorchEngine

    return TorchEngine()


def fine_tune(
    model: Model,
    dataset: Dataset,
    plan: Plan,
    job: JobContext,
    clock: Clock,
    room: DiskRoom,
    held: float = 0.0,
) -> tuple[Run, Scene]:
    """Runs all phases with checkpoints, writes job.out and deletes the checkpoints. The seconds of each phase
    are added to the clock.

    held: psnr_to_hold() of the scene before the first cut. Returns the run and the scene, which takes over
    the arrays of the model. Raises SplatError; Cancelled after a checkpoint.
    """
    run = Run(model, dataset, plan, make_engine(job.engine), model.metadata["antialiased"])
    if run.recovery_pruning:
        run.recovery_pruning.start = held
    identity = checkpoint.identity_of(model, dataset, plan, job.engine)
    if job.resume:
        checkpoint.restore(run, job.folder, identity)
        clock.earlier = sum(run.seconds.values())
    else:
        checkpoint.delete_all(job.folder)
        remove_blocks(job.out)
    job.begin(run)

    def save():
        with room.for_checkpoint(run.model.count):
            checkpoint.save(run, job.folder, identity, asdict(job.planned) if job.planned else None)

    loop.run_to_end(run, job.observe, job.stop, save, lambda: curve_psnr(run))
    clock.phases |= run.seconds
    run.engine = make_engine(job.engine)  # a new engine frees the buffers of the old one
    scene = model.into_scene(source_order=not plan.nested)
    room.release()
    with clock.phase("write"):
        write_scene(job.out, scene)
    checkpoint.delete_all(job.folder)
    return run, scene


def curve_psnr(run: Run) -> float | None:
    """PSNR in dB on a few test views, of the Gaussians that would stay if pruning ended now. None without
    test views."""
    dataset, model = run.dataset, run.model
    views = dataset.test_indices[:: max(1, len(dataset.test_indices) // CURVE_VIEWS)][:CURVE_VIEWS]
    if not views:
        return None
    kept = run.method.current_mask(model) if model.learns_masks else None
    options = RenderOptions(antialiased=run.antialiased, background=run.settings.background)
    return mean_psnr(
        model, dataset, views, run.engine.rasterizer, options, None if kept is None else kept.astype(np.uint8)
    )


def measured(scene: Scene, dataset: Dataset, job: JobContext, path: Path | None = None) -> dict:
    """The figures of `svrgs eval` for a scene. path: its file, for the size in bytes (default: the
    output)."""
    views = dataset.test_indices or dataset.train_indices
    return {
        **evaluate(scene, dataset, views, Rasterizer(), job.lpips),
        "bytes": size_on_disk(path or job.out),
    }


def written_levels(scene: Scene, dataset: Dataset, job: JobContext) -> list[dict]:
    """Writes the levels of detail of a nested scene. Returns the share, the file and the figures of each."""
    levels = []
    for share, path in job.level_files.items():
        level = scene.select(np.arange(max(1, round(share * scene.count))))
        write_scene(path, level)
        levels.append({"share": share, "out": str(path), **measured(stored(path, level), dataset, job, path)})
    return levels


def time_facts(job: JobContext, clock: Clock) -> dict | None:
    """Of a job with a time limit: seconds asked for, foreseen and used, the time between a stop and a resume
    left out, and the schedule that was chosen."""
    return {**asdict(job.planned), "used": clock.earlier + job.seconds()} if job.planned else None


def run_facts(run: Run, job: JobContext, clock: Clock) -> dict:
    """The keys of the JSON result that describe the run, not the quality of the scene."""
    plan, tuned = run.settings, sum(run.seconds.values())
    return {
        "out": str(job.out),
        "method": plan.method.name,
        "lambda_f": plan.lambda_f if run.method.uses_lambda_f(plan) else None,
        "lambda_m": plan.lambda_m or None,
        "target": None if plan.max_drop else run.target or None,
        "reached": run.controller.reached if run.controller else None,
        "drop": run.drop,
        "strength": run.strength,
        "seconds": clock.total,
        "seconds_by_phase": clock.phases,
        "iterations": run.iteration,
        "iterations_per_second": run.iteration / tuned if tuned else None,
        "peak_memory_bytes": peak(),
        "nonfinite_gradients": run.nonfinite,
        "densifications_held_back": run.held_back,
        "seed": plan.seed,
        "notes": list(run.dataset.notes),
        "curves": vars(run.curves),
    }

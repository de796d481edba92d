"""What the prune panel shows: window_manager.svrgs_prune_state, which the panels know by name.

All properties are read-only. They are worked out whenever a panel is drawn, and nothing is stored.
"""

from __future__ import annotations

import bpy
from bpy.props import FloatProperty, IntProperty, PointerProperty, StringProperty

from ..svrgs_addon.errors import SplatError
from ..svrgs_addon.finetune.methods import METHODS
from ..svrgs_addon.finetune.methods.base import Method
from ..svrgs_addon.jobs.job_process import Job
from . import bridge, camera_match, edit_guard, estimate, former_methods, goals, job_pictures, job_result
from .job import dataset_of
from .job_watch import BUSY, WAITING, current
from .native_check import native_problem
from .option_properties import CHOICES, method_sentence
from .splat_size import size_text

SILENT_SECONDS = 60.0  # after this time without a sign of life, the panel says so
WAITING_TEXT = {"paused": "Paused", "cancelled": "Cancelled", "interrupted": "An interrupted job was found", "failed": "The job failed"}


def stage(context) -> str:
    """BROKEN (no native library), BUSY, WAITING or FINISHED (a job), RESULT or APPLIED (a pruned splat), READY (a splat), NOTHING."""
    if native_problem():
        return "BROKEN"
    if (found := current(context)) is not None:
        _, job = found
        return "BUSY" if job.state in BUSY else "WAITING" if job.state in WAITING else "FINISHED"
    _, pruned = job_result.pair_of(context.object)
    if pruned is not None:
        return "RESULT" if job_result.undecided(pruned) else "APPLIED"
    return "READY" if bridge.is_splat(context.object) else "NOTHING"


def sentences(context) -> list[str]:
    """What the panel says at this stage."""
    if problem := native_problem():
        return [problem]
    if (found := current(context)) is not None:
        return _of_job(found[1])
    original, pruned = job_result.pair_of(context.object)
    if pruned is not None:
        return (_of_result if job_result.undecided(pruned) else _of_applied)(original, pruned)
    return _of_ready(context) if bridge.is_splat(context.object) else ["Select a splat, or import one in step 1"]


def _of_ready(context) -> list[str]:
    found = estimate.of(context.object)
    texts = ["Estimating from some views …"] if found.get("busy") else estimate.sentences(context.object) if found else []
    texts += filter(None, [camera_match.sentence(context), edit_guard.problem(context, context.object), goals.problem(context.scene.svrgs_prune)])
    return texts if dataset_of(context)[0] else [*texts, "Choose the dataset of the splat's photographs, or import its cameras in step 1"]


def _of_job(job: Job) -> list[str]:
    if job.state in BUSY:
        silent = [f"No sign of life for {job.seconds_silent:.0f} s: Cancel ends the job"] if job.seconds_silent > SILENT_SECONDS else []
        return [job.facts.get("text") or "Working", *_figures(job.facts), *filter(None, [job.facts.get("note")]), *silent]
    if job.state not in WAITING:
        return ["A finished job was found: load its result, or discard it and start again"]
    progress = f" at {_progress_share(job.facts):.0%}" if job.facts.get("total") else ""
    return [WAITING_TEXT[job.state] + progress, *filter(None, [job.facts.get("text")]), *_figures(job.facts)]


def _of_result(original: bpy.types.Object | None, pruned: bpy.types.Object) -> list[str]:
    count, kept = job_result.shown_count(pruned), pruned[job_result.KEPT]
    texts = [f"{count:,}{f' of {bridge.count(original):,}' if original else ''} Gaussians, {size_text(pruned, count)}"]
    if job_result.PSNR in pruned:
        before, after = pruned[job_result.PSNR]
        elsewhere = "" if count == kept else "; not measured at this setting"
        texts.append(f"Quality at {kept:,} Gaussians: PSNR {before:.2f} → {after:.2f} dB{elsewhere}")
    return [*texts, f"{count - kept:,} more than were recovered: shown as in the original"] if count > kept else texts


def _of_applied(original: bpy.types.Object | None, pruned: bpy.types.Object) -> list[str]:
    text = f"Pruned to {bridge.count(pruned):,} Gaussians, {size_text(pruned, bridge.count(pruned))}"
    return [text, f"The original '{original.name}' ({bridge.count(original):,} Gaussians) is hidden"] if original is not None else [text]


def _figures(facts: dict) -> list[str]:
    if not facts.get("count"):
        return []
    return [f"{facts['count']:,} Gaussians" + (f", PSNR {facts['psnr']:.2f} dB" if facts.get("psnr") else "")]


def _progress_share(facts: dict) -> float:
    return facts.get("iteration", 0) / max(1, facts.get("total", 1))


def _time_left_text(facts: dict) -> str:
    if not facts.get("total"):
        return "Starting"
    left = facts.get("seconds_left", 0)
    return f"{_progress_share(facts):.0%}, " + (f"{left / 60:.0f} min left" if left >= 90 else f"{left:.0f} s left")


# --- getters of the properties


def _from_job(value, default):
    """A getter of value(job); of `default` where there is no job."""

    def get(_):
        found = current(bpy.context)
        return value(found[1]) if found is not None else default

    return get


_progress = _from_job(lambda job: _progress_share(job.facts), 0.0)
_time_left = _from_job(lambda job: _time_left_text(job.facts), "")
_plot = _from_job(lambda job: job_pictures.plot_icon(job.folder), 0)
_preview = _from_job(lambda job: job_pictures.preview_icon(job.folder), 0)


def _native_problem(_) -> str:
    return native_problem()


def _stage(_) -> str:
    return stage(bpy.context)


def _sentences(_) -> str:
    try:
        return "\n".join(sentences(bpy.context))
    except SplatError as error:  # an attribute of the result was deleted
        return str(error)


def _dataset(_) -> str:
    return dataset_of(bpy.context)[0]


def _method() -> Method:
    return METHODS[bpy.context.scene.svrgs_prune.method]


def _method_help(_) -> str:
    method, sentence = _method(), method_sentence(_method())
    return sentence if method.name in CHOICES.values() else f"{method.label}: {sentence}"


def _goal_help(_) -> str:
    return goals.sentence(bpy.context.scene.svrgs_prune)


def _strength_help(_) -> str:
    return goals.strength_sentence(bpy.context.scene.svrgs_prune)


def _method_renamed(_) -> str:
    return former_methods.sentence_of(bpy.context.scene)


def _subject(_) -> str:
    found = current(bpy.context)
    _, pruned = job_result.pair_of(bpy.context.object)
    obj = found[0] if found is not None else pruned or bpy.context.object
    return obj.name if obj is not None else ""


def _size(_) -> str:
    obj = bpy.context.object
    return f"{bridge.count(obj):,} Gaussians, {size_text(obj, bridge.count(obj))}" if bridge.is_splat(obj) else ""


def _marked(_) -> int:
    return job_result.marked_count(bpy.context.object) if bridge.is_splat(bpy.context.object) else 0


class SVRGS_PG_prune_state(bpy.types.PropertyGroup):
    native_problem: StringProperty(get=_native_problem)
    stage: StringProperty(get=_stage)
    sentences: StringProperty(get=_sentences)  # one a line
    subject: StringProperty(get=_subject)  # name of the splat that the panel is about
    progress: FloatProperty(get=_progress)  # 0..1
    time_left: StringProperty(get=_time_left)
    plot: IntProperty(get=_plot)  # icon
    preview: IntProperty(get=_preview)  # icon
    dataset: StringProperty(get=_dataset)
    method_help: StringProperty(get=_method_help)
    goal_help: StringProperty(get=_goal_help)
    strength_help: StringProperty(get=_strength_help)  # empty: the method has no λ_F
    method_renamed: StringProperty(get=_method_renamed)
    size: StringProperty(get=_size)
    marked: IntProperty(get=_marked)  # Gaussians of the active splat that are marked as removed


def register():
    bpy.utils.register_class(SVRGS_PG_prune_state)
    bpy.types.WindowManager.svrgs_prune_state = PointerProperty(type=SVRGS_PG_prune_state)


def unregister():
    del bpy.types.WindowManager.svrgs_prune_state
    bpy.utils.unregister_class(SVRGS_PG_prune_state)

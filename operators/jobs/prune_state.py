"""What the prune panel shows: window_manager.svrgs_prune_state, which the panels know by name.

All properties are read-only. They are worked out whenever a panel is drawn, and nothing is stored.
"""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.app.translations import pgettext_n as n_
from bpy.props import BoolProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from ...svrgs_addon.finetune.methods import METHODS
from ...svrgs_addon.finetune.methods.base import Method
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.errors import SplatError
from ..data import edit_guard, quick_order, splat_object
from ..data.native_check import native_problem
from ..data.option_properties import CHOICES, method_sentence
from ..data.splat_size import size_text
from ..scene import camera_match, dataset_paths, place_cameras
from . import depths, estimate, goals, job_pictures, job_queue, job_result, orphan_jobs
from .job import resume_sentence
from .job_watch import current, is_busy, is_resumable

SILENT_SECONDS = 60.0  # after this time without a sign of life, the panel says so
STOPPED_TEXT = {  # state -> what the panel says, and that with a progress; others: STOPPED
    "queued": (n_("Not started yet"), n_("Not started yet")),
    "interrupted": (n_("An interrupted job was found"), n_("An interrupted job was found at {share:.0%}")),
    "failed": (n_("The job failed"), n_("The job failed at {share:.0%}")),
}
STOPPED = n_("Stopped"), n_("Stopped at {share:.0%}")


def stage(context) -> str:
    """BROKEN (no native library), BUSY, WAITING or FINISHED (a job), RESULT (a pruned splat, not applied),
    READY (a splat), NOTHING."""
    if native_problem():
        return "BROKEN"
    if (found := current(context)) is not None:
        _, job = found
        return "BUSY" if is_busy(job) else "WAITING" if is_resumable(job) else "FINISHED"
    _, pruned = job_result.pair_of(context.object)
    if job_result.undecided(pruned):
        return "RESULT"
    return "READY" if splat_object.is_splat(context.object) else "NOTHING"


def sentences(context) -> list[str]:
    """What the panel says at this stage."""
    if problem := native_problem():
        return [problem]
    if (found := current(context)) is not None:
        return _of_job(found[1])
    original, pruned = job_result.pair_of(context.object)
    if pruned is not None and job_result.undecided(pruned):
        return _of_result(original, pruned)
    return (
        _of_ready(context)
        if splat_object.is_splat(context.object)
        else [tr("Select a splat, or import one in step 1")]
    )


def _of_ready(context) -> list[str]:
    found = estimate.of(context.object)
    texts: list[str] = (
        [tr("Estimating from some views …")]
        if found.get("busy")
        else estimate.sentences(context.object)
        if found
        else []
    )
    texts += filter(
        None,
        [
            camera_match.sentence(context),
            edit_guard.problem(context, context.object),
            goals.problem(context.scene.svrgs_prune),
        ],
    )
    return [
        *texts,
        *filter(
            None,
            [
                depths.problem(context),
                place_cameras.sentence(context.object),
                orphan_jobs.sentence(context),
                _of_applied(context.object),
            ],
        ),
    ]


def _of_job(job: Job) -> list[str]:
    if job_queue.is_queued(job):
        return [tr("{waiting}: one job runs at a time").format(waiting=job_queue.waiting_text(job))]
    if is_busy(job):
        without = (
            [". ".join((tr("Stop Now does not wait for it"), resume_sentence(job)))] if job.stopping else []
        )
        texts = [
            tr(job.facts.get("text") or n_("Working")),
            *_figures(job.facts),
            *_planned(job.facts),
            *filter(None, [job.facts.get("note")]),
            *without,
        ]
        silent = tr("No sign of life for {seconds:.0f} s: Stop ends the job").format(
            seconds=job.seconds_silent
        )
        return [*texts, silent] if job.seconds_silent > SILENT_SECONDS else texts
    if not is_resumable(job):
        return [tr("A finished job was found: load its result, or discard it and start again")]
    state = tr(STOPPED_TEXT.get(job.state, STOPPED)[job.knows_progress]).format(share=job.progress)
    return [
        state,
        *map(tr, filter(None, [job.facts.get("text")])),
        resume_sentence(job),
        *_figures(job.facts),
    ]


def _of_result(original: bpy.types.Object | None, pruned: bpy.types.Object) -> list[str]:
    count, kept = job_result.shown_count(pruned), pruned[job_result.KEPT]
    text = tr("{kept:,} of {count:,} Gaussians, {size}") if original else tr("{kept:,} Gaussians, {size}")
    texts = [
        text.format(
            kept=count, count=splat_object.count(original) if original else 0, size=size_text(pruned, count)
        )
    ]
    if job_result.PSNR in pruned:
        before, after = pruned[job_result.PSNR]
        text = tr("Quality at {kept:,} Gaussians: PSNR {before:.2f} → {after:.2f} dB")
        if count != kept:
            text = tr(
                "Quality at {kept:,} Gaussians: PSNR {before:.2f} → {after:.2f} dB; not measured at this"
                " setting"
            )
        texts.append(text.format(kept=kept, before=before, after=after))
    if job_result.OWN_PSNR in pruned:
        text = tr("Quality at {kept:,} Gaussians: PSNR {psnr:.2f} dB against the original's own pictures")
        texts.append(text.format(kept=kept, psnr=pruned[job_result.OWN_PSNR]))
    texts += [_capitalised(note) for note in pruned.get(job_result.NOTES, "").splitlines() if note.strip()]
    if quick_order.is_shown(pruned):
        return [
            *texts,
            tr("This number is not fine-tuned yet: press Fine-Tune for that. Apply keeps what you see"),
        ]
    texts += filter(None, [quick_order.problem(pruned)])
    return (
        [
            *texts,
            tr("{count:,} more than were recovered: shown as in the original").format(count=count - kept),
        ]
        if count > kept
        else texts
    )


def _capitalised(note: str) -> str:
    """The sentence with a capital, unless it begins with the name of a file."""
    return note[0].upper() + note[1:] if note.split()[0].isalpha() else note


def _of_applied(obj: bpy.types.Object) -> str:
    """Of one of a pair that was applied: what the other one is."""
    original, pruned = job_result.pair_of(obj)
    if original is None or pruned is None:
        return ""
    other = original if obj == pruned else pruned
    text = (
        tr("Pruned from '{name}', {count:,} Gaussians")
        if other == original
        else tr("Pruned to '{name}', {count:,} Gaussians")
    )
    hidden = tr("which is hidden") if other.hide_get() and other.hide_render else ""
    return ", ".join(filter(None, (text.format(name=other.name, count=splat_object.count(other)), hidden)))


def _figures(facts: dict) -> list[str]:
    if not facts.get("count"):
        return []
    text = tr("{count:,} Gaussians, PSNR {psnr:.2f} dB") if facts.get("psnr") else tr("{count:,} Gaussians")
    return [text.format(count=facts["count"], psnr=facts.get("psnr"))]


def _planned(facts: dict) -> list[str]:
    """Of a job whose time is limited: what was foreseen."""
    if not facts.get("schedule"):
        return []
    return [
        tr("Planned for {asked:.0f} s: {schedule:.1%} of the steps, about {foreseen:.0f} s").format(**facts)
    ]


def _time_left_text(job: Job) -> str:
    if job_queue.is_queued(job):
        return tr("Waiting")
    if not job.knows_progress:
        return tr("Starting")
    if "seconds_left" not in job.facts:  # by blocks
        return f"{job.progress:.0%}"
    left = job.facts["seconds_left"]
    text = (
        tr("{share:.0%}, {minutes:.0f} min left") if left >= 90 else tr("{share:.0%}, {seconds:.0f} s left")
    )
    return text.format(share=job.progress, minutes=left / 60, seconds=left)


# --- getters of the properties


def _from_job(value, default):
    """A getter of value(job); of `default` where there is no job."""

    def get(_):
        found = current(bpy.context)
        return value(found[1]) if found is not None else default

    return get


_progress = _from_job(lambda job: job.progress, 0.0)
_time_left = _from_job(_time_left_text, "")
_stopping = _from_job(lambda job: job.stopping, False)
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
    return dataset_paths.dataset_of(bpy.context)[0]


def _lost_dataset(_) -> str:
    return dataset_paths.lost(splat_object.root_of(bpy.context.object))


def _orphan(_) -> str:
    return orphan_jobs.sentence(bpy.context) if stage(bpy.context) == "READY" else ""


def _merges(_) -> bool:
    return depths.merges(bpy.context)


def _slider(_) -> bool:
    _, pruned = job_result.pair_of(bpy.context.object)
    return pruned is not None and job_result.has_slider(pruned)


def _untuned(_) -> bool:
    _, pruned = job_result.pair_of(bpy.context.object)
    return pruned is not None and quick_order.is_shown(pruned)


def _original(_) -> str:
    original, pruned = job_result.pair_of(bpy.context.object)
    return original.name if original is not None and not job_result.undecided(pruned) else ""


def _method() -> Method:
    return METHODS[bpy.context.scene.svrgs_prune.method]


def _method_help(_) -> str:
    if depths.merges(bpy.context):
        return tr(method_sentence(METHODS["merge"]))
    method, sentence = _method(), tr(method_sentence(_method()))
    return sentence if method.name in CHOICES.values() else f"{tr(method.label)}: {sentence}"


def _goal_help(_) -> str:
    return goals.sentence(bpy.context.scene.svrgs_prune, depths.merges(bpy.context))


def _strength_help(_) -> str:
    return goals.strength_sentence(bpy.context.scene.svrgs_prune)


def _subject(_) -> str:
    found = current(bpy.context)
    _, pruned = job_result.pair_of(bpy.context.object)
    obj = found[0] if found is not None else pruned if job_result.undecided(pruned) else bpy.context.object
    return obj.name if obj is not None else ""


def _size(_) -> str:
    obj = bpy.context.object
    if not splat_object.is_splat(obj):
        return ""
    count = quick_order.count(obj)
    return tr("{kept:,} Gaussians, {size}").format(kept=count, size=size_text(obj, count))


def _marked(_) -> int:
    return job_result.marked_count(bpy.context.object) if splat_object.is_splat(bpy.context.object) else 0


class SVRGS_PG_prune_state(bpy.types.PropertyGroup):
    native_problem: StringProperty(get=_native_problem)
    stage: StringProperty(get=_stage)
    sentences: StringProperty(get=_sentences)  # one a line
    subject: StringProperty(get=_subject)  # name of the splat that the panel is about
    progress: FloatProperty(get=_progress)  # 0..1
    time_left: StringProperty(get=_time_left)
    plot: IntProperty(get=_plot)  # icon
    preview: IntProperty(get=_preview)  # icon
    stopping: BoolProperty(get=_stopping)  # the job was asked to stop and has not ended yet
    dataset: StringProperty(get=_dataset)
    # that the dataset of the imported cameras is not where it was; else empty
    lost_dataset: StringProperty(get=_lost_dataset)
    orphan: StringProperty(get=_orphan)  # that a job of the active splat was found; else empty
    original: StringProperty(get=_original)  # name of the original of an applied result; empty: none
    merges: BoolProperty(get=_merges)  # Gaussians will be merged
    slider: BoolProperty(get=_slider)  # fewer or more Gaussians than those of the result can be shown
    untuned: BoolProperty(get=_untuned)  # the number that is shown was not fine-tuned
    method_help: StringProperty(get=_method_help)
    goal_help: StringProperty(get=_goal_help)
    strength_help: StringProperty(get=_strength_help)  # empty: the method has no λ_F
    size: StringProperty(get=_size)
    marked: IntProperty(get=_marked)  # Gaussians of the active splat that are marked as removed


def register():
    bpy.utils.register_class(SVRGS_PG_prune_state)
    bpy.types.WindowManager.svrgs_prune_state = PointerProperty(type=SVRGS_PG_prune_state)


def unregister():
    del bpy.types.WindowManager.svrgs_prune_state
    bpy.utils.unregister_class(SVRGS_PG_prune_state)

"""What the prune panel says. It is worked out whenever a panel is drawn; nothing is stored."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.app.translations import pgettext_n as n_

from ...svrgs_addon.finetune.methods import METHODS
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.errors import SplatError
from ..data import edit_guard, option_properties, quick_order, splat_object
from ..data.native_check import native_problem
from ..data.option_properties import CHOICES
from ..data.splat_size import size_text
from ..scene import camera_match, place_cameras
from . import depths, estimate, goals, job_queue, job_result, orphan_jobs
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
    try:
        return _sentences(context)
    except SplatError as error:  # an attribute of the result was deleted
        return [str(error)]


def _sentences(context) -> list[str]:
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


def time_left(job: Job) -> str:
    """How far the job is, and how long it will take."""
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


def subject(context) -> bpy.types.Object | None:
    """The splat, or the root of cameras, that the panel is about."""
    found = current(context)
    _, pruned = job_result.pair_of(context.object)
    return found[0] if found is not None else pruned if job_result.undecided(pruned) else context.object


def method_sentence(context) -> str:
    """What the chosen method does; of one that the short menu does not name, after its name."""
    method = METHODS["merge" if depths.merges(context) else context.scene.svrgs_prune.method]
    sentence = tr(option_properties.method_sentence(method))
    named = depths.merges(context) or method.name in CHOICES.values()
    return sentence if named else f"{tr(method.label)}: {sentence}"


def size(obj: bpy.types.Object) -> str:
    """The number of Gaussians of the splat, and the size of its file."""
    count = quick_order.count(obj)
    return tr("{kept:,} Gaussians, {size}").format(kept=count, size=size_text(obj, count))

"""What the prune panel says. It is worked out whenever a panel is drawn; nothing is stored."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.app.translations import pgettext_n as n_

from ...svrgs_addon.finetune import checkpoint
from ...svrgs_addon.finetune.methods import METHODS
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.prune.disk_room import bytes_of_job
from ...svrgs_addon.system.errors import SplatError
from ..data import edit_guard, option_properties, quick_order, splat_object
from ..data.extension import native_problem
from ..data.job_paths import job_folders
from ..data.option_properties import CHOICES
from ..data.splat_size import file_size_text, size_of, size_text
from ..scene import camera_match, dataset_paths, place_cameras
from . import efforts, goals, job_queue, job_result, job_state, orphan_jobs
from .job_watch import current

MUCH_BYTES = 100e6  # from here on the panel says how much of the disk a job takes
SILENT_SECONDS = 60.0  # after this time without a sign of life, the panel says so


def stage(context) -> str:
    """BROKEN (no native library), BUSY, WAITING or FINISHED (a job), RESULT (a pruned splat, not applied),
    READY (a splat), NOTHING."""
    if native_problem():
        return "BROKEN"
    if (found := current(context)) is not None:
        _, job = found
        return "BUSY" if job_state.is_busy(job) else "WAITING" if job_state.is_resumable(job) else "FINISHED"
    if job_result.undecided(job_result.pair_of(context.object)[1]):
        return "RESULT"
    return "READY" if splat_object.is_splat(context.object) else "NOTHING"


def sentences(context) -> list[str]:
    """What the panel says at this stage."""
    original, pruned = job_result.pair_of(context.object)
    try:
        if problem := native_problem():
            return [problem]
        if (found := current(context)) is not None:
            return _of_job(found[1])
        if pruned is not None and job_result.undecided(pruned):
            return _of_result(original, pruned)
        if splat_object.is_splat(context.object):
            return _of_ready(context)
        return [tr("Select a splat, or import one in Scene")]
    except SplatError as error:  # an attribute of the result was deleted
        return [str(error)]


def _of_ready(context) -> list[str]:
    obj = context.object
    texts = [
        camera_match.sentence(context),
        edit_guard.problem(context, obj),
        goals.problem(context.scene.svrgs_prune),
        _problem_of_effort(context),
        place_cameras.sentence(obj),
        orphan_jobs.sentence(context),
        _of_applied(obj),
        _disk_use(context),
    ]
    return [text for text in texts if text]


def _disk_use(context) -> str:
    """How much of the disk a job takes, if that is much."""
    obj, count = context.object, splat_object.count(context.object)
    coefficients = (splat_object.sh_degree(obj) + 1) ** 2
    quick = context.scene.svrgs_prune.effort == "QUICK"
    size = bytes_of_job(count, size_of(obj, count), coefficients, quick, checkpoint.KEPT + 1)
    if size < MUCH_BYTES:
        return ""
    text = tr("The job takes up to {size} in '{folder}', until its result is applied or discarded")
    return text.format(size=file_size_text(size), folder=Path(job_folders(context)[0]).name)


def _problem_of_effort(context) -> str:
    """As efforts.problem(), but not what the panel Scene says already."""
    problem = efforts.problem(context)
    return problem if problem != dataset_paths.lost(splat_object.root_of(context.object)) else ""


def _of_job(job: Job) -> list[str]:
    facts = job.facts
    if job_queue.is_queued(job):
        text = tr("{waiting}. One job runs at a time; Quick ones do not wait for longer ones")
        return [text.format(waiting=job_queue.waiting_text(job) or tr("Waiting"))]
    if job_state.is_resumable(job):
        reason = _with_capital(tr(facts["text"])) if facts.get("text") else ""
        texts = [job_state.text(job), reason, job_state.resume_sentence(job), _figures(facts)]
    elif not job_state.is_busy(job):
        found = tr("A finished job was found: load its result, or discard it and start again")
        texts = [found if job.state == "done" else job_state.text(job)]
    else:
        texts = [tr(facts.get("text") or n_("Working")), _figures(facts)]
        if facts.get("schedule"):  # its time is limited
            text = tr("Planned for {asked:.0f} s: {schedule:.1%} of the steps, about {foreseen:.0f} s")
            texts.append(text.format(**facts))
        if facts.get("iteration") and not facts.get("finishing") and not job.stopping:
            texts.append(tr("If Blender closes, this job can be resumed later"))
        texts.append(_with_capital(facts.get("note", "")))
        if job.stopping:
            texts.append(". ".join((tr("Stop Now does not wait for it"), job_state.resume_sentence(job))))
        if job.seconds_silent > SILENT_SECONDS:
            text = tr("No sign of life for {seconds:.0f} s: Stop ends the job")
            texts.append(text.format(seconds=job.seconds_silent))
    return [text for text in texts if text]


def _with_capital(note: str) -> str:
    """The note, with a capital unless it begins with the name of a file."""
    return note[0].upper() + note[1:] if note.strip() and note.split()[0].isalpha() else note


def _figures(facts: dict) -> str:
    if not facts.get("count"):
        return ""
    text = tr("{count:,} Gaussians, PSNR {psnr:.2f} dB") if facts.get("psnr") else tr("{count:,} Gaussians")
    return text.format(count=facts["count"], psnr=facts.get("psnr"))


def _quality(pruned: bpy.types.Object) -> str:
    kept = pruned[job_result.KEPT]
    if job_result.PSNR in pruned:
        before, after = pruned[job_result.PSNR]
        text = tr("Quality at {kept:,} Gaussians: PSNR {before:.2f} → {after:.2f} dB")
        return text.format(kept=kept, before=before, after=after)
    if job_result.OWN_PSNR in pruned:
        text = tr("Quality at {kept:,} Gaussians: PSNR {psnr:.2f} dB against the original's own pictures")
        return text.format(kept=kept, psnr=pruned[job_result.OWN_PSNR])
    return ""


def _of_result(original: bpy.types.Object | None, pruned: bpy.types.Object) -> list[str]:
    count, kept = job_result.shown_count(pruned), pruned[job_result.KEPT]
    total = splat_object.count(original) if original is not None else 0
    text = tr("{kept:,} Gaussians, {size} as PLY")
    if total:
        text = tr("{kept:,} of {count:,} Gaussians, {size} as PLY")
    texts = [text.format(kept=count, count=total, size=size_text(pruned, count))]
    if quality := _quality(pruned):
        text = tr("{quality}; not measured at this setting")
        texts.append(quality if count == kept else text.format(quality=quality))
    texts += map(_with_capital, filter(str.strip, pruned.get(job_result.NOTES, "").splitlines()))
    if quick_order.is_shown(pruned):
        texts += [tr("This number is not fine-tuned yet: press Fine-Tune for that. Apply keeps what you see")]
    elif problem := quick_order.problem(pruned):
        texts.append(problem)
    elif job_result.ranked(pruned) and count > kept:
        text = tr("{count:,} more than were recovered: shown as in the original")
        if original is not None and job_result.moved_aside(original, pruned):
            text = tr(
                "{count:,} more than were recovered: shown as in the original and, until Apply, in its place"
            )
        texts.append(text.format(count=count - kept))
    return texts


def _of_applied(obj: bpy.types.Object) -> str:
    """Of one of a pair that was applied: what the other one is."""
    original, pruned = job_result.pair_of(obj)
    if original is None or pruned is None:
        return ""
    other = original if obj == pruned else pruned
    text = tr("Pruned to '{name}', {count:,} Gaussians")
    if other == original:
        text = tr("Pruned from '{name}', {count:,} Gaussians")
    said = text.format(name=other.name, count=splat_object.count(other))
    return ", ".join((said, tr("which is hidden"))) if other.hide_get() and other.hide_render else said


def method_sentence(context) -> str:
    """What the chosen method does; of one that the short menu does not name, after its name."""
    method = METHODS["merge" if efforts.merges(context) else context.scene.svrgs_prune.method]
    sentence = tr(option_properties.capitalised(method.help))
    named = efforts.merges(context) or method.name in CHOICES.values()
    return sentence if named else f"{tr(method.label)}: {sentence}"


def size(obj: bpy.types.Object) -> str:
    """The number of Gaussians of the splat, and the size of its file."""
    count = job_result.shown_count(obj) if job_result.undecided(obj) else splat_object.count(obj)
    return tr("{kept:,} Gaussians, {size}").format(kept=count, size=size_text(obj, count))

"""Apply and Discard: the two ways to end the comparison of an original with its pruned splat.

Apply keeps the Gaussians that are shown, including those of the original that the slider Keep brought back.
The original stays, hidden, until it is discarded. Both are ordinary splats from then on.

The files of a job are deleted when the .blend file is saved and its result, applied or trained, is in it.
Until then they stay, so that a crash loses nothing. An undo of Apply needs no files: marks and ranks are in
the scene. After it, the job belongs to its original again. If the file is never saved, the job list shows the
job as finished.
"""

from __future__ import annotations

import os

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.system.errors import SplatError
from ..data import edit_guard, known, splat_object
from ..data.job_paths import owners, unlink
from ..data.reporting import ReportingOperator
from ..data.select import select
from ..data.splat_size import size_text
from . import job_result, job_state
from .job_queue import jobs
from .job_watch import delete_job, job_of


class SVRGS_OT_apply(ReportingOperator):
    bl_label = "Apply"
    bl_description = (
        "Keep the Gaussians that are shown and delete the others from the pruned splat. The original stays,"
        " hidden. The files of the job are deleted when the .blend file is saved"
    )

    @classmethod
    def problem(cls, context) -> str:
        _, pruned = job_result.pair_of(context.object)
        if not job_result.undecided(pruned):
            return tr("Select a pruned splat that was not applied yet")
        return edit_guard.problem(context, pruned)

    def work(self, context) -> str:
        original, pruned = job_result.pair_of(context.object)
        assert pruned is not None  # see problem()
        scene = job_result.apply(pruned)
        job_result.settle(original, pruned)
        job = job_of(original)
        if original is not None and job is not None and job.state == "done":
            known.of(pruned).result_of = str(job.folder.path)
            unlink(original)
        select(context, [pruned])
        size = size_text(pruned, scene.count)
        if original is None:
            return tr("Kept {kept:,} Gaussians, {size} as PLY").format(kept=scene.count, size=size)
        return tr("Kept {kept:,} of {count:,} Gaussians, {size} as PLY").format(
            kept=scene.count, count=splat_object.count(original), size=size
        )


class SVRGS_OT_discard(ReportingOperator):
    bl_label = "Discard"
    bl_description = "Delete the original or the pruned splat from the file"

    what: bpy.props.EnumProperty(
        name="What", description="The splat to delete",
        items=[
            ("ORIGINAL", "Original", "The splat as it was before pruning. The pruned splat stays"),
            ("RESULT", "Result", "The pruned splat and the files of its job. The original is as it was"),
        ],
    )  # fmt: skip

    @classmethod
    def problem(cls, context) -> str:
        if context.mode == "OBJECT" and None not in job_result.pair_of(context.object):
            return ""
        return tr("Select a splat that was pruned, or its original")

    def work(self, context) -> str:
        original, pruned = job_result.pair_of(context.object)
        assert original is not None and pruned is not None  # see problem()
        job = job_of(original)
        if self.what == "ORIGINAL":
            if job_result.undecided(pruned):
                raise SplatError(tr("Apply the result first: it still needs the original"))
            if job is not None and job_state.is_busy(job):
                text = tr("A job is running on '{name}': stop it first")
                raise SplatError(text.format(name=original.name))
        deleted, left = (original, pruned) if self.what == "ORIGINAL" else (pruned, original)
        text = tr("Discarded '{deleted}' with {count:,} Gaussians; '{left}' stays")
        message = text.format(deleted=deleted.name, count=splat_object.count(deleted), left=left.name)
        if deleted is original:
            job_result.discard_original(original, pruned)
        else:
            self.discard_result(original)
        select(context, [left])
        return message

    def discard_result(self, original: bpy.types.Object):
        """With the files of its job."""
        job = job_of(original)
        try:
            if job is not None and job.state == "done":
                delete_job(job)
        except OSError as error:
            self.report({"WARNING"}, str(error))
        job_result.discard_result(original)


# --- the files of jobs whose result is in the file


def is_applied(folder: str) -> bool:
    """Whether the result of the job in this folder is in the file, and its files are deleted when that is
    saved."""
    return any(known.of(obj).result_of == folder for obj in _applied())


def _applied() -> list[bpy.types.Object]:
    """The applied and the trained splats in the file that still have a job."""
    results = (obj for obj in bpy.data.objects if known.of(obj).result_of and obj.users_collection)
    return [obj for obj in results if not job_result.undecided(obj)]


def _after_undo(*_):
    """After a redo, what had the job does not have it again."""
    known_owners = owners()
    for obj in _applied():
        if (owner := known_owners.get(known.of(obj).result_of)) is not None:
            unlink(owner)


def _after_save(path: str = "", *_):
    """Deletes the files, unless only a copy was saved."""
    if not bpy.data.filepath or (path and os.path.abspath(path) != os.path.abspath(bpy.data.filepath)):
        return
    for obj in _applied():
        job = jobs.get(known.of(obj).result_of)
        known.of(obj).result_of = ""
        if job is not None and job.state == "done":
            try:
                delete_job(job)
            except OSError as error:  # the job list shows the job
                print(f"SVR-GS: {error}", flush=True)


HANDLERS = {"save_post": _after_save, "undo_post": _after_undo, "redo_post": _after_undo}

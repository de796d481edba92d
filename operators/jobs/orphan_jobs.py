"""Jobs whose splat came back, for example because its file was imported again: the splat can take its job
over.

A job stores a digest of the Gaussians of which it was made. So a splat is known again whatever its name and
its file are.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.jobs.job_folder import digest_of
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.errors import FormatError, SplatError
from ..data import known, splat_object
from ..data.reporting import ReportingOperator
from . import applied_jobs
from .job_list import all_jobs, owners, state_text
from .job_queue import jobs
from .job_watch import job_of, link, start_timer

_requests: dict[str, tuple[int, str]] = {}  # by folder: of _made_of()


def orphan_of(context, obj: bpy.types.Object | None) -> Job | None:
    """A job without a splat in the file that was made of exactly these Gaussians; None if there is none."""
    if obj is None or not splat_object.is_splat(obj) or obj.library or job_of(obj) is not None:
        return None
    known, count = owners(), splat_object.count(obj)
    for job in all_jobs(context):
        folder = str(job.folder.path)
        if folder not in known and not applied_jobs.is_applied(folder):
            made_of = _made_of(job)
            if made_of[0] == count and made_of[1] == _digest(obj):
                return job
    return None


def sentence(context) -> str:
    """That a job of the active splat was found; '' if none was."""
    job = orphan_of(context, context.object)
    return (
        tr("A job of this splat was found: {state}").format(state=state_text(job)) if job is not None else ""
    )


def _made_of(job: Job) -> tuple[int, str]:
    """(number, digest) of the Gaussians of which the job was made; (0, "") if it does not say."""
    folder = str(job.folder.path)
    if folder not in _requests:
        try:
            request = job.folder.request()
        except FormatError:
            request = {"count": 0}
        _requests[folder] = request["count"], str(request.get("digest", ""))
    return _requests[folder]


def _digest(obj: bpy.types.Object) -> str:
    """The digest of the splat, kept until its data changes."""
    points = known.of_data(obj)
    points.digest = points.digest or digest_of(splat_object.scene_from_object(obj))
    return points.digest


@persistent
def _forget_all(*_):
    """After an undo, or with another file."""
    _requests.clear()


class SVRGS_OT_adopt_job(ReportingOperator):
    bl_idname = "svrgs.adopt_job"
    bl_label = "Take Over Job"
    bl_description = (
        "Give this splat the job that was made of the same Gaussians. Then it can be stopped, resumed or"
        " loaded here"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        if orphan_of(context, context.object) is not None:
            return True
        cls.poll_message_set(tr("No job of this splat was found"))
        return False

    def work(self, context) -> str:
        obj = context.object
        known.of_data(obj).digest = ""
        job = orphan_of(context, obj)
        if job is None:
            raise SplatError(tr("No job of this splat was found"))
        link(obj, str(job.folder.path))
        jobs.setdefault(str(job.folder.path), job)
        start_timer()
        return tr("'{name}' has its job again: {state}").format(name=obj.name, state=state_text(job))


CLASSES = (SVRGS_OT_adopt_job,)
HANDLERS = {
    "undo_post": _forget_all,
    "redo_post": _forget_all,
    "load_post": _forget_all,
}


def unregister():
    _forget_all()

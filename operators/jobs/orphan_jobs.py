"""Jobs whose splat came back, for example because its file was imported again: the splat can take its job
over.

A job stores a digest of the Gaussians of which it was made. So a splat is known again whatever its name and
its file are.
"""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.jobs.job_folder import digest_of
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.errors import SplatError
from ..data import known, splat_object
from ..data.background_work import watch
from ..data.job_paths import link, owners
from ..data.reporting import ReportingOperator
from . import job_state
from .apply import is_applied
from .job_list import all_jobs
from .job_watch import job_of, tick


def orphan_of(context, obj: bpy.types.Object | None) -> Job | None:
    """A job without a splat in the file that was made of exactly these Gaussians; None if there is none."""
    if not splat_object.is_splat(obj) or obj.library or job_of(obj) is not None:
        return None
    owned, count = owners(), splat_object.count(obj)
    for job in all_jobs(context):
        folder = str(job.folder.path)
        if folder not in owned and not is_applied(folder):
            request = job.request
            if request.get("count") == count and request.get("digest") == _digest(obj):
                return job
    return None


def sentence(context) -> str:
    """That a job of the active splat was found; '' if none was."""
    job = orphan_of(context, context.object)
    if job is not None:
        return tr("A job of this splat was found: {state}").format(state=job_state.text(job))
    return ""


def _digest(obj: bpy.types.Object) -> str:
    """The digest of the splat, kept until its data changes."""
    points = known.of_data(obj)
    points.digest = points.digest or digest_of(splat_object.scene_from_object(obj))
    return points.digest


class SVRGS_OT_adopt_job(ReportingOperator):
    bl_label = "Take Over Job"
    bl_description = (
        "Give this splat the job that was made of the same Gaussians. Then it can be stopped, resumed or"
        " loaded here"
    )

    @classmethod
    def problem(cls, context) -> str:
        return "" if orphan_of(context, context.object) else tr("No job of this splat was found")

    def work(self, context) -> str:
        obj = context.object
        known.of_data(obj).digest = ""
        job = orphan_of(context, obj)
        if job is None:
            raise SplatError(tr("No job of this splat was found"))
        link(obj, str(job.folder.path))
        watch(tick)
        return tr("'{name}' has its job again: {state}").format(name=obj.name, state=job_state.text(job))

"""The jobs that this Blender knows, and the queue: one job runs at a time, others wait in the order in which
they were started.

Each Blender has a queue of its own. A job that waits when Blender ends is found again as "not started yet".
"""

from __future__ import annotations

from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.jobs.job_folder import JobFolder
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.errors import SplatError

jobs: dict[str, Job] = {}  # by folder, all that were asked for: a job outlives its splat and its file
_queue: list[Job] = []


def job_in(folder: str) -> Job:
    """The job in a folder, as it is now; its state is "missing" if there is none."""
    if folder not in jobs:
        jobs[folder] = Job(JobFolder(folder))
    jobs[folder].refresh()
    return jobs[folder]


def start(job: Job) -> str:
    """Starts or continues the job, or lets it wait for others. Returns what it waits for, in a sentence, or
    ''. Raises SplatError, OSError."""
    jobs[str(job.folder.path)] = job
    if not job.running and not is_queued(job):
        if running() is None:
            job.start()
        else:
            job.queue()
            _queue.append(job)
    return waiting_text(job)


def running() -> Job | None:
    """The job with a process of this Blender."""
    return next((job for job in jobs.values() if job.running), None)


def is_queued(job: Job) -> bool:
    """Whether the job waits for others of this Blender."""
    return any(other is job for other in _queue)


def waiting_text(job: Job) -> str:
    """What a job in the queue waits for, in a sentence; '' for others."""
    first = running()
    return tr("Waiting for '{name}'").format(name=first.name) if is_queued(job) and first is not None else ""


def leave(job: Job):
    """Takes the job out of the queue. Its folder stays."""
    _queue[:] = [other for other in _queue if other is not job]


def advance() -> bool:
    """Starts the next job if none runs. Returns whether a job runs or waits."""
    while _queue and running() is None:
        job = _queue.pop(0)
        try:
            job.start()
        except (SplatError, OSError) as error:
            job.abort(str(error))
    return running() is not None


@persistent
def forget_ended(*_):
    """With another file: forgets the jobs that neither run nor wait."""
    for path in [path for path, job in jobs.items() if not job.running and not is_queued(job)]:
        del jobs[path]


HANDLERS = {"load_post": forget_ended}


def unregister():
    """Running jobs save a checkpoint and end."""
    for job in jobs.values():
        job.detach()
    jobs.clear()
    _queue.clear()

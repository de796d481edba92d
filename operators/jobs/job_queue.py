"""The jobs that this Blender knows, and the queue: one job runs at a time, others wait in the order in which
they were started. A quick job, which takes seconds, waits for quick jobs alone.

Each Blender has a queue of its own. A job that waits when Blender ends is found again as "not started yet".
"""

from __future__ import annotations

from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.jobs.job_folder import JobFolder
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.errors import SplatError

MINUTES = 90  # seconds from which on a time is told in minutes
ENDED_FOR_GOOD = ("done", "failed")  # states of jobs

jobs: dict[str, Job] = {}  # by folder, all that were asked for: a job outlives its splat and its file
_queue: list[Job] = []
_ended: list[Job] = []  # the job that ended last, until another one starts or another file is opened


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
        if _runs_before(job) is None:
            job.start()
        else:
            job.queue()
            _queue.append(job)
    return waiting_text(job)


def run_now(job: Job):
    """Lets a job that waits run next. The job that it waits for saves a checkpoint, stops, and goes on after
    it."""
    first = _runs_before(job)
    leave(job)
    _queue.insert(0, job)
    if first is not None and not first.stopping:  # else the user has stopped it, or it goes on already
        first.stop()
        _queue.insert(1, first)


def _runs_before(job: Job) -> Job | None:
    """The running job that has to end before this one starts."""
    blocks = (other for other in jobs.values() if other.running and (_is_quick(other) or not _is_quick(job)))
    return next(blocks, None)


def _is_quick(job: Job) -> bool:
    return bool(job.request.get("options", {}).get("quick"))


def is_queued(job: Job) -> bool:
    """Whether the job waits for others of this Blender."""
    return not job.running and any(other is job for other in _queue)


def waiting_text(job: Job) -> str:
    """What a job in the queue waits for, and how long that job takes, in a sentence; '' for others."""
    first = _runs_before(job)
    if first is None or not is_queued(job):
        return ""
    left = first.facts.get("seconds_left")
    if left is None:
        return tr("Waiting for '{name}'").format(name=first.name)
    text = tr("Waiting for '{name}', about {seconds:.0f} s")
    if left >= MINUTES:
        text = tr("Waiting for '{name}', about {minutes:.0f} min")
    return text.format(name=first.name, minutes=left / 60, seconds=left)


def leave(job: Job):
    """Takes the job out of the queue. Its folder stays."""
    _queue[:] = [other for other in _queue if other is not job]


def advance() -> bool:
    """Starts the jobs that wait for none any more. Returns whether a job runs."""
    for job in list(_queue):
        if job.running or _runs_before(job) is not None:
            continue
        leave(job)
        if job.state in ENDED_FOR_GOOD:  # it was to go on after another one, but had ended
            continue
        try:
            job.start()
        except (SplatError, OSError) as error:
            job.abort(str(error))
            note_end(job)
    return any(job.running for job in jobs.values())


def note_end(job: Job):
    """A job of this Blender has ended."""
    _ended[:] = [job]


def last_ended() -> Job | None:
    """The job that ended last, unless it was deleted since."""
    return next((job for job in _ended if str(job.folder.path) in jobs), None)


def forget_ended(*_):
    """With another file: forgets the jobs that neither run nor wait."""
    _ended.clear()
    for path in [path for path, job in jobs.items() if not job.running and not is_queued(job)]:
        del jobs[path]


HANDLERS = {"load_post": forget_ended}


def unregister():
    """Running jobs save a checkpoint and end."""
    for job in jobs.values():
        job.detach()
    for known in (jobs, _queue, _ended):
        known.clear()

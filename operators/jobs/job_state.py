"""The states of a job: its icon, its words, and what can be done with it. The prune panel, the list of jobs
and messages ask this table."""

from __future__ import annotations

from typing import NamedTuple

from bpy.app.translations import pgettext_iface as tr
from bpy.app.translations import pgettext_n as n_

from ...svrgs_addon.jobs.job_process import Job
from . import job_queue

BUSY = ("new", "starting", "running")  # states of a job that has a process, of this Blender or another one


class State(NamedTuple):
    """What is shown of a job, and offered."""

    icon: str
    text: str
    text_with_share: str  # where it is known how far the job is
    actions: tuple[str, ...]  # names of operators without svrgs.job_


_LEFT = ("resume", "discard")
STATES = {
    "waiting": State("SORTTIME", n_("Waiting"), n_("Waiting"), ("run_now", "stop")),
    "running": State("PLAY", n_("Running"), n_("Running at {share:.0%}"), ("stop",)),
    "stopping": State("PLAY", n_("Stopping"), n_("Stopping at {share:.0%}"), ("stop",)),
    "measuring": State("PLAY", n_("Running"), n_("Running at {share:.0%}"), ()),  # it ends by itself
    "queued": State("PAUSE", n_("Not started yet"), n_("Not started yet"), _LEFT),
    "stopped": State("PAUSE", n_("Stopped"), n_("Stopped at {share:.0%}"), _LEFT),
    "interrupted": State("ERROR", n_("Interrupted"), n_("Interrupted at {share:.0%}"), _LEFT),
    "failed": State("ERROR", n_("Failed"), n_("Failed at {share:.0%}"), _LEFT),
    "done": State("CHECKMARK", n_("Finished"), n_("Finished"), ("load", "discard")),
}
UNKNOWN = State("PAUSE", n_("In an unknown state"), n_("In an unknown state"), ("discard",))


def of(job: Job) -> State:
    if job_queue.is_queued(job):
        return STATES["waiting"]
    if job.state in BUSY:
        finishing = job.running and job.facts.get("finishing")
        return STATES["measuring" if finishing else "stopping" if job.stopping else "running"]
    return STATES.get(job.state, UNKNOWN)


def is_busy(job: Job) -> bool:
    """Whether the job runs, in any Blender, or waits in the queue."""
    return job.state in BUSY or job_queue.is_queued(job)


def is_resumable(job: Job) -> bool:
    return "resume" in of(job).actions


def text(job: Job) -> str:
    """The state in words, with the progress."""
    if waiting := job_queue.waiting_text(job):
        return waiting
    state = of(job)
    said = tr(state.text_with_share if job.knows_progress else state.text).format(share=job.progress)
    return ", ".join((said, tr("in another Blender"))) if job.state in BUSY and not job.running else said


def resume_sentence(job: Job) -> str:
    """From where a job that has not ended well would be continued."""
    template, values = job.resume_point()
    return tr(template).format(**values)


def time_left(job: Job) -> str:
    """How far a busy job is, and how long it will take."""
    if job_queue.is_queued(job):
        return tr("Waiting")
    if not job.knows_progress:
        return tr("Starting")
    if "seconds_left" not in job.facts:  # by blocks
        return f"{job.progress:.0%}"
    left = job.facts["seconds_left"]
    text = tr("{share:.0%}, {seconds:.0f} s left")
    if left >= job_queue.MINUTES:
        text = tr("{share:.0%}, {minutes:.0f} min left")
    return text.format(share=job.progress, minutes=left / 60, seconds=left)

"""The list of all jobs that this Blender knows: those of the open file, and those in the folders in which
jobs are made.

The owner of a job is the splat that it prunes, or the root of the cameras from which it trains one. A job
without its owner in the file is an orphan. It can be stopped, continued and loaded like the others
(orphan_jobs.py: if its splat comes back).

The folders are read again every SCAN_EVERY seconds while a panel asks.
"""

from __future__ import annotations

import contextlib
import os
import time
from typing import NamedTuple

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.jobs.job_folder import TRAIN
from ...svrgs_addon.jobs.job_process import Job
from ...svrgs_addon.system.memory import size_text
from ..data import quick_order
from ..data.job_paths import job_folders, owners
from . import job_queue, job_result, job_state
from .apply import is_applied

SCAN_EVERY = 3.0  # seconds between two readings of the folders

_sizes: dict[str, int] = {}  # by folder, of the last reading: bytes on disk; many folders have no splat here
_scanned = [0.0]  # time.monotonic() of the last reading


class Row(NamedTuple):
    """What the list shows of a job."""

    job: Job
    name: str
    icon: str
    state: str
    size: str  # and what is missing
    actions: tuple[str, ...]  # as in job_state


def all_jobs(context) -> list[Job]:
    """Every job that is known. Those that run come first, then those that wait, then the newest."""
    if time.monotonic() > _scanned[0] + SCAN_EVERY:
        _scan(context)
    folders = _sizes.keys() | job_queue.jobs.keys()
    found = [job for folder in folders if (job := job_queue.job_in(folder)).state != "missing"]
    return sorted(found, key=lambda job: (not job.running, not job_state.is_busy(job), -_begun(job)))


def _begun(job: Job) -> float:
    with contextlib.suppress(OSError):
        return os.path.getmtime(job.folder / "job.json")
    return 0.0


def forget(*_):
    """The folders are read again when a panel asks the next time."""
    _scanned[0] = 0.0
    _sizes.clear()


def _scan(context):
    _scanned[0] = time.monotonic()
    folders = owners().keys() | job_queue.jobs.keys()
    for parent in job_folders(context):
        with contextlib.suppress(OSError), os.scandir(parent) as entries:  # mostly there is none yet
            folders |= {entry.path for entry in entries if os.path.isfile(os.path.join(entry, "job.json"))}
    _sizes.clear()
    _sizes.update({folder: job_queue.job_in(folder).folder.size() for folder in folders})


def rows(context) -> list[Row]:
    """The jobs as the panel shows them."""
    known = owners()
    return [_row(job, known.get(str(job.folder.path))) for job in all_jobs(context)]


def _row(job: Job, owner: bpy.types.Object | None) -> Row:
    folder, state = str(job.folder.path), job_state.of(job)
    applied, loaded = is_applied(folder), _is_loaded(owner)
    said, reason = job_state.text(job), job.facts.get("text")
    if job.state == "failed" and reason:
        said = ": ".join((said, tr(reason)))
    if applied:
        said = tr("Finished: its files are deleted when the file is saved")
    elif loaded:
        said = ", ".join((said, tr("its result is in this file")))
    size = [size_text(_sizes[folder])] if _sizes.get(folder) else []
    if owner is None and not applied:
        training = job.kind == TRAIN
        size.append(tr("its cameras are not in this file" if training else "its splat is not in this file"))
    actions = tuple(one for one in state.actions if one != "load" or not (applied or loaded))
    return Row(job, owner.name if owner is not None else job.name, state.icon, said, ", ".join(size), actions)


def headline(context) -> str:
    """The running job in one line, with those that wait; or how the last one ended; '' if there was none."""
    busy = [job for job in job_queue.jobs.values() if job_state.is_busy(job)]
    if not busy:
        last = job_queue.last_ended()
        return "" if last is None else f"{last.name}: {job_state.text(last)}"
    busy.sort(key=lambda job: not job.running)
    texts = [f"{busy[0].name}: {job_state.time_left(busy[0])}"]
    if len(busy) > 1:
        texts.append(tr("{count} more").format(count=len(busy) - 1))
    return "; ".join(texts)


def _is_loaded(owner: bpy.types.Object | None) -> bool:
    """Whether the result is beside the splat."""
    return owner is not None and job_result.undecided(job_result.pruned_of(owner))


def finished_jobs(context) -> tuple[list[Job], int]:
    """The jobs that svrgs.delete_finished_jobs deletes, and their bytes on disk."""
    known = owners()

    def is_over(job: Job) -> bool:
        """Not of a result that shows another number than its own: the files of the job give it."""
        folder = str(job.folder.path)
        if job.state != "done" or is_applied(folder):
            return False
        owner = known.get(folder)
        return owner is None or (_is_loaded(owner) and not quick_order.is_shown(job_result.pruned_of(owner)))

    found = list(filter(is_over, all_jobs(context)))
    return found, sum(_sizes.get(str(job.folder.path), 0) for job in found)


def finished_text(context) -> str:
    """The text of the button that deletes the finished jobs; empty: there are none."""
    found, size = finished_jobs(context)
    text = tr("Delete {count:,} Finished, {size}")
    return text.format(count=len(found), size=size_text(size)) if found else ""

"""`--time SECONDS`: the schedule whose job fits into a time, chosen before the work begins, and what was
foreseen.

The speeds are measured (duration.py), so the schedule depends on the machine and on what else it does. A run
can be repeated exactly with the schedule that is chosen. A resumed job goes on with the schedule that its
checkpoint holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..finetune import checkpoint
from ..finetune.plan import Plan, at_schedule
from ..system.errors import FormatError, SceneError

# share of the time that is left free, because steps are not foreseen exactly
MARGIN, TRAINING_MARGIN = 0.1, 0.2
LATE = 1.05  # times the time that was asked for: a job that takes longer gets a note
# schedules that are chosen: 80 of the 8 000 steps of `svrgs prune`, and all of them
MIN_SCHEDULE, MAX_SCHEDULE = 0.01, 1.0
GRID = 10_000  # a schedule is a multiple of 1/GRID


@dataclass(frozen=True)
class TimePlan:
    """A time that was asked for, the time that was foreseen, seconds, and the schedule that was chosen."""

    asked: float
    foreseen: float
    schedule: float

    def sentence(self, plan: Plan, *foreseen: str) -> str:
        """What is expected, in one line. plan: the chosen one. foreseen: further parts, empty ones are left
        out."""
        steps = f"{plan.total:,} steps" + (", the whole schedule" if self.schedule == MAX_SCHEDULE else "")
        parts = [
            steps,
            f"about {self.foreseen:.0f} s",
            *filter(None, foreseen),
            f"the same again with --schedule {self.schedule:g}",
        ]
        return f"--time {self.asked:g}: {'; '.join(parts)}"

    def late(self, used: float) -> list[str]:
        """What the user must know if the job has used clearly more seconds than were asked for."""
        if used <= LATE * self.asked:
            return []
        return [
            f"the job took {used:.0f} s, more than the {self.asked:g} s that were allowed: this machine was"
            " slower than when the steps were chosen"
        ]


def fitted(
    asked: float, plan: Plan, seconds: Callable[[Plan], float], fixed: float, margin: float = MARGIN
) -> TimePlan:
    """The plan for a time. plan: with the whole schedule. seconds: of a plan; they rise with the schedule.
    fixed: further seconds. Raises SceneError if the time is too short."""
    foreseen = lambda n: fixed + seconds(at_schedule(plan, n / GRID))
    least, most, limit = round(MIN_SCHEDULE * GRID), round(MAX_SCHEDULE * GRID), asked * (1 - margin)
    if (shortest := foreseen(least)) > limit:
        enough = math.ceil(shortest / (1 - margin))
        raise SceneError(
            f"{asked:g} s are too short: the shortest job that makes sense takes about {enough} s on this"
            f" machine; allow {enough} s or more"
        )
    while least < most:
        middle = (least + most + 1) // 2
        least, most = (middle, most) if foreseen(middle) <= limit else (least, middle - 1)
    return TimePlan(asked, foreseen(least), least / GRID)


def of_checkpoint(asked: float, folder: Path) -> TimePlan | None:
    """The plan of the newest checkpoint in the folder; None if there is no checkpoint, or none with a plan.
    Raises FormatError if it is for another time."""
    found = checkpoint.newest_manifest(folder)
    if not found or not found.get("time"):
        return None
    planned = TimePlan(*(float(found["time"][key]) for key in ("asked", "foreseen", "schedule")))
    if planned.asked != asked:
        raise FormatError(
            f"{folder}: its checkpoint is of a run with --time {planned.asked:g}: continue with that, or"
            " delete the folder to start again"
        )
    return planned

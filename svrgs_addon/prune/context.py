"""The surroundings of a job: its outputs, its engine, its observers. The plan (finetune/plan.py) says what it
computes."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..files.level_files import level_files
from ..finetune.loop import Progress
from ..finetune.run import Run
from ..render.metrics.lpips import Lpips, measurable
from ..scene.camera import Camera
from ..system import memory
from ..system.errors import SceneError
from .time_plan import TimePlan

PROCESS = 0.5  # seconds of starting and ending the program


@dataclass(frozen=True)
class JobContext:
    """Where a job writes, whether it resumes, how it measures LPIPS, and its callbacks."""

    out: Path
    report: Path | None = None
    resume: bool = False
    engine: str = "native"
    force: bool = False  # prune also where views or photographs seem to be of another splat
    scene: Path | None = None  # the splat that is pruned; None: a training
    order: Path | None = None  # folder for the order of a quick job (finetune/decimate/saved_order.py)
    levels: tuple[float, ...] = ()  # shares of a nested result that are written too
    limit: float = 0.0  # seconds that the job may take; 0: no limit
    planned: TimePlan | None = None  # of a job with a time limit
    # views that the observer renders: for each point of the curves, and at the end
    recorded: tuple[int, int] = (0, 0)
    started: float = field(default_factory=time.perf_counter)  # when the job began
    # called with the plan of a job with a time limit, and what is foreseen, in a sentence
    tell: Callable[[TimePlan, str], None] = lambda *_: None
    lpips: Lpips | None = None
    lpips_asked: bool = False  # by the name of its weights
    lpips_missing: str = ""  # why lpips is None
    observe: Callable[[Progress], None] = lambda _: None  # called after each step
    # progress of a job by blocks: called with a text and the share that is done, 0 to 1
    part: Callable[[str, float], None] = lambda *_: None
    stop: Callable[[], bool] = lambda: False  # asked after each step
    # called before the first step, after a checkpoint was restored
    begin: Callable[[Run, list[str]], None] = lambda _run, _notes: None

    def fitting(self, cameras: Sequence[Camera], needed: int = 0) -> JobContext:
        """Without LPIPS if memory is too short for it, or if it was not asked for and a view is too small for
        it. needed: bytes that the job needs besides. Raises SceneError instead if memory is too short and it
        was asked for."""
        lpips, missing = measurable((self.lpips, self.lpips_missing), cameras, self.lpips_asked)
        if lpips is None:
            return replace(self, lpips=None, lpips_missing=missing)
        reason = memory.shortage("measuring LPIPS", needed + memory.perceiving(cameras))
        if reason and self.lpips_asked:
            raise SceneError(f"{reason}; leave out --lpips-weights")
        return replace(self, lpips=None, lpips_missing=reason) if reason else self

    def seconds(self) -> float:
        """Seconds since the job began, with those that the program needs to start and to end."""
        return PROCESS + time.perf_counter() - self.started

    @property
    def outs(self) -> list[Path]:
        """The splat files that the job writes: the result, and its levels of detail."""
        return [self.out, *self.level_files.values()]

    @property
    def level_files(self) -> dict[float, Path]:
        """The files of the levels of detail, by their share."""
        return level_files(self.out, self.levels)

    @property
    def folder(self) -> Path:
        """The folder of the checkpoints, until the job is finished."""
        return self.out.with_name(self.out.name + ".job")


class Clock:
    """Seconds of each phase, in order."""

    def __init__(self):
        self.started = time.perf_counter()
        self.earlier = 0.0  # seconds before the job was resumed
        self.phases: dict[str, float] = {}

    @contextlib.contextmanager
    def phase(self, name: str):
        begun = time.perf_counter()
        yield
        self.phases[name] = self.phases.get(name, 0.0) + time.perf_counter() - begun

    @property
    def total(self) -> float:
        return self.earlier + time.perf_counter() - self.started

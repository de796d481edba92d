"""The surroundings of a job: its outputs, its engine, its observers. The plan (finetune/plan.py) says what it computes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..finetune.loop import Progress
from ..finetune.run import Run


@dataclass(frozen=True)
class JobContext:
    """Where a job writes, whether it resumes, how it measures LPIPS, and its callbacks."""

    out: Path
    report: Path | None = None
    resume: bool = False
    engine: str = "native"
    lpips: Callable | None = None  # (image, photograph) -> float
    lpips_missing: str = ""  # why lpips is None
    observe: Callable[[Progress], None] = lambda _: None  # called after each step
    stop: Callable[[], bool] = lambda: False  # asked after each step
    begin: Callable[[Run], None] = lambda _: None  # called before the first step, after a checkpoint was restored

    @property
    def folder(self) -> Path:
        """The folder of the checkpoints, until the job is finished."""
        return self.out.with_name(self.out.name + ".job")

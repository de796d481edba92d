"""What a job writes, reads and tells, apart from its plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..finetune.loop import Progress
from ..finetune.run import Run


@dataclass(frozen=True)
class JobContext:
    """Where a job writes, how it resumes, how it measures, and whom it tells."""

    out: Path
    report: Path | None = None
    resume: bool = False
    engine: str = "native"
    lpips: Callable | None = None  # (image, photograph) -> float
    lpips_missing: str = ""  # why there is none
    observe: Callable[[Progress], None] = lambda _: None
    stop: Callable[[], bool] = lambda: False
    begin: Callable[[Run], None] = lambda _: None  # called with the run, restored if there is a checkpoint, before its first step

    @property
    def folder(self) -> Path:
        """Where checkpoints lie while the job is not finished."""
        return self.out.with_name(self.out.name + ".job")

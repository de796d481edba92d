"""What a recipe of the pipeline does in each step (pipeline.py)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .context import JobContext


class Recipe:
    """A step that a recipe does not need does nothing. A step raises SplatError; MemoryShort or TooMany, of
    those up to check(), where memory is too short; those after check() raise Cancelled, too."""

    job: JobContext

    def further_files(self) -> list[Path]:
        """Those that it writes beside the outputs, such as checkpoints."""
        return []

    def open(self):
        """Reads the scene, or as much of it as tells where it is."""

    def views(self):
        """Which views decide, are trained on, and measure."""

    def check(self):
        """Whether views and scene go together, and memory and disk suffice."""

    def rank(self):
        """The order of the Gaussians, where it does not depend on how many stay."""

    def budget(self):
        """How many stay, or what decides that; how many steps fit into the time."""

    def select(self):
        """What is removed or merged before the steps."""

    def tune(self):
        """The steps."""

    def write(self):
        """All outputs."""

    def measure(self) -> dict[str, Any]:
        """The JSON result."""
        raise NotImplementedError

    def close(self):
        """Gives back what the recipe holds, also after an error."""

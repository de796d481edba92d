"""As few Gaussians as an allowed drop in PSNR leaves (--max-drop)."""

from __future__ import annotations

import contextlib
import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...files.registry import format_to_write
from ...finetune.methods.removal import floor_of_drop
from ...finetune.plan import Plan
from ...finetune.quality import MIN_SHARE, fewest, squared_error
from ...render.metrics.allowed_loss import ASSUMED, refuse_loss
from ...scene.camera import Camera
from ..likeness import Likeness, assumed_psnr
from .divided import Divided, ProgressOf, divide
from .folder import HELD
from .merging import most_needed
from .pruning import write_joined
from .tuning import CUT, cut, written


@dataclass(frozen=True)
class AllowedDrop:
    """A drop in dB that is allowed in the views of a likeness, which decide."""

    divided: Divided
    likeness: Likeness
    allowed: float
    out: Path
    progress_of: ProgressOf

    def errors_of_format(self) -> list[float]:
        """The mean squared error in each view of the whole scene as the format of the output holds it. Raises
        SplatError; SceneError if the format alone loses the allowed drop, or without views."""
        self.likeness.refuse_without_views()
        if format_to_write(self.out).lossless:
            return [0.0] * len(self.likeness.views)
        with self._held() as stored:
            errors = [squared_error(value) for value in self.likeness.psnrs(stored, "try")]
        refuse_loss(self.out, ASSUMED - assumed_psnr([math.inf] * len(errors), errors), self.allowed)
        return errors

    def fewest_within(self, scored: Sequence[Camera], errors: Sequence[float]) -> int:
        """The fewest Gaussians, at least MIN_SHARE of them, that hold the allowed drop before fine-tuning,
        which wins a part of it back. scored: the views that were scored. errors: from errors_of_format().
        Raises SplatError."""

        def within(count: int) -> bool:
            left = cut(self.divided, scored, count, self.progress_of("try"))
            return assumed_psnr(self.likeness.psnrs(left, "try"), errors) >= ASSUMED - self.allowed

        return self._fewest(within)

    def floor_on_photographs(self, plan: Plan) -> float:
        """The PSNR in dB against photographs that a removal may leave without any learning, for the allowed
        drop at the end of the plan. What the format of the output loses of the whole scene counts. Raises
        SplatError; SceneError if the format alone loses the allowed drop."""
        before, loss = self.likeness.psnr(self.divided), 0.0
        if not format_to_write(self.out).lossless:
            with self._held() as stored:
                loss = max(0.0, before - self.likeness.psnr(stored))
            refuse_loss(self.out, loss, self.allowed)
        return floor_of_drop(before, replace(plan, max_loss=self.allowed - loss))

    def fewest_above(self, floor: float) -> int:
        """The fewest Gaussians of highest removal error, at least MIN_SHARE of all, with this PSNR in dB.
        Raises SplatError."""

        def within(count: int) -> bool:
            left = most_needed(self.divided, count, self.progress_of("try"))
            return self.likeness.psnr(written(self.divided, left, CUT)) >= floor

        return self._fewest(within)

    def _fewest(self, within: Callable[[int], bool]) -> int:
        count = self.divided.count
        return fewest(math.ceil(MIN_SHARE * count), count, within)

    @contextlib.contextmanager
    def _held(self) -> Iterator[Divided]:
        """The scene as the format of the output holds it, divided as long as the context lasts."""
        self.progress_of("try")("writes the scene in the format of the output", 0.0)
        folder = self.divided.folder / HELD
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        try:
            write_joined(self.divided, folder / self.out.name)
            yield divide(folder / self.out.name, folder / "blocks")
        finally:
            shutil.rmtree(folder, ignore_errors=True)

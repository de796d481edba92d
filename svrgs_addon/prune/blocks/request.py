"""What is asked of a method that decides on photographs. It lies as request.json beside the blocks."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ...files.atomic import write_json
from ...files.reading import json_object
from ...finetune.methods import METHODS, method_named
from ...finetune.methods.removal import Removal
from ...finetune.plan import Plan, prune_plan
from ...finetune.quality import hold_apart
from ...system.errors import FormatError, SceneError
from ...views.dataset import Dataset, load_dataset
from ...views.valid_pixels import MaskOptions
from ..door import check_training

FILE = "request.json"


def methods() -> list[str]:
    """The names of the methods that can decide block by block: lambda_F is the same price in all blocks."""
    return [name for name, method in METHODS.items() if method.lambda_f]


def methods_of_drop() -> list[str]:
    """Of these, the names of those that can hold an allowed drop: what their steps win back of a removal is
    foreseen before they decide."""
    return [name for name in methods() if isinstance(METHODS[name], Removal)]


@dataclass(frozen=True)
class Request:
    """A dataset, a method and its settings, as the options of `svrgs prune` with these names. F counts up to
    where the colours of a ray stop, because a block does not know what is hidden behind others."""

    data: str
    method: str
    iterations: int
    recovery: int
    min_contribution: float
    images: str = ""
    holdout: int = 8
    lambda_f: float | None = None
    seed: int = 0
    schedule: float = 1.0
    masks: str = ""
    invert_masks: bool = False
    outside: str = "auto"
    image_memory: float = 4.0  # GB
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def plan(self) -> Plan:
        """Raises SceneError for a method that cannot decide block by block, and for no steps."""
        if self.method not in methods():
            raise SceneError(
                f"method '{self.method}' needs the scene in memory; by blocks, choose one of"
                f" {', '.join(methods())}"
            )
        if not self.iterations:
            raise SceneError("by blocks, a method decides in steps: give --iterations a number above 0")
        names = ("lambda_f", "seed", "background", "min_contribution", "schedule")
        settings: dict[str, Any] = {name: getattr(self, name) for name in names}
        return prune_plan(method_named(self.method), self.iterations, self.recovery, full=False, **settings)

    def refuse_drop(self):
        """Raises SceneError for a method that cannot hold an allowed drop."""
        if self.method not in methods_of_drop():
            raise SceneError(
                f"--max-drop by blocks is for {' and '.join(methods_of_drop())}, not for '{self.method}':"
                " choose one of these, or give --target"
            )

    def dataset(self) -> Dataset:
        """Raises SceneError, FormatError."""
        found = load_dataset(
            self.data,
            self.images or None,
            holdout=self.holdout,
            background=self.background,
            memory_budget=int(self.image_memory * 1e9),
            masks=MaskOptions(Path(self.masks) if self.masks else None, self.invert_masks, self.outside),
        )
        if not found.photos:
            raise SceneError(f"{self.data}: has no photographs, which the method '{self.method}' needs")
        check_training(found.train_indices)
        return hold_apart(found)

    def write(self, folder: Path):
        write_json(folder / FILE, asdict(self))

    @classmethod
    def read(cls, folder: Path) -> Request | None:
        """None if nothing was asked of a method. Raises FormatError."""
        path = folder / FILE
        if not path.exists():
            return None
        try:
            found = json_object(path, 1 << 20) or {}
            return cls(**found | {"background": tuple(found["background"])})
        except (OSError, KeyError, TypeError):
            raise FormatError(f"{path}: is missing or damaged; divide the scene again") from None

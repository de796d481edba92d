"""What is asked of a method that decides on photographs. It lies as request.json beside the blocks."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

from ...files.atomic import write_bytes
from ...files.reading import json_object
from ...finetune.methods import DEFAULT, METHODS, method_named
from ...finetune.methods.removal import Removal
from ...finetune.plan import Plan
from ...finetune.quality import hold_apart
from ...system.errors import FormatError, SceneError
from ...system.option_kinds import check_mapping
from ...views.dataset import Dataset
from ..door import check_training, given
from ..options import PruneOptions
from ..plans import dataset_of, first_cut_of, plan_of_pruning

FILE = "request.json"
TAKEN = (  # options
    "data", "images", "holdout", "masks", "invert_masks", "outside", "image_memory", "background",
    "iterations", "recovery", "schedule", "lambda_f", "seed",
)  # fmt: skip


def methods() -> list[str]:
    """The names of the methods that can decide block by block: lambda_F is the same price in all blocks."""
    return [name for name, method in METHODS.items() if method.lambda_f]


def methods_of_drop() -> list[str]:
    """Of these, the names of those that can hold an allowed drop: what their steps win back of a removal is
    foreseen before they decide."""
    return [name for name in methods() if isinstance(METHODS[name], Removal)]


@dataclass(frozen=True)
class Request:
    """What is asked: the options of `svrgs prune` about the dataset, the method and its settings. F counts up
    to where the colours of a ray stop, because a block does not know what is hidden behind others."""

    options: PruneOptions

    @classmethod
    def of(cls, options: PruneOptions) -> Request:
        """Raises SceneError as plan()."""
        method = method_named(options.method or DEFAULT)
        found = {name: getattr(options, name) for name in TAKEN} | {"method": method.name}
        found |= {"min_contribution": first_cut_of(options, method), "visible_mask": True}
        request = cls(PruneOptions(**found))
        request.plan()
        return request

    def plan(self) -> Plan:
        """Raises SceneError for a method that cannot decide block by block, and for no steps."""
        if self.options.method not in methods():
            raise SceneError(
                f"method '{self.options.method}' needs the scene in memory; by blocks, choose one of"
                f" {', '.join(methods())}"
            )
        if not self.options.iterations:
            raise SceneError("by blocks, a method decides in steps: give --iterations a number above 0")
        return replace(plan_of_pruning(self.options), exposure="off", refine_poses="off")

    def refuse_drop(self):
        """Raises SceneError for a method that cannot hold an allowed drop."""
        if self.options.method not in methods_of_drop():
            raise SceneError(
                f"--max-drop by blocks is for {' and '.join(methods_of_drop())}, not for"
                f" '{self.options.method}': choose one of these, or give --target"
            )

    def dataset(self) -> Dataset:
        """Raises SceneError, FormatError."""
        found, options = dataset_of(self.options), self.options
        if not found.photos:
            raise SceneError(f"{options.data}: has no photographs, which the method '{options.method}' needs")
        check_training(found.train_indices)
        return hold_apart(found)

    def write(self, folder: Path):
        values = {name: getattr(self.options, name) for name in given(self.options)}
        write_bytes(folder / FILE, json.dumps(values, default=str).encode())

    @classmethod
    def read(cls, folder: Path) -> Request | None:
        """None if nothing was asked of a method. Raises FormatError."""
        path = folder / FILE
        if not path.exists():
            return None
        try:
            found = check_mapping(PruneOptions, json_object(path, 1 << 20), in_job=False)
            return cls(PruneOptions(**found | {"data": found["data"], "method": found["method"]}))
        except (OSError, KeyError, SceneError):
            raise FormatError(f"{path}: is missing or damaged; divide the scene again") from None

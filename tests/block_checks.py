"""A scene divided and ordered for a method that decides on photographs."""

from __future__ import annotations

from pathlib import Path

from svrgs_addon.prune.blocks.divided import Divided, divide
from svrgs_addon.prune.blocks.learning import prepare_around
from svrgs_addon.prune.blocks.merging import merge, reduce
from svrgs_addon.prune.blocks.scoring import score
from svrgs_addon.views.dataset import Dataset


def ready(splat: Path, data: Dataset, folder: Path, most: int) -> Divided:
    """Blocks of at most so many Gaussians, that can be decided on."""
    divided, views = divide(splat, folder, most), [data.cameras[index] for index in data.train_indices]
    score(divided, views, 0, 1)
    reduce(divided, views)
    for block in divided.blocks:
        merge(divided, block.number)
    prepare_around(divided)
    return divided

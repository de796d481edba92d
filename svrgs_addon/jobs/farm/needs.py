"""What a task needs of a worker, before it runs."""

from __future__ import annotations

import numpy as np

from ...files.registry import describe, size_on_disk
from ...prune.options import PruneOptions
from ...scene.camera import Camera
from ...scene.gaussians import SH_COEFFICIENTS
from ...system import memory
from ...views.dataset import load_dataset

PROGRAM = 500 << 20  # bytes of the program and its libraries
PLACED, SIDE = 64, 1024  # without photographs: cameras, and pixels of a side of their pictures, at most about


def memory_of(options: PruneOptions) -> int:
    """Bytes of memory that pruning with these options needs. Raises SplatError."""
    assert options.scene is not None
    facts = describe(options.scene)
    count, coefficients = facts["count"], SH_COEFFICIENTS[facts["sh_degree"]]
    if options.data:
        cameras = load_dataset(
            options.data, options.images or None, holdout=options.holdout, cameras_only=True
        ).cameras
    else:
        cameras = PLACED * [Camera(np.eye(4), np.diag([SIDE, SIDE, 1.0]), SIDE, SIDE)]
    tuned = memory.tuning(count, coefficients, cameras, int(options.image_memory * 1e9))
    merged = 0 if options.data and not options.quick else memory.decimating(count, coefficients, cameras)
    return PROGRAM + max(tuned, merged, memory.reading(size_on_disk(options.scene)))

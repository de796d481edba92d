"""Which pixels of a photograph count, found out in a child process, as the masks of a dataset say.

Child process: `python -m svrgs_addon.jobs.photo_mask`. It reads {folder, images, name, masks, out} as JSON
from stdin. It writes what counts to the file `out` if a mask hides something, and prints {} or {"error":
sentence}.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..system import subprocess_python
from ..system.exit_status import answer
from ..views.dataset import valid_of_photograph
from ..views.valid_pixels import MaskOptions


def read_in_child(folder: str, images: str, name: str, masks: Sequence[MaskOptions]) -> np.ndarray | None:
    """The pixels of the photograph of a view that count, (H, W) uint8 of 0 and 1; None: all. images: name of
    the image folder, "" for the default. masks: where to look for its mask; the first that is found counts.
    Raises SceneError."""
    with tempfile.TemporaryDirectory() as temp_dir:
        out = Path(temp_dir) / "valid.npy"
        ways = [asdict(one) | {"folder": str(one.folder or "")} for one in masks]
        request = {"folder": folder, "images": images, "name": name, "masks": ways, "out": str(out)}
        subprocess_python.ask([], "svrgs_addon.jobs.photo_mask", request)
        return np.load(out) if out.exists() else None


def _write_valid(request: dict) -> dict:
    for way in request["masks"]:
        options = MaskOptions(**way | {"folder": Path(way["folder"]) if way["folder"] else None})
        folder, images = Path(request["folder"]), request["images"] or None
        valid = valid_of_photograph(folder, images, options, request["name"])
        if valid is not None:
            np.save(request["out"], valid)
            break
    return {}


if __name__ == "__main__":
    sys.exit(answer(_write_valid))

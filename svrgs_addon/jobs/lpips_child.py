"""LPIPS of pictures in a child process, so that Blender neither waits for it nor needs its memory.

Child process: `python -m svrgs_addon.jobs.lpips_child`. It reads {pictures: file} as JSON from stdin, and
prints {"lpips": one of each picture} or {"error": sentence}.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..files.images import to_bytes, to_float
from ..render.metrics import load_lpips
from ..scene.camera import Camera
from ..system import memory, subprocess_python
from ..system.errors import SceneError
from ..system.exit_status import answer


def lpips_in_child(pictures: Sequence[np.ndarray], photograph: np.ndarray, folder: str) -> list[float]:
    """LPIPS of each picture against the photograph, all (H, W, 3) display sRGB in [0, 1], rounded to 8 bits.
    folder: for a file of them. Raises SceneError."""
    with tempfile.TemporaryDirectory(dir=folder) as temp_dir:
        path = Path(temp_dir) / "pictures.npz"
        np.savez(path, photograph=to_bytes(photograph), pictures=[to_bytes(picture) for picture in pictures])
        return subprocess_python.ask([], "svrgs_addon.jobs.lpips_child", {"pictures": str(path)})["lpips"]


def _measured(request: dict) -> dict:
    with np.load(request["pictures"]) as data:
        photograph, pictures = data["photograph"], data["pictures"]
    height, width = photograph.shape[:2]
    camera = Camera(np.eye(4), np.eye(3), width, height)
    memory.refuse_excess("measuring LPIPS", memory.perceiving([camera]))
    lpips, reason = load_lpips(None)
    if lpips is None:
        raise SceneError(reason)
    return {"lpips": [lpips(to_float(picture), to_float(photograph)) for picture in pictures]}


if __name__ == "__main__":
    sys.exit(answer(_measured))

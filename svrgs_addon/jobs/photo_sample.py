"""A few reduced photographs of a dataset with their cameras, for a quick look whether a splat belongs to
them.

Child process: `python -m svrgs_addon.jobs.photo_sample`. It reads {folder, images, out} as JSON from stdin,
writes the views to the file `out`, and prints {} or {"error": sentence}.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..render.metrics.explained import sample_views
from ..scene.camera import Camera
from ..system import subprocess_python
from ..system.exit_status import answer
from ..views.dataset import load_dataset

Views = list[tuple[Camera, np.ndarray]]


def read_in_child(folder: str, images: str) -> Views:
    """As metrics.explained.sample_views(), in a child process. images: name of the image folder, "" for the
    default. Raises SceneError."""
    with tempfile.TemporaryDirectory() as temp_dir:
        out = Path(temp_dir) / "views.npz"
        request = {"folder": folder, "images": images, "out": str(out)}
        subprocess_python.ask([], "svrgs_addon.jobs.photo_sample", request)
        with np.load(out) as data:
            poses = zip(data["viewmats"], data["Ks"], data["units"].tolist(), strict=True)
            photos = [data[f"photo{number}"] for number in range(len(data["Ks"]))]
            bits = [data.get(f"valid{number}") for number in range(len(data["Ks"]))]
            return [
                (Camera(pose, K, photo.shape[1], photo.shape[0], valid_bits=valid, unit=unit), photo)
                for (pose, K, unit), photo, valid in zip(poses, photos, bits, strict=True)
            ]


def _write_views(request: dict) -> dict:
    views = sample_views(load_dataset(request["folder"], request["images"] or None))
    arrays: dict[str, Any] = {"viewmats": [camera.viewmat for camera, _ in views]}
    arrays["Ks"], arrays["units"] = [camera.K for camera, _ in views], [camera.unit for camera, _ in views]
    for number, (camera, photo) in enumerate(views):
        arrays[f"photo{number}"] = photo
        if camera.valid_bits is not None:
            arrays[f"valid{number}"] = camera.valid_bits
    np.savez(request["out"], **arrays)
    return {}


if __name__ == "__main__":
    sys.exit(answer(_write_views))

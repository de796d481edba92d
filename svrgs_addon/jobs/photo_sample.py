"""A few reduced photographs of a dataset with their cameras, for a quick look whether a splat belongs to
them.

Child process: `python -m svrgs_addon.jobs.photo_sample`. It reads {folder, images, out} as JSON from stdin,
writes the views to the file `out`, and prints {} or {"error": sentence}.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

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
            poses = zip(data["viewmats"], data["Ks"], strict=True)
            photos = [data[f"photo{number}"] for number in range(len(data["Ks"]))]
            bits = [data.get(f"valid{number}") for number in range(len(data["Ks"]))]
            return [
                (Camera(pose, K, photo.shape[1], photo.shape[0], valid_bits=valid), photo)
                for (pose, K), photo, valid in zip(poses, photos, bits, strict=True)
            ]


def _write_views(request: dict) -> dict:
    views = sample_views(load_dataset(request["folder"], request["images"] or None))
    photos = {f"photo{number}": photo for number, (_, photo) in enumerate(views)}
    photos |= {
        f"valid{k}": camera.valid_bits for k, (camera, _) in enumerate(views) if camera.valid_bits is not None
    }
    np.savez(
        request["out"],
        viewmats=[camera.viewmat for camera, _ in views],
        Ks=[camera.K for camera, _ in views],
        **photos,
    )
    return {}


if __name__ == "__main__":
    sys.exit(answer(_write_views))

"""transforms.json of given views, as Nerfstudio writes it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from svrgs_addon.views.sparse_model import Model

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
KEYS = {
    "PINHOLE": ("fl_x", "fl_y", "cx", "cy"),
    "OPENCV": ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4"),
}


def transforms_of(model: Model, images: str = "images") -> dict:
    """The contents for the views of a model, in reverse order, each with its own intrinsics."""
    frames = []
    for view in reversed(model.views):
        camera = view.camera
        intrinsics = dict(zip(KEYS[camera.model], map(float, camera.params), strict=True))
        pose = np.linalg.inv(view.viewmat) @ FLIP
        size = {"w": camera.width, "h": camera.height, "camera_model": camera.model}
        frames.append(
            {"file_path": f"./{images}/{view.name}", "transform_matrix": pose.tolist(), **size, **intrinsics}
        )
    return {"frames": frames}


def write_transforms(folder: Path, model: Model) -> dict:
    """Writes transforms.json and the sparse points beside it; returns the contents."""
    write_points(folder / "sparse_pc.ply", model.points, model.point_colors)
    facts = {**transforms_of(model), "ply_file_path": "sparse_pc.ply"}
    (folder / "transforms.json").write_text(json.dumps(facts))
    return facts


def write_points(path: Path, points: np.ndarray, colors: np.ndarray):
    """An ASCII point cloud, as `ns-process-data` writes it."""
    header = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(points)}",
        *(f"property float {name}" for name in "xyz"),
    ]
    header += [f"property uint8 {name}" for name in ("red", "green", "blue")]
    rows = [
        f"{x:.9g} {y:.9g} {z:.9g} {r} {g} {b}" for (x, y, z), (r, g, b) in zip(points, colors, strict=True)
    ]
    path.write_text("\n".join([*header, "end_header", *rows, ""]))

"""`svrgs render`: one file per view and output, VIEW.OUTPUT.EXT."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..files.atomic import check_writable, write_array
from ..files.images import to_bytes, write_image
from ..native.outputs import OUTPUTS, PICTURES
from ..prune.blocks.block_rasterizer import opened
from ..prune.report.pictures import mask_to_rgb
from ..render.metrics.evaluate import picture_options
from ..scene.camera import Camera, in_their_unit, refuse_same_stems, view_stem
from ..system import memory
from ..system.errors import SceneError
from ..views.camera_files import load_cameras
from ..views.dataset import HOLDOUT, load_dataset

MAX_DIGITS = 20  # of the number of a view; Python refuses to read thousands of digits


def render_views(args: argparse.Namespace) -> list[Path]:
    """Renders args.outputs of args.views and returns the files. All masks are 1, and F counts every hit
    of a ray. Raises SplatError."""
    outputs = _outputs(args.outputs)
    check_writable(args.out / "view.png")
    cameras = cameras_of(args)
    chosen = choose(cameras, args.views)
    refuse_same_stems(chosen, "render them one at a time, into separate folders")
    needed = lambda count: memory_of(count, chosen)
    with opened(args.scene, "rendering", needed) as (scene, rasterizer):
        settings = picture_options(scene, args.background, "svr" if "mask" in outputs else "none")
        if args.cameras:  # a file may not say how large its world is
            chosen = choose(in_their_unit(cameras, scene.means), args.views)
        saved = []
        for camera in chosen:
            images = rasterizer.forward(scene, camera, settings, outputs=outputs)
            saved += [_save(args.out, camera, name, images[name], args.format) for name in outputs]
        return saved


def _outputs(text: str) -> tuple[str, ...]:
    names = tuple(part.strip() for part in text.split(","))
    unknown = [name for name in names if name not in PICTURES]
    if unknown:
        raise SceneError(f"output '{unknown[0]}' is unknown; choose from {', '.join(PICTURES)}")
    return names


def cameras_of(args: argparse.Namespace) -> list[Camera]:
    """Those of --cameras, or of the dataset. Raises SceneError, FormatError."""
    if args.cameras:
        return load_cameras(args.cameras)
    return load_dataset(args.data, cameras_only=True).cameras


def refuse_both_views(args: argparse.Namespace):
    """Raises SceneError if a dataset and a file of cameras are both given."""
    if args.data and args.cameras:
        raise SceneError("--data and --cameras both name views; leave one out")


def memory_of(count: int, cameras: Sequence[Camera]) -> int:
    """Bytes of memory needed to render so many Gaussians in the largest of the views."""
    largest = max(cameras, key=lambda camera: camera.width * camera.height)
    return memory.rendering(count, largest.width, largest.height)


def choose(cameras: list[Camera], views: str) -> list[Camera]:
    """The cameras that `views` names: 'all', 'test' (every 8th), 'train', or a list of image names, with or
    without suffix, and numbers from 0, with commas between. Raises SceneError if there is no such view."""
    if not cameras:
        raise SceneError("there are no cameras to render from")
    if views in ("all", "test", "train"):
        chosen = [
            c for i, c in enumerate(cameras) if views == "all" or (i % HOLDOUT == 0) == (views == "test")
        ]
        if not chosen:
            raise SceneError(f"there are no {views} views among the {len(cameras)} views")
        return chosen
    by_name = {key: camera for camera in cameras for key in (view_stem(camera.name), camera.name)}
    chosen = []
    for part in views.split(","):
        if part in by_name:
            chosen.append(by_name[part])
        elif part.isdecimal() and len(part) < MAX_DIGITS and int(part) < len(cameras):
            chosen.append(cameras[int(part)])
        else:
            shown = part if len(part) < 60 else f"{part[:60]}..."
            raise SceneError(
                f"there is no view '{shown}'; views have names such as '{cameras[0].name}' and numbers 0 to"
                f" {len(cameras) - 1}"
            )
    return chosen


def _save(folder: Path, camera: Camera, output: str, image: np.ndarray, extension: str) -> Path:
    path = folder / f"{view_stem(camera.name)}.{output}.{extension}"
    if extension == "npy":
        write_array(path, image)
    else:
        write_image(path, image if extension == "exr" else _as_picture(output, image))
    return path


def _as_picture(output: str, image: np.ndarray) -> np.ndarray:
    """An output as an 8-bit picture, shown as outputs.py defines."""
    if OUTPUTS[output].shown == "mask_map":
        return mask_to_rgb(image)
    if OUTPUTS[output].shown == "farthest":
        return to_bytes(image / max(float(image.max()), 1e-12))
    return to_bytes(image)

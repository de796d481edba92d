"""`svrgs select`: counts the Gaussians that fulfil the criteria, and writes them as a splat file."""

from __future__ import annotations

import argparse
import logging

from .. import memory
from ..camera import Camera
from ..errors import SceneError
from ..files.atomic import check_writable
from ..files.registry import format_to_write, read_scene, refuse_input, write_scene
from ..files.repair import unusable
from ..photographs.camera_files import load_cameras
from ..photographs.dataset import load_dataset
from ..scene import Scene
from ..selection.options import OF_VIEWS, SelectOptions
from ..selection.select import selected
from .arguments import options_from
from .render_views import choose


def select_gaussians(words: argparse.Namespace) -> dict:
    """Selects, and writes options.out if it is given: rows and columns as they are in the file. Raises SplatError.

    Returns count (Gaussians of the file), selected, unusable (Gaussians that cannot be rendered: never selected and never written), and out.
    """
    options = options_from(SelectOptions, words)
    _refuse_outputs(words.scene, options)
    scene = read_scene(words.scene)
    bad = unusable(scene)
    if bad.any():
        logging.warning("%s: %d Gaussians with values that are not finite are not selected", words.scene, bad.sum())
    needs_views = any(name in OF_VIEWS for name in options.given())
    cameras = views_of(words, scene) if needs_views or options.colmap or options.cameras else []
    if cameras:
        largest = max(cameras, key=lambda camera: camera.width * camera.height)
        memory.refuse_excess(f"{words.scene}: rendering it", memory.rendering(scene.count, largest.width, largest.height))
    mask = selected(scene, options, lambda named: choose(cameras, named) if named else cameras)
    if options.invert:
        mask = ~mask & ~bad
    result = {"count": scene.count, "selected": int(mask.sum()), "unusable": int(bad.sum()), "out": options.out and str(options.out)}
    if options.out:
        if not mask.any():
            raise SceneError(f"{words.scene}: no Gaussian fulfils the criteria, so no file was written; leave out --out to see counts only")
        write_scene(options.out, scene.select(mask))
    return result


def views_of(words: argparse.Namespace, scene: Scene) -> list[Camera]:
    """The views that criteria are measured in: those of --colmap or --cameras. Raises SceneError if neither is given."""
    if words.cameras:
        return load_cameras(words.cameras)
    if words.colmap:
        return load_dataset(words.colmap, cameras_only=True).cameras
    raise SceneError("contribution, removal error and seen-by are measured in views; name them with --colmap or --cameras")


def as_text(result: dict) -> str:
    text = f"{result['selected']:,} of {result['count']:,} Gaussians selected"
    return f"{text}; saved {result['out']}" if result["out"] else text


def _refuse_outputs(scene, options: SelectOptions) -> None:
    """Raises SceneError for two sources of views, and for an output that cannot be written or is the input."""
    if options.colmap and options.cameras:
        raise SceneError("--colmap and --cameras both name views; leave one out")
    if options.out is None:
        return
    refuse_input(options.out, scene)
    format_to_write(options.out)
    check_writable(options.out)

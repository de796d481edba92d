"""`svrgs rig`: places cameras for a splat that has no photographs, and writes them as a cameras.json."""

from __future__ import annotations

import argparse
import logging
import re
from pathlib import Path

from ..files.atomic import check_writable
from ..files.images import write_image
from ..files.registry import load_scene, refuse_input
from ..prune.blocks.sample import MAX_SAMPLED, sample_of
from ..scene.gaussians import Scene
from ..system import memory
from ..system.errors import FormatError, MemoryShort, SceneError, TooMany
from ..system.file_names import real
from ..views.camera_files import load_cameras
from ..views.cameras_json import write_cameras_json
from ..views.rig import place_rig

PLACED = re.compile(r"(rig|off)_\d+")  # names of placed cameras


def place_cameras(args: argparse.Namespace) -> dict:
    """Places the cameras that `svrgs prune` uses without photographs. Returns their facts and the files.
    Raises SplatError."""
    for out in (args.out, args.preview):
        if out is not None:
            refuse_input(out, args.scene)
            check_writable(out)
    refuse_other_cameras(args.out)
    if args.preview is not None and real(args.preview) == real(args.out):
        raise SceneError(f"{args.out}: is to be both the cameras and the preview; give two names")
    if args.preview is not None and args.preview.suffix.lower() != ".png":
        raise SceneError(f"{args.preview}: the preview is a PNG; give it the suffix .png")
    scene, enlarged = _scene(args.scene)
    rig = place_rig(scene, views=args.views, seed=args.seed, enlarged=enlarged)
    write_cameras_json(args.out, [*rig.cameras, *rig.held_out])
    if args.preview is not None:
        from ..views.rig.preview import preview

        write_image(args.preview, preview(scene, rig))
    return {**rig.facts(), "out": str(args.out), "preview": args.preview and str(args.preview)}


def refuse_other_cameras(out: Path):
    """Raises SceneError for a file that is there and holds no cameras that were placed, as those of a 3DGS
    run or a dataset."""
    if not out.exists() or not out.stat().st_size:
        return
    try:
        placed = all(PLACED.fullmatch(camera.name) for camera in load_cameras(out))
    except (FormatError, SceneError):
        placed = False
    if not placed:
        raise SceneError(f"{out}: holds no cameras that svrgs rig has placed: name a new file")


def _scene(path: Path) -> tuple[Scene, float]:
    """The scene, or some of its Gaussians if it is too large; and how much wider they are than those of the
    scene. Raises SplatError."""
    try:
        scene = load_scene(path)
        memory.refuse_excess(f"{path}: rendering it", memory.rendering(scene.count, 1024, 1024))
        return scene, 1.0
    except (MemoryShort, TooMany) as error:
        logging.warning(
            "%s; its cameras are placed by up to %s of its Gaussians",
            memory.without_advice(str(error)),
            f"{MAX_SAMPLED:,}",
        )
    return sample_of(path)


def as_text(result: dict) -> str:
    where = "within the scene" if result["inside_out"] else "around the scene"
    lines = [
        f"{result['views']} cameras {where}, and {result['held_out']} others for testing,"
        f" {result['width']} x {result['height']} pixels",
        f"at least three of them show {result['seen']:.2%} of what can be seen",
        *(f"saved {result[name]}" for name in ("out", "preview") if result[name]),
    ]
    return "\n".join(lines)

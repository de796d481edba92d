"""`svrgs select`: counts the Gaussians that fulfil the criteria, and writes them as a splat file."""

from __future__ import annotations

import argparse
import collections
import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..files.memory_mapped import mapped_scene
from ..files.registry import format_to_write, read_parts, read_scene, write_scene
from ..files.repair import bake_filter, unusable
from ..prune.belonging import Seen, check_seen, seen_of
from ..prune.door import outputs
from ..prune.selection.measure import measured, summary
from ..prune.selection.options import OF_ONE, OF_VIEWS, RANKING, SelectOptions
from ..prune.selection.select import selected, usable_part
from ..scene.camera import Camera
from ..scene.gaussians import Scene
from ..system import memory
from ..system.errors import SceneError
from .option_parser import options_from
from .render_views import cameras_of, choose, memory_of, refuse_both_views

MEASURED = (
    "the tenth of the Gaussians that are needed most has {share_of_tenth:.0%} of the removal error;"
    " a Gaussian is decided by {deciding_views:.0f} views (median)\n"
    "nine of ten ranks move by at most {rank_spread_views:.1%} by the views, {rank_spread_size:.1%} by the"
    " size of the pictures, {rank_spread_precision:.1%} by the precision"
)


def select_gaussians(args: argparse.Namespace) -> dict:
    """Selects, and writes options.out if it is given: rows and columns as they are in the file. Raises
    SplatError.

    Returns count (Gaussians of the file), selected, unusable (Gaussians that cannot be rendered: never
    selected and never written), and out; where views rank Gaussians, seen and seen_views
    (prune/belonging.py), and notes; with --measure, measured: the summary of prune/selection/measure.py.
    """
    options = options_from(SelectOptions, args)
    refuse_both_views(args)
    if options.invert and not options.given():
        raise SceneError("--invert needs a criterion; choose at least one, such as an opacity or a box")
    if options.measure and options.out and "attributes" not in format_to_write(options.out).carries:
        raise SceneError(f"{options.out}: --measure writes columns, which only a PLY holds; name a .ply file")
    with outputs(args.scene, [options.out] if options.out else []):
        return _select(args, options)


def _select(args: argparse.Namespace, options: SelectOptions) -> dict:
    needs_views = options.measure or any(name in OF_VIEWS for name in options.given())
    has_views = bool(options.data or options.cameras)
    if needs_views and not has_views:
        raise SceneError(
            "contribution, removal error, seen-by and --measure need views; name them with --data or"
            " --cameras"
        )
    cameras = cameras_of(args) if has_views else []
    result = {"count": 0, "selected": 0, "unusable": 0, "out": options.out and str(options.out)}
    some = _selected(args.scene, _parts(args.scene, options, cameras), options, cameras, result)
    if options.out:
        if "attributes" not in format_to_write(options.out).carries:
            some = (bake_filter(part)[0] for part in some)  # the format cannot hold its column
        with mapped_scene(some, options.out) as scene:
            if not scene.count:
                raise SceneError(
                    f"{args.scene}: no Gaussian fulfils the criteria, so no file was written; leave out"
                    " --out to see counts only"
                )
            write_scene(options.out, scene)
    else:
        collections.deque(some, maxlen=0)
    if result["unusable"]:
        logging.warning(
            "%s: %d Gaussians with values that are not finite are not selected",
            args.scene,
            result["unusable"],
        )
    return result


def _parts(path: Path, options: SelectOptions, cameras: list[Camera]) -> Iterator[Scene]:
    """The scene as stored: in parts if each Gaussian is judged by itself, else as a whole."""
    if not options.measure and all(name in OF_ONE for name in options.given()):
        yield from read_parts(path)
        return
    scene = read_scene(path)
    if cameras:
        memory.refuse_excess(f"{path}: rendering it", memory_of(scene.count, cameras))
    yield scene


def _selected(
    path: Path, parts: Iterator[Scene], options: SelectOptions, cameras: list[Camera], result: dict
) -> Iterator[Scene]:
    """The selected Gaussians of each part. Adds to the counts of the result. Raises SceneError if views that
    rank them see too few."""
    ranking = options.measure or any(name in RANKING for name in options.given())
    for part in parts:
        bad = unusable(part)
        if ranking:
            seen = seen_of(part.select(~bad), cameras)
            result["notes"] = check_seen(seen, str(path), options.force)
            result |= seen.facts()
        if options.measure:
            part, result["measured"] = _measured(part, cameras)
        mask = ~bad
        if options.given() or not options.measure:
            mask = selected(part, options, lambda named: choose(cameras, named) if named else cameras)
        if options.invert:
            mask = ~mask & ~bad
        result["count"] += part.count
        result["unusable"] += int(bad.sum())
        result["selected"] += int(mask.sum())
        yield part.select(mask) if options.out else part


def _measured(scene: Scene, cameras: list[Camera]) -> tuple[Scene, dict]:
    """The scene with the columns of prune/selection/measure.py, 0 for Gaussians that cannot be rendered; and
    their summary."""
    mask, usable = usable_part(scene)
    if not usable.count:
        raise SceneError("no Gaussian can be rendered, so none can be measured")
    memory.refuse_excess("measuring the Gaussians", memory.ranking(usable.count, usable.sh.shape[1]))
    found = measured(usable, cameras)
    columns = {name: np.zeros(scene.count, values.dtype) for name, values in found.items()}
    for name, values in found.items():
        columns[name][mask] = values
    return replace(scene, attributes=scene.attributes | columns), summary(found)


def as_text(result: dict) -> str:
    text = f"{result['selected']:,} of {result['count']:,} Gaussians selected"
    saved = f"; saved {result['out']}" if result["out"] else ""
    seen = Seen(result["seen"], result["seen_views"]).sentence() if "seen" in result else ""
    needed = MEASURED.format(**result["measured"]) if "measured" in result else ""
    return "\n".join(filter(None, [text + saved, seen, needed, *result.get("notes", ())]))

"""`svrgs view`: one scene, or the original and the pruned one, in the browser, or as a web page."""

from __future__ import annotations

import argparse
import itertools
import json
import logging
import threading
import webbrowser

from ..files.atomic import check_writable
from ..files.registry import check_readable, format_to_read, load_scene, refuse_input
from ..prune.belonging import check_explained
from ..prune.options import DatasetOptions
from ..prune.plans import dataset_of
from ..render.metrics.evaluate import refuse_unseen
from ..scene.camera import in_their_unit
from ..scene.gaussians import Scene
from ..system import memory, packages
from ..system.errors import SceneError
from ..viewer.server import LARGEST, Viewer
from ..viewer.source import Source
from ..viewer.web_page import NAMES, export, program_bytes
from ..views.camera_files import load_cameras
from .option_parser import options_from
from .render_views import refuse_both_views

LAST_PORT = 65_000  # others are left for those that are taken


def view_scenes(args: argparse.Namespace):
    """Shows the scenes until Ctrl-C, or writes their page. Raises SplatError, as for views that are of
    another scene."""
    if args.export:
        return export_page(args)
    packages.load("viser", "svrgs view")  # before anything is read
    viewer = Viewer(source_of(args), args.port)
    try:
        facts = {"url": viewer.url, "scenes": [str(path) for path in args.scenes]}
        text = f"{viewer.url} shows {' and '.join(viewer.source.names)}; Ctrl-C ends it"
        print(json.dumps(facts) if args.json else text, flush=True)
        if not args.no_browser:
            webbrowser.open(viewer.url)
        threading.Event().wait()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.close()


def export_page(args: argparse.Namespace):
    """Writes the page into a folder, and prints its files, their sizes and figures. Raises SplatError."""
    if args.nested:
        raise SceneError("a page has no slider for a nested result: leave --nested out")
    check_writable(args.export / "index.html")  # before anything is read
    for name in itertools.chain(*NAMES.values()):
        for scene in args.scenes:
            refuse_input(args.export / name, scene)
    scenes, program = export(source_of(args), args.export), program_bytes()
    for one in scenes:
        for sentence in one["limits"]:
            logging.warning("%s: %s", one["name"], sentence)
    if args.json:
        print(json.dumps({"folder": str(args.export), "program_bytes": program, "scenes": scenes}))
        return
    held = " and ".join(f"{one['file']} ({one['bytes'] / 1e6:.2f} MB)" for one in scenes)
    print(
        f"{args.export} holds {held}, and a program of {program / 1e6:.1f} MB. Any web server shows it, such"
        f" as: python -m http.server --directory {args.export}"
    )


def source_of(args: argparse.Namespace) -> Source:
    """What the arguments name, read and checked. Raises SplatError."""
    refuse_both_views(args)
    if len(args.scenes) > 2:
        raise SceneError("at most two scenes are shown: the original and the pruned one")
    if args.port > LAST_PORT:
        raise SceneError(f"--port is at most {LAST_PORT}")
    if args.nested and "order" not in format_to_read(args.scenes[-1]).carries:
        raise SceneError(
            f"{args.scenes[-1]}: this format has an order of its own, so it holds no nested result; name its"
            " PLY"
        )
    for path in args.scenes:
        check_readable(path)
    dataset = dataset_of(options_from(DatasetOptions, args, image_memory=0.0)) if args.data else None
    cameras = dataset.cameras if dataset else load_cameras(args.cameras) if args.cameras else []
    scenes = list[Scene]()
    for path in args.scenes:
        scene = load_scene(path)
        memory.refuse_excess(f"{path}: showing it", memory.rendering(scene.count, LARGEST, LARGEST))
        if args.cameras and not scenes:
            cameras = in_their_unit(cameras, scene.means)
        if cameras:
            refuse_unseen(scene, cameras, str(path))
        for note in check_explained(scene, dataset, str(path), args.force) if dataset else ():
            logging.warning("%s", note)
        scenes.append(scene)
    names = tuple(path.name for path in args.scenes)
    return Source(names, tuple(scenes), cameras, dataset, args.nested, args.background)

"""The page of `svrgs view --export`: a folder that any web server shows, without this program.

The splats are SPZ files of version 3, which Spark reads and draws with three.js. Their modules are packed, as
a server without compression would send 5.8 MB; the page unpacks them.
"""

from __future__ import annotations

import html
import itertools
import json
import math
import os
from dataclasses import replace
from pathlib import Path
from string import Template

from ..files import spz
from ..files.atomic import write_bytes
from ..files.registry import load_scene
from ..native.library import near_depth, thresholds
from ..native.rasterizer import Rasterizer
from ..prune.report.page import refuse_other_page
from ..prune.seen import seen_from
from ..render.metrics.evaluate import evaluate
from ..scene.camera import evenly
from ..system.errors import SceneError
from .source import Source, View

WEB = Path(__file__).parent / "web"
# tools/fetch_web_modules.py fetches them. Each imports only those before it
MODULES = (
    "rolldown-runtime-DAXXjFlN.js",
    "three.core-BZvQH57C.js",
    "three.module-D-5NvbkG.js",
    "spark.module-EtAkeOhY.js",
)
GENERATOR = '<meta name="generator" content="SVR-GS">'  # of the page
VERSION = 3  # of the SPZ: Spark does not read 4
MOST_CAMERAS = 100
NAMES = {1: ("scene.spz",), 2: ("original.spz", "pruned.spz")}  # of the files, by number of scenes
FILES = ("page.js", "LICENSES.txt")  # those beside


def packed_module(name: str) -> Path:
    return WEB / "modules" / f"{name}.bin"


def export(source: Source, folder: Path) -> list[dict]:
    """Writes the page into a folder, index.html last. Returns the facts of each scene: file, name, count,
    bytes, antialiased, limits (sentences on what an SPZ cannot hold of it), and with a dataset the figures
    of its test views, measured on what the file holds. Raises SceneError, as where the folder holds another
    page."""
    _check(folder)
    (folder / "modules").mkdir(parents=True, exist_ok=True)
    for name in MODULES:
        _copy(packed_module(name), folder / "modules" / f"{name}.bin")
    for name in FILES:
        _copy(WEB / name, folder / name)
    facts = [_written(source, k, folder) for k in range(len(source.scenes))]
    title = " and ".join(source.names)
    background = "#" + "".join(f"{round(255 * value):02x}" for value in source.background)
    page = json.dumps(_page(source, facts)).replace("<", "\\u003c")  # the text ends no element
    template = Template((WEB / "index.html").read_text(encoding="utf-8"))
    text = template.substitute(title=html.escape(title), background=background, page=page)
    write_bytes(folder / "index.html", text.encode())
    for name in {*itertools.chain(*NAMES.values())} - {one["file"] for one in facts}:
        (folder / name).unlink(missing_ok=True)  # of an older page in this folder
    return facts


def program_bytes() -> int:
    """Size of the page without its splats."""
    files = [*map(packed_module, MODULES), WEB / "page.js", WEB / "index.html"]
    return sum(file.stat().st_size for file in files)


def _check(folder: Path):
    if lacking := [name for name in MODULES if not packed_module(name).exists()]:
        raise SceneError(f"the modules of web pages are missing ({lacking[0]}): make wheels fetches them")
    page, names = folder / "index.html", (*FILES, *itertools.chain(*NAMES.values()))
    refuse_other_page(folder, GENERATOR)
    if page.exists():
        return
    if found := next((name for name in names if (folder / name).exists()), ""):
        raise SceneError(f"{folder / found} would be replaced: name a new folder")


def _copy(source: Path, target: Path):
    write_bytes(target, source.read_bytes())


def _written(source: Source, k: int, folder: Path) -> dict:
    """Writes a scene, rounded by the training views: figures are those of other ones. Returns its facts."""
    name, scene, dataset = source.names[k], source.scenes[k], source.dataset
    file = folder / NAMES[len(source.scenes)][k]
    cameras = dataset.training_cameras if dataset else source.cameras
    spz.write(file, replace(scene, attributes={}), VERSION, seen=seen_from(scene, cameras, file))
    facts = {"file": file.name, "name": name, "count": scene.count, "bytes": os.path.getsize(file)}
    facts |= {"antialiased": scene.antialiased, "limits": spz.limits(scene)}
    if dataset is not None and dataset.test_indices:
        found = evaluate(load_scene(file), dataset, dataset.test_indices, Rasterizer())
        facts |= {name: found[name] for name in ("psnr", "ssim", "flip")}
    return facts


def _page(source: Source, facts: list[dict]) -> dict:
    """What page.js shows."""
    chosen = evenly(source.cameras, MOST_CAMERAS)
    notes = ["Drag to turn, right button or Shift to move, wheel to zoom"]
    if source.dataset is not None and source.dataset.test_indices:
        notes = [f"Figures: mean of {len(source.dataset.test_indices)} test views", *notes]
    return {
        "modules": MODULES,
        "background": source.background,
        "blur": thresholds().blur,
        "near": near_depth(source.unit),
        "start": _facts(source.start()),
        "up": list(map(float, source.up())),
        "cameras": [{"name": camera.name} | _facts(source.view_of(camera)) for camera in chosen],
        "scenes": [one | {"text": _text(one)} for one in facts],
        "notes": notes,
        "compare": f"Compare with {facts[0]['name']} ({facts[0]['bytes'] / 1e6:.1f} MB)",
    }


def _facts(view: View) -> dict:
    """As JSON; the field of view in degrees."""
    places = {name: list(map(float, getattr(view, name))) for name in ("position", "target", "up")}
    return {"fov": math.degrees(view.fov)} | places


def _text(facts: dict) -> str:
    text = f"{facts['name']}: {facts['count']:,} Gaussians, {facts['bytes'] / 1e6:.2f} MB"
    if "psnr" in facts:
        text += f"; PSNR {facts['psnr']:.2f} dB, SSIM {facts['ssim']:.3f}, FLIP {facts['flip']:.3f}"
    return text

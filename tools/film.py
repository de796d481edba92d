"""The film of docs/blender.md, docs/pictures/flow.webp, from the sample alone: open, prune, look at fewer,
compare, export.

    blender --window-geometry 0 0 1280 1120 --enable-event-simulate -P tools/film.py -- . OUT
    img2webp OUT/film.txt

in a Blender with this extension, on a screen of that size, with ImageMagick's `import` (Debian: imagemagick,
webp). The film is OUT/flow.webp, its pictures are OUT/*.png.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "window"))

import bpy
import driver
from driver import OUT, click, until

PACKAGE = "bl_ext.user_default.svrgs"
LEFT, SAMPLE, PRUNE = 842, 182, 193  # a button's column; rows below the header of their panel or step
CROPPED = ("-crop", "1050x990+0+22", "-resize", "720")
SECONDS = 1.2  # that a picture stays
frames: list[tuple[Path, float]] = []


def part(name: str):
    return importlib.import_module(f"{PACKAGE}.{name}")


def picture(seconds: float = SECONDS):
    """One more picture of the film."""
    path = OUT / f"film-{len(frames):03}.png"
    subprocess.run(["import", "-silent", "-window", "root", *CROPPED, str(path)], check=True)
    frames.append((path, seconds))


def steps():
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.object.delete()
    yield from driver.sidebar("SVR-GS")
    yield from driver.open_panel("Scene")
    picture()
    yield from click(LEFT, driver.header_height("Scene") + SAMPLE)
    yield from until(lambda: bpy.context.object is not None, "the sample")
    yield 2.0
    picture()
    yield from driver.open_panel("Prune")
    estimate = part("operators.jobs.estimate")
    yield from until(lambda: "kept" in estimate.of(bpy.context.object), "an estimate")
    yield 0.5
    picture()
    yield from click(LEFT, driver.header_height("Prune") + PRUNE)
    yield 1.0
    picture(0.6)
    yield from until(lambda: "pruned" in bpy.context.object.name, "the result", 90)
    yield 1.5
    picture()
    for share in (20, 15, 10, 7, 5, 10, 15, 20, 25):
        bpy.context.object.svrgs_share = share
        yield 1.0
        picture(0.4)
    bpy.context.window_manager.svrgs_steps.compare = True
    yield 0.7
    bpy.ops.svrgs.viewport_wipe()
    for wipe in (0.5, 0.4, 0.3, 0.2, 0.3, 0.4, 0.5, 0.6):
        bpy.context.scene.svrgs_view.wipe = wipe
        yield 1.0
        picture(0.3)
    bpy.ops.svrgs.viewport_wipe()
    bpy.ops.svrgs.apply()
    yield 1.5
    picture(2.0)
    words = [word for path, seconds in frames for word in ("-d", f"{1000 * seconds:.0f}", str(path))]
    film = ["-loop", "0", "-lossy", "-q", "70", *words, "-o", str(OUT / "flow.webp")]
    (OUT / "film.txt").write_text("\n".join(film))


driver.run(steps())

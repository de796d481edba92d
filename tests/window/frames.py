"""Frame times of a Solid viewport while the view moves, with two sizes of splats. Writes them to
OUT/seen.json."""

from __future__ import annotations

import importlib
import json
import statistics
import sys
import time
from collections.abc import Generator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).parent))

import bpy
import driver
from driver import OUT, area, shot
from mathutils import Quaternion

from svrgs_bench import scenes

PACKAGE = "bl_ext.user_default.svrgs"
SIZES = (196_000, 1_500_000)  # Gaussians
WARM_UP, FRAMES = 12, 15  # frames until the number of quads has settled; frames that are measured


def part(name: str):
    return importlib.import_module(f"{PACKAGE}.{name}")


def add(count: int) -> bpy.types.Object:
    """A room of Gaussians, seen from inside."""
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    obj = part("operators.data.splat_object").object_from_scene(
        "room", scenes.room(count), bpy.context.scene.collection
    )
    view = area("VIEW_3D").spaces.active.region_3d
    view.view_perspective, view.view_distance, view.view_location = "PERSP", 6, (0, 0, 0)
    return obj


def frame(step: float) -> float:
    """Seconds to draw the window once, after the view was turned by `step` radians."""
    view = area("VIEW_3D").spaces.active.region_3d
    view.view_rotation = Quaternion((0, 0, 1), step) @ view.view_rotation
    area("VIEW_3D").tag_redraw()
    started = time.perf_counter()
    bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=1)
    return time.perf_counter() - started


def measured() -> Generator[float, None, dict[str, float]]:
    """Yields between frames; returns the first, the median and the largest time in seconds."""
    first = frame(0.01)
    for _ in range(WARM_UP):
        frame(0.01)
        yield 0.01
    times = []
    for _ in range(FRAMES):
        times.append(frame(0.01))
        yield 0.01
    return {"first": first, "median": statistics.median(times), "largest": max(times)}


def steps():
    seen: dict = {}
    (overlay,) = part("operators.view.overlay")._overlay
    for count in SIZES:
        room = add(count)
        yield 1.0
        room.hide_set(True)
        without = yield from measured()
        room.hide_set(False)
        yield 0.5
        seen[str(count)] = (yield from measured()) | {
            "without": without["median"],
            "levels": [view.level for view in overlay.views.values()],
        }
        shot(f"moving-{count}")
    (OUT / "seen.json").write_text(json.dumps(seen))


driver.run(steps())

"""Frames of a Solid viewport while the view turns, in a Blender with a window and this extension:

    blender --python benchmarks/viewport.py -- [GAUSSIANS ...]

It prints milliseconds for each number of Gaussians (default: 200,000, 1 and 3 million; rooms of svrgs_bench,
seen from inside): of the window without splats, with this extension, and, up to a million, with Blender's own
points; and quits. A figure is the median of FRAMES.
"""

from __future__ import annotations

import importlib
import os
import statistics
import sys
import time
from collections.abc import Generator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bpy
import gpu
from mathutils import Quaternion

from svrgs_bench import scenes

COUNTS = (200_000, 1_000_000, 3_000_000)
WARM_UP, FRAMES = 15, 20  # frames until the number of pixels has settled; frames that are measured
TURN = 0.01  # radians from frame to frame
MOST_POINTS = 1_000_000  # Gaussians that Blender itself draws


def part(name: str):
    """A module of the extension."""
    package = next(m for m in sys.modules if m.startswith("bl_ext.") and m.endswith(".svrgs"))
    return importlib.import_module(f"{package}.{name}")


def view3d() -> bpy.types.Area:
    window = bpy.context.window_manager.windows[0]
    return next(area for area in window.screen.areas if area.type == "VIEW_3D")


def add(count: int) -> bpy.types.Object:
    """A room of Gaussians, seen from inside; all other objects are removed."""
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    obj = part("operators.data.splat_object").object_from_scene(
        "room", scenes.room(count), bpy.context.scene.collection
    )
    view = view3d().spaces.active.region_3d
    view.view_perspective, view.view_distance, view.view_location = "PERSP", 6, (0, 0, 0)
    return obj


def frame() -> float:
    """Seconds to draw the window once, after the view was turned."""
    view = view3d().spaces.active.region_3d
    view.view_rotation = Quaternion((0, 0, 1), TURN) @ view.view_rotation
    view3d().tag_redraw()
    started = time.perf_counter()
    bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=1)
    return time.perf_counter() - started


def measured() -> Generator[float, None, dict[str, float]]:
    """Yields between frames; returns the first, the median and the largest time in seconds."""
    first = frame()
    for _ in range(WARM_UP):
        frame()
        yield 0.01
    times = []
    for _ in range(FRAMES):
        times.append(frame())
        yield 0.01
    return {"first": first, "median": statistics.median(times), "largest": max(times)}


def measure(count: int) -> Generator[float, None, dict]:
    """The times with that many Gaussians, those `without` any, and `reductions`: sides of the blocks of
    pixels that share one."""
    (overlay,) = part("operators.view.overlay")._overlay
    room = add(count)
    room.hide_set(True)
    yield 1.0
    without = yield from measured()
    room.hide_set(False)
    yield 2.0
    seen = yield from measured()
    reductions = [view.reduction for view in overlay.views.values()]
    return seen | {"without": without["median"], "reductions": reductions}


def points() -> Generator[float, None, float]:
    """Seconds of a frame with Blender's own points."""
    bpy.context.scene.svrgs_view.overlay = False
    yield 1.0
    times = [frame() for _ in range(3)]
    bpy.context.scene.svrgs_view.overlay = True
    return statistics.median(times)


def report(counts: list[int]) -> Generator[float, None, None]:
    region = next(region for region in view3d().regions if region.type == "WINDOW")
    threads = part("svrgs_addon.native.library").threads()
    print(
        f"Blender {bpy.app.version_string}, {gpu.platform.renderer_get()}, {threads} threads,"
        f" {region.width}×{region.height}"
    )
    for count in counts:
        seen = yield from measure(count)
        own = (yield from points()) if count <= MOST_POINTS else None
        blender = "" if own is None else f"; Blender's own points {1e3 * own:.0f} ms"
        print(
            f"{count:,} Gaussians: {1e3 * seen['median']:.0f} ms a frame, blocks of"
            f" {seen['reductions'][0]} pixels; without {1e3 * seen['without']:.0f} ms{blender}",
            flush=True,
        )


def main():
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    steps = report([int(word) for word in words] or list(COUNTS))

    def tick() -> float | None:
        wait = next(steps, None)
        if wait is None:
            os._exit(0)  # without a question about unsaved changes
        return wait

    bpy.app.timers.register(tick, first_interval=2.0)


if __name__ == "__main__":
    main()

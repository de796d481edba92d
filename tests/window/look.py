"""Look at a splat in every way there is: overlay, Rendered viewport, spatial mask, comparison, F12. Writes what it saw to OUT/seen.json."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
import driver
from driver import DATA, OUT, click, key, shot, until

PACKAGE = "bl_ext.user_default.svrgs"
VIEW = (400, 600)  # somewhere in the 3D view
MASK_HEADER, MASK_REFRESH = (900, 700), (880, 730)
COMPARE, WIPE = (842, 600), (850, 800)


def part(name: str):
    return importlib.import_module(f"{PACKAGE}.{name}")


def area(kind: str) -> bpy.types.Area:
    return next(area for area in driver.window().screen.areas if area.type == kind)


def rest(views, seconds: float = 60):
    """Until what viewports show is exact. views() -> [LiveView]"""
    yield 0.5
    yield from until(lambda: views() and all(view.picture() is not None and not view.busy for view in views()), "an exact picture", seconds)
    yield 0.8


def steps():
    overlay, viewport = part("operators.overlay"), part("operators.viewport")
    seen, scene, looking = {}, bpy.context.scene, bpy.context.scene.svrgs_looking
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.object.delete()
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "scene.ply"))
    splat = bpy.context.object
    bpy.ops.svrgs.import_colmap(directory=str(DATA))
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = splat
    for obj in bpy.data.objects:
        if obj.type == "CAMERA":
            obj.data.show_background_images = False
    space = area("VIEW_3D").spaces.active
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_extras = space.overlay.show_relationship_lines = False
    yield from driver.sidebar("SVR-GS")
    yield from rest(lambda: [view.live for view in overlay._overlay[0].views.values()])
    shot("overlay")

    scene.render.engine, scene.view_settings.view_transform = "SVRGS", "Standard"
    space.shading.type = "RENDERED"
    yield from rest(lambda: [view.live for view in viewport._open])
    shot("rendered")
    (OUT / "seen.json").write_text(json.dumps(seen))


driver.run(steps())

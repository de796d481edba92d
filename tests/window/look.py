"""Look at a splat in every way there is: overlay (along parallel rays, too), Rendered viewport, spatial mask,
comparison, F12.

Writes what it saw to OUT/seen.json.
"""

from __future__ import annotations

import importlib
import itertools
import json
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
import driver
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from driver import DATA, OUT, area, click, drag, key, shot, until
from mathutils import Vector

PACKAGE = "bl_ext.user_default.svrgs"
VIEW = (400, 600)  # somewhere in the 3D view
# buttons: column, and distances below the header of their panel
LEFT, MASK_REFRESH, WIPE, COMPARE = 842, 31, 105, 126


def part(name: str):
    return importlib.import_module(f"{PACKAGE}.{name}")


def apart(space: bpy.types.SpaceView3D) -> float:
    """Pixels between where Blender and the extension show the corners of a small cube before the viewport."""
    region = next(region for region in area("VIEW_3D").regions if region.type == "WINDOW")
    camera = part("operators.data.visible_splats").region_camera(region, space.region_3d)
    centre = space.region_3d.view_matrix.inverted() @ Vector((0, 0, -3))
    corners = [centre + Vector(corner) for corner in itertools.product((-0.5, 0.5), repeat=3)]
    shown = [location_3d_to_region_2d(region, space.region_3d, corner) for corner in corners]
    pixels = camera.pixels(np.array(corners) @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3])
    return max(math.dist((x, region.height - y), pixel) for (x, y), pixel in zip(shown, pixels, strict=True))


def rest(views, seconds: float = 60):
    """Until what viewports show is exact. views() -> [LiveView]"""
    yield 0.5
    yield from until(
        lambda: views() and all(view.picture() is not None and not view.busy for view in views()),
        "an exact picture",
        seconds,
    )
    yield 0.8


def overlay_views() -> list:
    return [view.live for view in part("operators.view.overlay")._overlay.views.values()]


def load() -> bpy.types.SpaceView3D:
    """The splat and the cameras of its dataset, seen through a camera without anything else."""
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
    return space


def see_overlay(space: bpy.types.SpaceView3D, seen: dict):
    yield from rest(overlay_views)
    seen["region"] = next(
        [region.height, region.width] for region in area("VIEW_3D").regions if region.type == "WINDOW"
    )
    seen["overlay"] = [list(live.picture().result.shape[:2]) for live in overlay_views()]
    seen["apart"] = {"CAMERA": apart(space)}
    shot("overlay")


def see_without_overlays(space: bpy.types.SpaceView3D, seen: dict):
    """The splat stays where Blender's overlays are hidden."""
    space.overlay.show_overlays = False
    yield from until(
        lambda: [live for live in overlay_views() if live.picture() and live.picture().key[-1] is False],
        "a picture without overlays",
        60,
    )
    seen["without_overlays"] = [float(live.picture().result[..., 3].mean()) for live in overlay_views()]
    yield 0.5
    shot("without-overlays")
    space.overlay.show_overlays = True


def see_parallel_rays(space: bpy.types.SpaceView3D, seen: dict):
    space.region_3d.view_perspective = "ORTHO"
    # else as far away as Blender happens to have been
    space.region_3d.view_distance, space.region_3d.view_location = 8, (0, 0, 0)
    yield from rest(overlay_views)
    seen["parallel"] = [float(live.picture().result[..., 3].mean()) for live in overlay_views()]
    seen["apart"]["ORTHO"] = apart(space)
    shot("parallel")
    space.region_3d.view_perspective = "CAMERA"


def see_rendered_viewport(space: bpy.types.SpaceView3D, seen: dict):
    scene, viewport = bpy.context.scene, part("operators.view.viewport")
    scene.render.engine, scene.view_settings.view_transform = "SVRGS", "Standard"
    space.shading.type = "RENDERED"
    views = lambda: [pane.live for view in viewport._open for pane in view.panes.values()]
    yield from rest(views)
    seen["rendered"] = [list(live.picture().result[0].shape[:2]) for live in views()]
    shot("rendered")


def see_f12(seen: dict):
    bpy.context.preferences.view.render_display_type = "NONE"
    rendered = []
    bpy.app.handlers.render_complete.append(lambda *_: rendered.append(True))
    yield from key("F12", *VIEW)
    yield from until(lambda: rendered, "F12", 60)
    yield 0.3
    seen["camera"], seen["f12"] = bpy.context.scene.camera.name, str(OUT / "f12.png")
    bpy.data.images["Render Result"].save_render(seen["f12"])


def see_mask(seen: dict):
    figures = part("operators.view.spatial_mask").figures
    yield from driver.open_panel("Spatial Mask")
    yield from click(LEFT, driver.header_height("Spatial Mask") + MASK_REFRESH)
    yield from until(figures, "the spatial mask")
    yield 0.8
    seen["mask"] = figures()
    shot("mask")


def see_comparison(seen: dict):
    figures = part("operators.view.compare").figures
    bpy.ops.svrgs.prune(method="contribution", target=0.4, iterations=0, recovery=0)
    yield 0.8
    yield from driver.open_panel("Compare")
    yield from click(LEFT, driver.header_height("Compare") + COMPARE)
    yield from until(figures, "the comparison")
    yield 0.8
    seen["compare"] = figures()
    shot("compare")


def see_wipe(space: bpy.types.SpaceView3D, seen: dict):
    """Both sides, exact, in a Solid and in a Rendered viewport; the mouse moves the line."""
    looking, wipe = bpy.context.scene.svrgs_view, part("operators.view.viewport_wipe")
    viewport = part("operators.view.viewport")
    yield from click(LEFT, driver.header_height("Compare") + WIPE)
    yield from until(lambda: wipe.pair(bpy.context.scene), "the wipe")
    panes = lambda: [pane.live for view in viewport._open for pane in view.panes.values()]
    yield from until(lambda: len(panes()) == 2, "two sides")
    yield from rest(panes)
    shot("wipe-rendered")
    sides = [len(panes())]
    space.shading.type = "SOLID"
    yield from until(lambda: len(overlay_views()) == 2, "two sides")
    yield from rest(overlay_views)
    seen["wipe"] = [*(obj.name for obj in wipe.pair(bpy.context.scene)), *sides, len(overlay_views())]
    area_3d = area("VIEW_3D")
    region = next(region for region in area("VIEW_3D").regions if region.type == "WINDOW")
    x = area_3d.x + round(looking.wipe * region.width)
    yield from drag(x, VIEW[1], x - 200, VIEW[1])
    seen["moved"] = [looking.wipe * region.width + area_3d.x, x - 200]
    shot("wipe")
    yield from click(LEFT, driver.header_height("Compare") + WIPE)
    yield from until(lambda: wipe.pair(bpy.context.scene) is None, "the end of the wipe")
    yield from until(lambda: len(overlay_views()) == 1, "one side")
    bpy.ops.svrgs.open_image(name="SVR-GS Wipe")
    yield 0.5
    seen["opened"] = [
        space.image.name
        for window in bpy.context.window_manager.windows[1:]
        for space in [window.screen.areas[0].spaces.active]
    ]


def steps():
    seen, space = {}, load()
    yield from driver.sidebar("SVR-GS")
    for see in (see_overlay, see_without_overlays, see_parallel_rays, see_rendered_viewport):
        yield from see(space, seen)
    for see in (see_f12, see_mask, see_comparison):
        yield from see(seen)
    yield from see_wipe(space, seen)
    (OUT / "seen.json").write_text(json.dumps(seen))


driver.run(steps())

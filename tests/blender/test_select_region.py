"""Selecting Gaussians by a box, a lasso or a brush in the viewport."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from extension import DATA, part


@pytest.fixture
def view():
    """Runs the operator in the 3D viewport of the start-up file, with a path in shares of its size."""
    (area,) = (area for area in bpy.context.window.screen.areas if area.type == "VIEW_3D")
    (region,) = (region for region in area.regions if region.type == "WINDOW")

    def select(shape: str, points, **options) -> set:
        path = [{"name": "", "time": 0.0, "loc": (x * region.width, y * region.height)} for x, y in points]
        with bpy.context.temp_override(area=area, region=region):
            return bpy.ops.svrgs.select_region(shape=shape, path=path, **options)

    select.camera = lambda: part("operators.data.visible_splats").region_camera(
        region, area.spaces[0].region_3d
    )
    return select


@pytest.fixture
def splat():
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    settings = bpy.context.scene.svrgs_view
    settings.select_through, settings.select_radius = True, 40
    yield bpy.context.object
    settings.select_through = False


def selected(bridge, obj) -> np.ndarray:
    return bridge.values(obj, "svrgs:selected").astype(bool)


def places(bridge, obj, camera) -> np.ndarray:
    """Pixels of the centres, y up, in shares of the size."""
    matrix = np.array(obj.matrix_world)
    world = bridge.scene_from_object(obj).means @ matrix[:3, :3].T + matrix[:3, 3]
    x, y = camera.pixels(world @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]).T
    return np.stack([x / camera.width, 1 - y / camera.height], axis=1)


def test_a_box_selects_what_is_in_it_and_the_modes_combine(splat, bridge, view):
    camera = view.camera()
    x, y = places(bridge, splat, camera).T
    middle, level = float(np.median(x)), float(np.median(y))
    left, upper = (x > 0) & (x < middle), (y > level) & (y < 1)
    clear = (abs(x - middle) * camera.width > 1) & (abs(y - level) * camera.height > 1)
    assert 0 < left.sum() < len(x) and clear.sum() > 200
    assert view("BOX", [(middle, 1), (0, 0)]) == {"FINISHED"}
    np.testing.assert_array_equal(selected(bridge, splat)[clear], left[clear])
    view("BOX", [(0, level), (1, 1)], mode="EXTEND")
    np.testing.assert_array_equal(selected(bridge, splat)[clear], (left | upper)[clear])
    view("LASSO", [(0, 0), (middle, 0), (middle, 1), (0, 1)], mode="SUBTRACT")
    np.testing.assert_array_equal(selected(bridge, splat)[clear], (upper & ~left)[clear])
    assert bpy.context.scene.svrgs_view.overlay_shown == "svrgs:selected"


def test_a_brush_selects_along_its_path(splat, bridge, view):
    camera = view.camera()
    at = places(bridge, splat, camera)[17]
    view("BRUSH", [at])
    away = (places(bridge, splat, camera) - at) * (camera.width, camera.height)
    near = np.hypot(*away.T)
    found = selected(bridge, splat)
    assert found[17] and (found != (near <= 40))[abs(near - 40) > 1].sum() == 0


def test_what_others_hide_is_selected_only_through_them(splat, bridge, view):
    view("BOX", [(0, 0), (1, 1)])
    through = selected(bridge, splat)
    bpy.context.scene.svrgs_view.select_through = False
    view("BOX", [(0, 0), (1, 1)])
    shown = selected(bridge, splat)
    assert 0 < shown.sum() < through.sum() and not (shown & ~through).any()


def test_removed_gaussians_are_not_selected(splat, bridge, view):
    bridge.set_values(splat, "removed", "BOOLEAN", np.arange(250) % 2 == 0)
    view("BOX", [(0, 0), (1, 1)])
    assert not selected(bridge, splat)[::2].any() and selected(bridge, splat)[1::2].any()


def test_it_needs_a_viewport(splat):
    with pytest.raises(RuntimeError, match="in a 3D viewport"):
        bpy.ops.svrgs.select_region(shape="BOX")


def test_its_tools_are_in_the_toolbar():
    tools = part("operators.view.select_region").TOOLS
    from bl_ui.space_toolsystem_toolbar import VIEW3D_PT_tools_active

    names = {
        tool.idname
        for group in VIEW3D_PT_tools_active._tools["OBJECT"]
        for tool in (group if isinstance(group, tuple) else [group])
        if hasattr(tool, "idname")
    }
    assert {tool.bl_idname for tool in tools} <= names


def test_a_drag_begins_where_the_mouse_was_pressed_and_a_click_where_it_is():
    places = {
        "mouse_prev_press_x": 30, "mouse_prev_press_y": 50, "mouse_region_x": 90, "mouse_region_y": 80
    }  # fmt: skip
    assert places.keys() <= {*bpy.types.Event.bl_rna.properties.keys()}
    pressed_at, region = part("operators.view.select_region").pressed_at, SimpleNamespace(x=10, y=20)
    assert pressed_at(SimpleNamespace(value="CLICK_DRAG", **places), region) == (20, 30)
    assert pressed_at(SimpleNamespace(value="PRESS", **places), region) == (90, 80)

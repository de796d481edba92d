"""Wipe in Viewport: left of a line a 3D viewport shows the original, right of it the pruned splat, over its
whole size.

It works wherever the extension draws splats: in Solid and Material Preview viewports (overlay.py), and in
Rendered viewports of the engine SVR-GS (viewport.py). They ask sides() what to draw. The line is a gizmo,
which the mouse drags; its place is svrgs_view.wipe.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import blf
import bpy
import gpu
from bpy.app.translations import pgettext_iface as tr
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix

from ...svrgs_addon.scene.gaussians import Scene
from ..data.background_work import redraw_panels
from ..data.reporting import ReportingOperator
from . import compare, scene_cache

REACH = 8  # pixels from the line in which the mouse takes it
COLOR, HIGHLIGHT, SHADOW = (1.0, 1.0, 1.0, 0.8), (1.0, 0.6, 0.2, 1.0), (0.0, 0.0, 0.0, 0.6)

_pair: list[int] = []  # session_uids of the original and of the pruned splat while the wipe is on
_pruned: dict[tuple, Scene] = {}  # by key: the last pruned side


@dataclass(frozen=True)
class Shown:
    """A splat that a viewport shows."""

    uid: int  # session_uid of the object
    key: object  # changes when the Gaussians change
    scene: Scene
    matrix: Matrix  # to Blender's world
    values: Any = None  # (N,) values of an attribute that colours show; None: there is none


@dataclass(frozen=True)
class Side:
    """The splats that are drawn in some columns of a viewport."""

    name: str  # "" without a wipe
    columns: tuple[float, float]  # shares of the width
    shown: list[Shown]

    @property
    def key(self) -> tuple:
        return tuple((part.key, tuple(map(tuple, part.matrix))) for part in self.shown)


def shown(found: Iterable[tuple[bpy.types.Object, Matrix]], name: str = "") -> list[Shown]:
    """Evaluated splats with their matrices, as a viewport shows them. name: of an attribute that their
    colours show."""
    parts = []
    for obj, matrix in found:
        values = scene_cache.read_values(obj, name) if name else None
        parts.append(
            Shown(obj.original.session_uid, scene_cache.number(obj), scene_cache.read(obj), matrix, values)
        )
    return parts


def sides(scene: bpy.types.Scene, found: list[Shown]) -> list[Side]:
    """The sides of a viewport that shows these splats: one, or two while the wipe is on and the original or
    the pruned splat is among them."""
    chosen = pair(scene)
    place = next((part.matrix for part in found if chosen and part.uid in _pair), None)
    if chosen is None or place is None:
        return [Side("", (0.0, 1.0), found)]
    original, pruned = chosen
    number = scene_cache.number(original, whole=True)
    whole = Shown(_pair[0], ("whole", number), scene_cache.read(original, whole=True), place)
    key = tuple(scene_cache.number(obj, whole=True) for obj in chosen)
    if key not in _pruned:
        _pruned.clear()
        _pruned[key] = compare.shown_scene(pruned)
    others, wipe = [part for part in found if part.uid not in _pair], scene.svrgs_view.wipe
    return [
        Side("ORIGINAL", (0.0, wipe), [*others, whole]),
        Side("PRUNED", (wipe, 1.0), [*others, replace(whole, key=("pruned", key), scene=_pruned[key])]),
    ]


def pair(scene: bpy.types.Scene) -> tuple[bpy.types.Object, bpy.types.Object] | None:
    """(original, pruned) while the wipe is on and both are in the scene; else None."""
    there = {obj.session_uid: obj for obj in scene.objects} if _pair else {}
    return (there[_pair[0]], there[_pair[1]]) if _pair and all(uid in there for uid in _pair) else None


def draws_splats(context) -> bool:
    """Whether the extension draws the splats of this viewport."""
    shading = context.space_data.shading.type
    if shading == "RENDERED":
        return context.scene.render.engine == "SVRGS"
    return shading != "WIREFRAME" and context.scene.svrgs_view.overlay


def moved(settings, context):
    """After the line was moved. The images of a comparison follow when the wipe ends: writing them takes
    time."""
    if pair(settings.id_data) is None:
        compare.redraw(settings, context)
    redraw_panels()


class SVRGS_OT_viewport_wipe(ReportingOperator):
    bl_label = "Wipe in Viewport"
    bl_description = (
        "Show the original left of a line and the pruned splat right of it, in the whole 3D viewport. Drag"
        " the line; press again to end"
    )
    bl_options = {"REGISTER"}

    def work(self, context) -> str:
        if pair(context.scene) is not None:
            _pair.clear()
            _pruned.clear()
            moved(context.scene.svrgs_view, context)
            return ""
        _pair[:] = [obj.session_uid for obj in compare.chosen_pair(context)]
        if context.area is not None and context.area.type == "VIEW_3D" and not draws_splats(context):
            text = tr(
                "This viewport shows no splats: choose Solid or Material Preview, or Rendered with the"
                " engine SVR-GS"
            )
            self.report({"WARNING"}, text)
        redraw_panels()
        return ""


class SVRGS_GT_wipe(bpy.types.Gizmo):
    """The line."""

    bl_idname = "SVRGS_GT_wipe"

    def setup(self):
        self.use_draw_modal = True

    def draw(self, context):
        region, scale = context.region, context.preferences.system.ui_scale
        x, middle = round(context.scene.svrgs_view.wipe * region.width), region.height / 2
        color, half = HIGHLIGHT if self.is_highlight or self.is_modal else COLOR, 6 * scale
        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        gpu.state.blend_set("ALPHA")
        for width, tint in ((3, SHADOW), (1, color)):
            rectangle(shader, (x - width * scale / 2, 0, x + width * scale / 2, region.height), tint)
        rectangle(shader, (x - half, middle - 2 * half, x + half, middle + 2 * half), color)
        gpu.state.blend_set("NONE")
        blf.size(0, 12 * scale)
        blf.color(0, *COLOR)
        original, pruned = tr("Original"), tr("Pruned")
        before = x - half - blf.dimensions(0, original)[0] - 2
        for text, start in ((original, before), (pruned, x + half + 2)):
            blf.position(0, start, middle - half / 2, 0)
            blf.draw(0, text)

    def test_select(self, context, location):
        distance = abs(location[0] - context.scene.svrgs_view.wipe * context.region.width)
        return 0 if distance < REACH * context.preferences.system.ui_scale else -1

    def invoke(self, context, event):
        self.before = context.scene.svrgs_view.wipe
        return {"RUNNING_MODAL"}

    def modal(self, context, event, tweak):
        context.scene.svrgs_view.wipe = min(1.0, max(0.0, event.mouse_region_x / context.region.width))
        return {"RUNNING_MODAL"}

    def exit(self, context, cancel):
        if cancel:
            context.scene.svrgs_view.wipe = self.before


class SVRGS_GGT_wipe(bpy.types.GizmoGroup):
    bl_idname = "SVRGS_GGT_wipe"
    bl_label = "Wipe"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"PERSISTENT"}

    @classmethod
    def poll(cls, context):
        return pair(context.scene) is not None and draws_splats(context)

    def setup(self, context):
        self.gizmos.new(SVRGS_GT_wipe.bl_idname)


def rectangle(shader: gpu.types.GPUShader, bounds: tuple[float, ...], color: tuple[float, ...]):
    """Fills left, bottom, right, top in pixels."""
    left, bottom, right, top = bounds
    shader.bind()
    shader.uniform_float("color", color)
    corners = (left, bottom), (right, bottom), (right, top), (left, top)
    batch_for_shader(shader, "TRI_FAN", {"pos": corners}).draw(shader)


def forget(*_):
    _pair.clear()
    _pruned.clear()

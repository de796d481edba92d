"""Select Gaussians where one looks: tools of the 3D viewport that draw a box, a lasso or the stroke of a
round brush over the splat.

With a tool, a drag selects; with Shift it adds, with Ctrl it removes. B and C begin a box and a stroke at the
next press of the mouse, Ctrl and the right mouse button a lasso, as in Blender.
"""

from __future__ import annotations

import contextlib

import bpy
import gpu
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, CollectionProperty, EnumProperty
from gpu_extras.batch import batch_for_shader

from ...svrgs_addon.system.errors import SceneError, SplatError
from ..data import select_in_view, splat_object, visible_splats
from ..data.extension import use_threads
from ..scene.select_gaussians import SplatOperator, changed, mode_property
from . import scene_cache

SHAPES = [
    ("BOX", "Box", "Gaussians in a rectangle"),
    ("LASSO", "Lasso", "Gaussians inside a line that is drawn by hand"),
    ("BRUSH", "Brush", "Gaussians under the stroke of a round brush. The mouse wheel changes its size"),
]
COLOR, SHADOW, NEAREST = (1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 1.0), 2  # pixels between points of a path
LARGEST, STEP = 1000, 1.15  # radius of a brush in pixels; what a notch of the wheel makes of it
_drawn: list = []  # the operator that draws its outline now


class SVRGS_OT_select_region(SplatOperator):
    bl_label = "Select Gaussians in View"
    bl_description = (
        "Select Gaussians of the active splat by a box, a lasso or a brush in the viewport. Shift adds, Ctrl"
        " removes"
    )
    bl_options = {"REGISTER", "UNDO", "BLOCKING"}

    shape: EnumProperty(name="Shape", items=SHAPES, description="What is drawn over the splat")
    mode: mode_property()
    path: CollectionProperty(type=bpy.types.OperatorMousePath, options={"HIDDEN", "SKIP_SAVE"})
    wait: BoolProperty(options={"HIDDEN", "SKIP_SAVE"})  # begin at the next press of the mouse
    view = None  # of the viewport, which is rendered once the mouse has moved since it was pressed

    def work(self, context) -> str:
        settings, obj = context.scene.svrgs_view, context.object
        path = [tuple(point.loc) for point in self.path]
        outline = select_in_view.Outline(self.shape, path, settings.select_radius)
        scene, matrix, camera, rows = _seen(context)
        through = settings.select_through
        inside = select_in_view.gaussians_in(scene, matrix, camera, outline, through, self.view)
        mask = splat_object.mask_of(obj, rows[inside])
        return changed(context, obj, mask, self.mode)

    def invoke(self, context, event):
        if context.region_data is None:
            return self.execute(context)
        self.path.clear()
        self.button, self.region = "", context.region.as_pointer()
        self.mouse = pressed_at(event, context.region)
        if not self.wait:
            self.begin(event)
        _drawn[:] = [self]
        context.window_manager.modal_handler_add(self)
        context.region.tag_redraw()
        return {"RUNNING_MODAL"}

    def begin(self, event):
        """The mouse was pressed: its button draws until it is released. A tool's drag begins where it was
        pressed."""
        self.button = event.type if event.type in ("LEFTMOUSE", "RIGHTMOUSE") else "LEFTMOUSE"
        self.add(*self.mouse)

    def add(self, x: float, y: float):
        if self.shape == "BOX":
            while len(self.path) > 1:
                self.path.remove(1)
        self.path.add().loc = x, y

    def modal(self, context, event):
        settings = context.scene.svrgs_view
        self.mouse = x, y = event.mouse_region_x, event.mouse_region_y
        context.region.tag_redraw()
        if self.button and event.type == self.button and event.value == "RELEASE":
            return self.end(self.execute(context))
        if event.type == "ESC" or (event.type == "RIGHTMOUSE" and self.button != "RIGHTMOUSE"):
            return self.end({"CANCELLED"})
        if not self.button and event.type == "LEFTMOUSE" and event.value == "PRESS":
            if event.shift or event.ctrl:
                self.mode = "EXTEND" if event.shift else "SUBTRACT"
            self.begin(event)
        elif self.button and event.type in ("MOUSEMOVE", "INBETWEEN_MOUSEMOVE"):
            if self.view is None and not settings.select_through:  # not at a mere click, which is quick
                with contextlib.suppress(SplatError):  # work() says it
                    self.view = select_in_view.ViewportView(*_seen(context)[:3])
                    self.view.begin()
            last = self.path[-1].loc
            if self.shape == "BOX" or abs(x - last[0]) + abs(y - last[1]) >= NEAREST:
                self.add(x, y)
        elif self.shape == "BRUSH" and event.type in ("WHEELUPMOUSE", "WHEELDOWNMOUSE"):
            factor = STEP if event.type == "WHEELUPMOUSE" else 1 / STEP
            settings.select_radius = round(min(LARGEST, max(1, settings.select_radius * factor)))
        return {"RUNNING_MODAL"}

    def end(self, result: set) -> set:
        _drawn.clear()
        return result

    def cancel(self, context):
        _drawn.clear()


def pressed_at(event: bpy.types.Event, region: bpy.types.Region) -> tuple[int, int]:
    """Where an operator begins, in pixels of the region, y up: where the mouse is, but for a drag, whose
    event comes once the mouse has moved, where it was pressed."""
    if event.value == "CLICK_DRAG":
        return event.mouse_prev_press_x - region.x, event.mouse_prev_press_y - region.y
    return event.mouse_region_x, event.mouse_region_y


def _seen(context) -> tuple:
    """What the viewport shows of the active splat: its scene, its matrix, the camera; and the rows of the
    scene's Gaussians in the object. Raises SplatError."""
    if context.region is None or context.region_data is None:
        raise SceneError(tr("Gaussians are selected in a 3D viewport: use the tool there"))
    use_threads(context)
    scene, rows = scene_cache.read_own(context.object)
    camera = visible_splats.region_camera(context.region, context.region_data)
    return scene, context.object.matrix_world, camera, rows


def _draw():
    """Draws the outline of the operator that runs, in its viewport."""
    for operator in (one for one in _drawn if one.region == bpy.context.region.as_pointer()):
        path = [tuple(point.loc) for point in operator.path] or [operator.mouse]
        radius = bpy.context.scene.svrgs_view.select_radius
        outline = select_in_view.Outline(operator.shape, path, radius)
        shader = gpu.shader.from_builtin("UNIFORM_COLOR")
        shader.bind()
        for offset, color in ((1, SHADOW), (0, COLOR)):
            shader.uniform_float("color", color)
            for line in outline.lines(operator.mouse):
                moved = [(x + offset, y - offset) for x, y in line]
                batch_for_shader(shader, "LINE_STRIP", {"pos": moved}).draw(shader)


def _keys(shape: str) -> tuple:
    """The keys of a tool: a drag, with Shift and Ctrl, and those of Blender that begin other shapes."""
    drag = {"type": "LEFTMOUSE", "value": "PRESS" if shape == "BRUSH" else "CLICK_DRAG"}
    lasso = {"type": "RIGHTMOUSE", "value": "CLICK_DRAG", "ctrl": True}
    return (
        _key(shape, "SET", drag),
        _key(shape, "EXTEND", drag, shift=True),
        _key(shape, "SUBTRACT", drag, ctrl=True),
        _key("LASSO", "SET", lasso),
        _key("LASSO", "SUBTRACT", lasso, shift=True),
        _key("BOX", "SET", {"type": "B", "value": "PRESS"}, wait=True),
        _key("BRUSH", "SET", {"type": "C", "value": "PRESS"}, wait=True),
        ("svrgs.hide_gaussians", {"type": "H", "value": "PRESS"}, None),
        ("svrgs.show_gaussians", {"type": "H", "value": "PRESS", "alt": True}, None),
    )


def _key(shape: str, mode: str, event: dict, wait: bool = False, **held: bool) -> tuple:
    properties: list[tuple[str, object]] = [("shape", shape), ("mode", mode), ("wait", wait)]
    return (SVRGS_OT_select_region.bl_idname, event | held, {"properties": properties})


class Tool(bpy.types.WorkSpaceTool):
    bl_space_type = "VIEW_3D"
    bl_context_mode = "OBJECT"

    @staticmethod
    def draw_settings(context, layout, tool):
        settings = context.scene.svrgs_view
        layout.prop(settings, "select_through")
        if tool.idname.endswith("brush"):
            layout.prop(settings, "select_radius")


class BoxTool(Tool):
    bl_idname = "svrgs.select_box"
    bl_label = "Select Gaussians: Box"
    bl_description = "Select Gaussians of the active splat in a rectangle. Shift adds, Ctrl removes"
    bl_icon = "ops.generic.select_box"
    bl_keymap = _keys("BOX")


class BrushTool(Tool):
    bl_idname = "svrgs.select_brush"
    bl_label = "Select Gaussians: Brush"
    bl_description = "Select Gaussians of the active splat under a round brush. Shift adds, Ctrl removes"
    bl_icon = "ops.generic.select_circle"
    bl_keymap = _keys("BRUSH")


class LassoTool(Tool):
    bl_idname = "svrgs.select_lasso"
    bl_label = "Select Gaussians: Lasso"
    bl_description = "Select Gaussians of the active splat inside a drawn line. Shift adds, Ctrl removes"
    bl_icon = "ops.generic.select_lasso"
    bl_keymap = _keys("LASSO")


TOOLS = (BoxTool, BrushTool, LassoTool)
DRAWS = {"POST_PIXEL": _draw}


def register():
    first, *others = TOOLS
    bpy.utils.register_tool(first, after={"builtin.select_lasso"}, separator=True, group=True)
    for tool in others:
        bpy.utils.register_tool(tool, after={first.bl_idname})


def unregister():
    for tool in reversed(TOOLS):
        bpy.utils.unregister_tool(tool)

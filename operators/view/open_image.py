"""Open in Image Editor: shows an image of this extension in a window of its own."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.system.errors import SceneError
from ..data.reporting import ReportingOperator


class SVRGS_OT_open_image(ReportingOperator):
    bl_label = "Open in Image Editor"
    bl_description = "Show the picture in its full size in an Image Editor in a new window"
    bl_options = {"REGISTER"}

    name: bpy.props.StringProperty(name="Image", description="Name of the image")

    @classmethod
    def problem(cls, context) -> str:
        return tr("Blender runs without a window") if bpy.app.background else ""

    def work(self, context) -> str:
        image = bpy.data.images.get(self.name)
        if image is None:
            raise SceneError(tr("There is no image '{name}': draw it first").format(name=self.name))
        manager, known = context.window_manager, set(context.window_manager.windows)
        bpy.ops.wm.window_new()
        new = [window for window in manager.windows if window not in known]
        area = max(new, key=lambda window: window.width).screen.areas[0]
        area.ui_type = "IMAGE_EDITOR"
        area.spaces.active.image = image
        return ""

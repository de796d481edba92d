"""The spatial mask: its image and the scale of its colours. In the 3D View and in the Image Editor."""

import bpy
from bpy.app.translations import pgettext_iface as tr

from ..operators.data.extension import native_problem
from ..operators.view import spatial_mask
from .sidebar import SidebarPanel, native_library_works, sidebar_units, split_column, wrapped_label

TICKS = 5


class SpatialMaskPanel(SidebarPanel):
    bl_label = "Spatial Mask"
    manual = "blender.html#in-the-view-and-in-renders"

    def draw(self, context):
        layout, settings = self.layout, context.scene.svrgs_view
        if not native_library_works(layout):
            return
        row = layout.row(align=True)
        row.operator("svrgs.spatial_mask", icon="FILE_REFRESH", text="Refresh")
        row.prop(settings, "mask_follow", text="", icon="CAMERA_DATA")
        image, figures = bpy.data.images.get(spatial_mask.NAME), spatial_mask.figures()
        if image is None or not figures:
            text = tr("Refresh draws F, the normalised number of Gaussians in each pixel")
            wrapped_label(layout, text, "INFO")
            return
        draw_image(layout, image)
        legend(layout, settings.mask_top or figures["largest"])
        text = tr("{camera}: mean {mean:.3g}, {milliseconds} ms").format(**figures)
        layout.label(text=text, translate=False)
        column = split_column(layout)
        for name in ("mask_colors", "mask_top", "mask_size"):
            column.prop(settings, name)


class SVRGS_PT_spatial_mask(SpatialMaskPanel):
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 10

    def draw(self, context):
        SpatialMaskPanel.draw(self, context)
        if not native_problem():
            self.layout.operator("svrgs.contribution", icon="MOD_VERTEX_WEIGHT")
            self.layout.operator("svrgs.removal_error", icon="SORT_DESC")


class SVRGS_PT_spatial_mask_image(SpatialMaskPanel):
    bl_space_type = "IMAGE_EDITOR"


def draw_image(layout, image):
    """The preview of the image, as wide as the sidebar."""
    if image.preview is not None:
        layout.template_icon(image.preview.icon_id, scale=sidebar_units())


def legend(layout, top: float):
    """Numbers from 0 to top below the colour bar."""
    row = layout.row()
    for k in range(TICKS):
        cell = row.row()
        cell.alignment = "LEFT" if k == 0 else "RIGHT" if k == TICKS - 1 else "CENTER"
        cell.label(text=f"{top * k / (TICKS - 1):.2g}", translate=False)

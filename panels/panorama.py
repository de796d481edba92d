"""Properties of a panoramic camera: Blender shows those of panoramas for Cycles only."""

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.app.translations import pgettext_n as n_

from .sidebar import wrapped_label

LIMITS = (
    ("latitude_min", n_("Latitude Min")),
    ("latitude_max", n_("Max")),
    ("longitude_min", n_("Longitude Min")),
    ("longitude_max", n_("Max")),
)


class SVRGS_PT_panorama(bpy.types.Panel):
    bl_label = "Panorama"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "data"

    @classmethod
    def poll(cls, context):
        return context.engine == "SVRGS" and context.camera is not None and context.camera.type == "PANO"

    def draw(self, context):
        layout, camera = self.layout, context.camera
        layout.use_property_split = True
        layout.prop(camera, "panorama_type")
        if camera.panorama_type != "EQUIRECTANGULAR":
            wrapped_label(layout, tr("SVR-GS renders panoramas of the type Equirectangular only"), "INFO")
            return
        for limits in (LIMITS[:2], LIMITS[2:]):
            column = layout.column(align=True)
            for name, text in limits:
                column.prop(camera, name, text=text)

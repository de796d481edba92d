"""Edit > Preferences > Add-ons > SVR-GS."""

import bpy
from bpy.props import IntProperty


class SVRGS_AP_preferences(bpy.types.AddonPreferences):
    bl_idname = __package__.rpartition(".")[0]

    threads: IntProperty(
        name="Threads",
        min=0,
        soft_max=64,
        default=0,
        description="Number of threads for drawing and pruning. 0: one per core",
    )

    def draw(self, context):
        self.layout.use_property_split = True
        self.layout.prop(self, "threads")

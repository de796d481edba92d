"""Selecting Gaussians: below the panel Scene."""

from bpy.app.translations import pgettext_iface as tr

from ..operators.data import selection
from .sidebar import SplatPanel, native_library_works

TOOLS = {
    "svrgs.select_box": "SELECT_SET",
    "svrgs.select_brush": "PROP_ON",
    "svrgs.select_lasso": "GP_SELECT_STROKES",
}

CHANGES = {"GROW": "ADD", "SHRINK": "REMOVE", "INVERT": "SELECT_DIFFERENCE"}


class SVRGS_PT_select(SplatPanel):
    bl_label = "Select"
    manual = "selection.html#in-blender"

    def draw(self, context):
        layout, selected = self.layout, selection.selected_count(context.object)
        if not native_library_works(layout):
            return
        row = layout.row(align=True)
        for name, icon in TOOLS.items():
            row.operator("wm.tool_set_by_id", text="", icon=icon).name = name
        row.prop(context.scene.svrgs_view, "select_through", toggle=True)
        layout.operator_menu_enum(
            "svrgs.select_gaussians", "criterion", text="Select", icon="RESTRICT_SELECT_OFF"
        )
        if hidden := selection.hidden_count(context.object):
            row = layout.row()
            row.label(text=tr("{count:,} Gaussians are hidden").format(count=hidden), translate=False)
            row.operator("svrgs.show_gaussians", text="", icon="HIDE_OFF")
        if not selected:
            return
        row = layout.row()
        row.label(text=tr("{count:,} Gaussians selected").format(count=selected), translate=False)
        for how, icon in CHANGES.items():
            row.operator("svrgs.change_selection", text="", icon=icon).how = how
        row.operator("svrgs.clear_selection", text="", icon="X")
        row = layout.row(align=True)
        row.operator("svrgs.delete_gaussians", text="Delete Selected", icon="TRASH").what = "SELECTED"
        others = row.operator("svrgs.delete_gaussians", text="Keep Only Selected", icon="FULLSCREEN_EXIT")
        others.what = "OTHERS"
        row = layout.row(align=True)
        row.operator("svrgs.hide_gaussians", icon="HIDE_ON")
        row.operator("svrgs.separate_gaussians", text="Separate Selected", icon="MOD_EXPLODE")

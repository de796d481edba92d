"""The steps: Train, Prune, Compare, Export, one of which is open (operators/jobs/steps.py). Each is a module
with has_something(context), whether there is something to do, and draw(layout, context)."""

from bpy.app.translations import pgettext_n as n_

from . import compare, export, prune, train
from .sidebar import SidebarPanel, manual_button

STEPS = (
    ("train", n_("1  Train"), train),
    ("prune", n_("2  Prune"), prune),
    ("compare", n_("3  Compare"), compare),
    ("export", n_("4  Export"), export),
)


class SVRGS_PT_steps(SidebarPanel):
    bl_label = "Steps"
    bl_order = 1

    def draw_header_preset(self, context):
        """Each step has a button of its own."""

    def draw(self, context):
        for name, label, step in STEPS:
            header, body = self.layout.panel_prop(context.window_manager.svrgs_steps, name)
            row = header.row()
            row.active = step.has_something(context)
            row.label(text=label)
            manual_button(header, f"{self.manual}#{name}")
            if body is not None:
                step.draw(body, context)

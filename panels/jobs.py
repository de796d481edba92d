"""All jobs that this Blender knows, below step 2: with or without a splat in the file, running, waiting,
stopped or finished."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_n as n_

from ..operators.jobs import job_list
from .sidebar import SidebarPanel, wrapped_label

BUTTONS = {  # action -> operator, icon
    "stop": ("svrgs.job_stop", "PAUSE"),
    "resume": ("svrgs.job_resume", "PLAY"),
    "load": ("svrgs.job_load", "IMPORT"),
    "discard": ("svrgs.job_discard", "TRASH"),
}


class SVRGS_PT_jobs(SidebarPanel, bpy.types.Panel):
    bl_label = "Jobs"
    bl_parent_id = "SVRGS_PT_prune"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, rows = self.layout, job_list.rows(context)
        if not rows:
            layout.label(text="There are no jobs", icon="INFO")
        for row in rows:
            column = layout.box().column(align=True)
            head = column.row()
            head.label(text=row.name, icon=row.icon, translate=False)
            buttons = head.row(align=True)
            buttons.alignment = "RIGHT"
            draw_actions(buttons, row.job, row.actions, named=False)
            wrapped_label(column, row.state)
            wrapped_label(column, row.size)
        if text := job_list.finished_text(context):
            layout.operator("svrgs.delete_finished_jobs", icon="TRASH", text=text)


def draw_actions(layout, job, actions: tuple[str, ...], named: bool = True):
    """The buttons of a job."""
    for action in actions:
        stop_now = action == "stop" and job.stopping
        options = {"text": n_("Stop Now")} if stop_now and named else {} if named else {"text": ""}
        operator, icon = BUTTONS[action]
        button = layout.operator(operator, icon=icon, **options)
        button.folder = str(job.folder.path)
        if action == "stop":
            button.now = stop_now


CLASSES = (SVRGS_PT_jobs,)

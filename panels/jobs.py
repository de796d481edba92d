"""All jobs that this Blender knows, below step 2: with or without a splat in the file, running, waiting,
stopped or finished."""

import bpy

from ..operators.jobs import job_list
from .wrapped_label import wrapped_label

BUTTONS = {  # name of a button -> operator, icon
    "stop": ("svrgs.listed_job_stop", "PAUSE"),
    "resume": ("svrgs.listed_job_resume", "PLAY"),
    "open": ("svrgs.listed_job_open", "IMPORT"),
    "delete": ("svrgs.listed_job_delete", "TRASH"),
}


class SVRGS_PT_jobs(bpy.types.Panel):
    bl_label = "Jobs"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SVR-GS"
    bl_parent_id = "SVRGS_PT_prune"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        layout, rows = self.layout, job_list.rows(context)
        if not rows:
            layout.label(text="There are no jobs", icon="INFO")
        for row in rows:
            draw_job(layout.box().column(align=True), row)
        if text := job_list.finished_text(context):
            layout.operator("svrgs.delete_finished_jobs", icon="TRASH", text=text)


def draw_job(column, job: dict):
    """One job: name and buttons, state, size."""
    head = column.row()
    head.label(text=job["name"], icon=job["icon"], translate=False)
    buttons = head.row(align=True)
    buttons.alignment = "RIGHT"
    for name in job["buttons"]:
        operator, icon = BUTTONS[name]
        buttons.operator(operator, icon=icon, text="").folder = job["folder"]
    wrapped_label(column, job["state"])
    wrapped_label(column, job["size"])


CLASSES = (SVRGS_PT_jobs,)

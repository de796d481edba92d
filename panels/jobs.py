"""All jobs that this Blender knows: with or without a splat in the file, running, waiting, stopped or
finished. One line on what runs, or how it ended, is in the title and in the header of the 3D View."""

from __future__ import annotations

from bpy.app.translations import pgettext_n as n_

from ..operators.jobs import job_list, job_pictures, job_state, prune_state
from .sidebar import SidebarPanel, wrapped_label

# of the buttons, by what is done (job_state.State.actions)
ICONS = {"run_now": "TRIA_UP", "stop": "PAUSE", "resume": "PLAY", "load": "IMPORT", "discard": "TRASH"}


class SVRGS_PT_jobs(SidebarPanel):
    bl_label = "Jobs"
    bl_order = 5
    bl_options = {"DEFAULT_CLOSED"}
    manual = "jobs.html"

    def draw_header_preset(self, context):
        self.layout.label(text=job_list.headline(context), translate=False)
        super().draw_header_preset(context)

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
        button = layout.operator(f"svrgs.job_{action}", icon=ICONS[action], **options)
        button.folder = str(job.folder.path)
        if action == "stop":
            button.now = stop_now


def draw_job(layout, context, subject, job):
    """A job that runs, waits, or has stopped: its progress, what it says, its pictures, and its buttons."""
    layout.label(text=subject.name, icon="OUTLINER_OB_POINTCLOUD", translate=False)
    if job_state.is_busy(job):
        layout.progress(factor=job.progress, text=job_state.time_left(job))
    icon = "NONE" if job_state.is_busy(job) else "INFO" if job_state.is_resumable(job) else "CHECKMARK"
    for sentence in prune_state.sentences(context):
        wrapped_label(layout, sentence, icon)
        icon = "NONE"
    if job.state != "done" and (pictures := job_pictures.icons(job.folder)):
        row = layout.row()
        for picture in pictures:
            row.template_icon(icon_value=picture, scale=6)
        layout.label(text="Blue: Gaussians. Orange: PSNR")
    draw_actions(layout.row(align=True), job, job_state.of(job).actions)


def draw_headline(header, context):
    if line := job_list.headline(context):
        header.layout.label(text=line, icon="OUTLINER_OB_POINTCLOUD", translate=False)


MENUS = {"VIEW3D_HT_header": draw_headline}

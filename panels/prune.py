"""Step 2: settings of pruning, progress of a job, and its result. In every state the panel says what to do
next."""

from __future__ import annotations

import bpy

from .wrapped_label import wrapped_label

PAPER_VALUES = (1e-4, 1.25e-4, 1.6e-4, 2e-4)  # values of λ_F in the paper
# goal -> its property; the strength has rows of its own
GOALS = {"DEVICE": "device", "SHARE": "share", "COUNT": "count", "SIZE": "size", "DROP": "drop"}
ADVANCED = (
    "lambda_f", "iterations", "recovery", "seed", "min_contribution", "holdout", "visible_mask", "views_by_loss", "images", "folder",
)  # fmt: skip
STEPS = ("iterations", "recovery")  # chosen by the program if the time is limited
# stage -> icon of the first sentence
ICONS = {"BROKEN": "ERROR", "NOTHING": "INFO", "WAITING": "INFO", "FINISHED": "CHECKMARK"}


class SVRGS_PT_prune(bpy.types.Panel):
    bl_label = "2  Prune"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SVR-GS"
    bl_order = 2

    def draw(self, context):
        state = context.window_manager.svrgs_prune_state
        stage = state.stage
        if stage not in ("BROKEN", "NOTHING", "READY"):
            self.layout.label(text=state.subject, icon="OUTLINER_OB_POINTCLOUD", translate=False)
        draw = {"READY": draw_settings, "BUSY": draw_progress, "RESULT": draw_share}.get(stage)
        if draw is not None:
            draw(self.layout, context, state)
        icon = ICONS.get(stage, "NONE")
        for sentence in state.sentences.splitlines():
            wrapped_label(self.layout, sentence, icon)
            icon = "NONE"
        if stage in ("BUSY", "WAITING") and state.plot:
            row = self.layout.row()
            for picture in filter(None, (state.plot, state.preview)):
                row.template_icon(icon_value=picture, scale=6)
            self.layout.label(text="Blue: Gaussians. Orange: PSNR")
        draw_buttons(self.layout, stage, state)


class SVRGS_PT_prune_advanced(bpy.types.Panel):
    bl_label = "Advanced"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SVR-GS"
    bl_parent_id = "SVRGS_PT_prune"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return context.window_manager.svrgs_prune_state.stage == "READY"

    def draw(self, context):
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(context.scene.svrgs_prune, "method", text="All Methods")
        for name in ADVANCED:
            row = column.row()
            row.active = not (context.scene.svrgs_prune.use_time and name in STEPS)
            row.prop(context.scene.svrgs_prune, name)


def draw_settings(layout, context, state):
    settings = context.scene.svrgs_prune
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(settings, "depth")
    if settings.depth == "PHOTOGRAPHS":
        column.prop(settings, "colmap", placeholder=state.dataset)
    if settings.depth == "TUNED":
        column.prop(settings, "views")
        column.operator("svrgs.place_cameras", icon="OUTLINER_OB_CAMERA")
    if settings.depth != "QUICK":
        column.prop(settings, "method_choice")
    wrapped_label(column, state.method_help)
    column.prop(settings, "goal")
    if settings.goal in GOALS:
        column.prop(settings, GOALS[settings.goal])
    elif settings.goal == "LAMBDA" and state.strength_help:
        draw_strength(column.column(align=True), settings)
        wrapped_label(column, state.strength_help)
    wrapped_label(column, state.goal_help)
    if settings.depth != "QUICK":
        draw_training(column, settings, state)
    row = layout.row(align=True)
    row.operator("svrgs.estimate", icon="VIEWZOOM")
    row.operator("svrgs.job_start", icon="PLAY")


def draw_training(column, settings, state):
    if not state.merges:
        column.prop(settings, "nested")
    column.prop(settings, "use_time")
    if settings.use_time:
        column.prop(settings, "time")


def draw_strength(column, settings):
    column.prop(settings, "amount", slider=True)
    if settings.method_choice == "PAPER":
        row = column.row(align=True)
        for value in PAPER_VALUES:
            row.operator("svrgs.set_lambda", text=f"{value * 1e4:g}e-4").value = value


def draw_progress(layout, _, state):
    layout.progress(factor=state.progress, text=state.time_left)


def draw_share(layout, _, state):
    if state.slider:
        layout.prop(bpy.data.objects[state.subject], "svrgs_share", slider=True)


def draw_buttons(layout, stage: str, state):
    row = layout.row(align=True)
    if stage == "BUSY":
        row.operator(
            "svrgs.job_stop", icon="PAUSE", text="Stop Now" if state.stopping else "Stop"
        ).now = state.stopping
    elif stage == "WAITING":
        row.operator("svrgs.job_resume", icon="PLAY")
        row.operator("svrgs.job_discard", icon="TRASH")
    elif stage == "FINISHED":
        row.operator("svrgs.job_load", icon="IMPORT")
        row.operator("svrgs.job_discard", icon="TRASH")
    elif stage == "RESULT":
        if state.untuned:
            row.operator("svrgs.prune_again", icon="PLAY")
            row = layout.row(align=True)
        row.operator("svrgs.apply", icon="CHECKMARK")
        row.operator("svrgs.discard", text="Discard Result", icon="TRASH").what = "RESULT"
    elif stage == "READY":
        if state.orphan:
            row.operator("svrgs.adopt_job", icon="LINKED")
        if state.original:
            row.operator("svrgs.discard", text="Discard Original", icon="TRASH").what = "ORIGINAL"


CLASSES = (SVRGS_PT_prune, SVRGS_PT_prune_advanced)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister():
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)

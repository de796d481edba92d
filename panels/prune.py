"""Step 2: settings of pruning, progress of its job, and its result. In every state the panel says what to do
next."""

from __future__ import annotations

import bpy

from ..operators.data import quick_order
from ..operators.jobs import (
    depths,
    goals,
    job_result,
    job_watch,
    orphan_jobs,
    prune_state,
    train,
)  # fmt: skip
from ..operators.scene.dataset_paths import dataset_of
from .jobs import draw_job
from .sidebar import SidebarPanel, split_column, wrapped_label

PAPER_VALUES = (1e-4, 1.25e-4, 1.6e-4, 2e-4)  # values of λ_F in the paper
# goal -> its property; the strength has rows of its own
GOALS = {"DEVICE": "device", "SHARE": "share", "COUNT": "count", "SIZE": "size", "DROP": "drop"}
ADVANCED = (
    "lambda_f", "iterations", "recovery", "seed", "min_contribution", "holdout", "visible_mask",
    "views_by_loss", "force", "images", "masks", "invert_masks", "outside", "exposure",
    "refine_poses", "mask_distractors", "folder",
)  # fmt: skip
STEPS = ("iterations", "recovery")  # chosen by the program if the time is limited
# stage -> icon of the first sentence
ICONS = {"BROKEN": "ERROR", "NOTHING": "INFO"}


class SVRGS_PT_prune(SidebarPanel, bpy.types.Panel):
    bl_label = "2  Prune"
    bl_order = 2

    @classmethod
    def poll(cls, context):
        return not train.is_shown(context)

    def draw(self, context):
        layout, stage, subject = self.layout, prune_state.stage(context), prune_state.subject(context)
        found = job_watch.current(context)
        if stage != "BROKEN" and found is not None:
            draw_job(layout, context, *found)
            return
        if stage == "READY":
            draw_settings(layout, context)
        elif stage == "RESULT" and subject is not None:
            layout.label(text=subject.name, icon="OUTLINER_OB_POINTCLOUD", translate=False)
            if job_result.has_slider(subject):
                layout.prop(subject, "svrgs_share", slider=True)
        icon = ICONS.get(stage, "NONE")
        for sentence in prune_state.sentences(context):
            wrapped_label(layout, sentence, icon)
            icon = "NONE"
        draw_buttons(layout, context, stage)


class SVRGS_PT_prune_advanced(SidebarPanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "SVRGS_PT_prune"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return prune_state.stage(context) == "READY"

    def draw(self, context):
        column = split_column(self.layout)
        column.prop(context.scene.svrgs_prune, "method", text="All Methods")
        for name in ADVANCED:
            row = column.row()
            row.active = not (context.scene.svrgs_prune.use_time and name in STEPS)
            row.prop(context.scene.svrgs_prune, name)


def draw_settings(layout, context):
    settings = context.scene.svrgs_prune
    column = split_column(layout)
    column.prop(settings, "depth")
    if settings.depth == "PHOTOGRAPHS":
        column.prop(settings, "data", placeholder=dataset_of(context)[0])
    if settings.depth == "TUNED":
        column.prop(settings, "views")
        column.operator("svrgs.place_cameras", icon="OUTLINER_OB_CAMERA")
    if settings.depth != "QUICK":
        column.prop(settings, "method_choice")
    wrapped_label(column, prune_state.method_sentence(context))
    column.prop(settings, "goal")
    if settings.goal in GOALS:
        column.prop(settings, GOALS[settings.goal])
    elif settings.goal == "LAMBDA" and (strength := goals.strength_sentence(settings)):
        draw_strength(column.column(align=True), settings)
        wrapped_label(column, strength)
    wrapped_label(column, goals.sentence(settings, depths.merges(context)))
    if settings.depth != "QUICK":
        if not depths.merges(context):
            column.prop(settings, "nested")
        column.prop(settings, "use_time")
        if settings.use_time:
            column.prop(settings, "time")
    row = layout.row(align=True)
    row.operator("svrgs.estimate", icon="VIEWZOOM")
    row.operator("svrgs.job_start", icon="PLAY")


def draw_strength(column, settings):
    column.prop(settings, "amount", slider=True)
    if settings.method_choice == "PAPER":
        row = column.row(align=True)
        for value in PAPER_VALUES:
            row.operator("svrgs.set_lambda", text=f"{value * 1e4:g}e-4").value = value


def draw_buttons(layout, context, stage: str):
    original, pruned = job_result.pair_of(context.object)
    row = layout.row(align=True)
    if stage == "RESULT":
        if quick_order.is_shown(pruned):
            row.operator("svrgs.prune_again", icon="PLAY")
            row = layout.row(align=True)
        row.operator("svrgs.apply", icon="CHECKMARK")
        row.operator("svrgs.discard", text="Discard Result", icon="TRASH").what = "RESULT"
    elif stage == "READY":
        if orphan_jobs.sentence(context):
            row.operator("svrgs.adopt_job", icon="LINKED")
        if original is not None and not job_result.undecided(pruned):
            row.operator("svrgs.discard", text="Discard Original", icon="TRASH").what = "ORIGINAL"


CLASSES = (SVRGS_PT_prune, SVRGS_PT_prune_advanced)

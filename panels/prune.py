"""Step 2: settings of pruning, progress of its job, and its result. In every state the panel says what to do
next."""

from __future__ import annotations

from ..operators.data import quick_order
from ..operators.jobs import efforts, estimate, goals, job_result, job_watch, orphan_jobs, prune_state, train
from ..operators.scene.dataset_paths import dataset_of
from .jobs import draw_job
from .sidebar import split_column, wrapped_label

PAPER_VALUES = (1e-4, 1.25e-4, 1.6e-4, 2e-4)  # values of λ_F in the paper
# goal -> its property; the strength has rows of its own
GOALS = {"DEVICE": "device", "SHARE": "share", "COUNT": "count", "SIZE": "size", "DROP": "drop"}
ADVANCED = (
    "sh_degree", "lambda_f", "iterations", "recovery", "seed", "min_contribution", "holdout", "visible_mask",
    "views_by_loss", "force", "images", "masks", "invert_masks", "outside", "exposure",
    "refine_poses", "mask_distractors", "folder",
)  # fmt: skip
STEPS = ("iterations", "recovery")  # chosen by the program if the time is limited
# stage -> icon of the first sentence
ICONS = {"BROKEN": "ERROR", "NOTHING": "INFO"}


def has_something(context) -> bool:
    return prune_state.stage(context) != "NOTHING" and not train.is_shown(context)


def draw(layout, context):
    stage, found = prune_state.stage(context), job_watch.current(context)
    _, pruned = job_result.pair_of(context.object)
    if train.is_shown(context):
        layout.label(text="Train the splat first", icon="INFO")
        return
    if stage != "BROKEN" and found is not None:
        draw_job(layout, context, *found)
        return
    if stage == "READY":
        draw_settings(layout, context)
    elif stage == "RESULT" and pruned is not None:
        layout.label(text=pruned.name, icon="OUTLINER_OB_POINTCLOUD", translate=False)
        if job_result.has_slider(pruned):
            layout.prop(pruned, "svrgs_share", slider=True)
    icon = ICONS.get(stage, "NONE")
    for sentence in prune_state.sentences(context):
        wrapped_label(layout, sentence, icon)
        icon = "NONE"
    draw_buttons(layout, context, stage)
    if stage == "READY":
        header, body = layout.panel("svrgs_advanced", default_closed=True)
        header.label(text="Advanced")
        if body is not None:
            draw_advanced(body, context)


def draw_advanced(layout, context):
    column = split_column(layout)
    column.prop(context.scene.svrgs_prune, "method", text="All Methods")
    for name in ADVANCED:
        row = column.row()
        row.active = not (context.scene.svrgs_prune.use_time and name in STEPS)
        row.prop(context.scene.svrgs_prune, name)


def draw_settings(layout, context):
    settings = context.scene.svrgs_prune
    column = split_column(layout)
    column.prop(settings, "effort")
    if settings.effort == "PHOTOGRAPHS":
        column.prop(settings, "data", placeholder=dataset_of(context)[0])
    if settings.effort == "TUNED":
        column.prop(settings, "views")
        column.operator("svrgs.place_cameras", icon="OUTLINER_OB_CAMERA")
    if settings.effort != "QUICK":
        column.prop(settings, "method_choice")
    wrapped_label(column, prune_state.method_sentence(context))
    column.prop(settings, "goal")
    if settings.goal in GOALS:
        column.prop(settings, GOALS[settings.goal])
        if settings.goal == "SIZE":
            column.prop(settings, "size_kind")
    elif settings.goal == "LAMBDA" and (strength := goals.strength_sentence(settings)):
        draw_strength(column.column(align=True), settings)
        wrapped_label(column, strength)
    wrapped_label(column, goals.sentence(settings, efforts.merges(context)))
    if settings.effort != "QUICK":
        if not efforts.merges(context):
            column.prop(settings, "nested")
        column.prop(settings, "use_time")
        if settings.use_time:
            column.prop(settings, "time")
    draw_estimate(layout, context)
    layout.operator("svrgs.job_start", icon="PLAY")


def draw_estimate(layout, context):
    """The estimate in a line, which opens to all that it says."""
    estimate.keep_up(context)
    if not estimate.is_live(context.object):
        layout.operator("svrgs.estimate", icon="VIEWZOOM")
    if line := estimate.line(context.object):
        header, body = layout.panel("svrgs_estimate", default_closed=True)
        header.label(text=line, translate=False)
        if body is not None:
            for sentence in estimate.sentences(context.object):
                wrapped_label(body, sentence)


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

"""Step 2: what pruning shall do, how it goes on, and what came of it. Draws in any state, and says what to do in it."""

from __future__ import annotations

import bpy

from ..operators import estimate, job_plot, job_result
from ..operators.job import dataset_of, file_size, native_problem, uses_lambda
from ..operators.job_watch import BUSY, WAITING, current

PRESETS = (1e-4, 1.25e-4, 1.6e-4, 2e-4)  # of the paper
GOAL_PROPERTY = {"SHARE": "share", "COUNT": "count", "SIZE": "size"}
SILENT = 60.0  # seconds without a sign of life that are worth telling
WAITING_TEXT = {
    "paused": "Paused", "cancelled": "Cancelled", "interrupted": "An interrupted job was found", "failed": "The job failed",
}  # fmt: skip
CHARACTER = 6.8  # pixels of one, in the mean


class SVRGS_PT_prune(bpy.types.Panel):
    bl_label = "2  Prune"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SVR-GS"
    bl_order = 2

    def draw(self, context):
        layout, problem = self.layout, native_problem()
        if problem:
            lines(layout, problem, "ERROR")
            return
        splat, job = current(context)
        _, pruned = job_result.pair_of(context.object)
        if job is not None:
            draw_job(layout, splat, job)
        elif pruned is not None:
            draw_result(layout, pruned)
        elif context.object is None or not is_splat(context.object):
            layout.label(text="Select a splat, or import one in step 1", icon="INFO")
        else:
            draw_settings(layout, context)


class SVRGS_PT_prune_advanced(bpy.types.Panel):
    bl_label = "Advanced"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SVR-GS"
    bl_parent_id = "SVRGS_PT_prune"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return is_splat(context.object) and current(context)[1] is None and job_result.pair_of(context.object)[1] is None

    def draw(self, context):
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        for name in ("seed", "min_contribution", "holdout", "visible_mask", "views_by_loss", "images", "folder"):
            column.prop(context.scene.svrgs_prune, name)


def is_splat(obj) -> bool:
    attributes = getattr(getattr(obj, "data", None), "attributes", {})
    return all(name in attributes for name in ("scale", "rotation", "radiance:base"))


def draw_settings(layout, context):
    settings, obj = context.scene.svrgs_prune, context.object
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(settings, "colmap", placeholder=dataset_of(context)[0])
    column.prop(settings, "method")
    column.prop(settings, "goal")
    if settings.goal == "LAMBDA":
        strength = column.column(align=True)
        strength.active = uses_lambda(settings.method)
        strength.prop(settings, "strength", slider=True, text=f"λ_F = {settings.lambda_f * 1e4:.3g}e-4")
        row = strength.row(align=True)
        for value in PRESETS:
            row.operator("svrgs.set_lambda", text=f"{value * 1e4:g}e-4").value = value
    else:
        column.prop(settings, GOAL_PROPERTY[settings.goal])
    column.prop(settings, "iterations")
    column.prop(settings, "recovery")
    row = layout.row(align=True)
    row.operator("svrgs.estimate", icon="VIEWZOOM")
    row.operator("svrgs.job_start", icon="PLAY")
    found = estimate.of(obj)
    if found.get("busy"):
        layout.label(text="Looking at some views …", icon="SORTTIME")
    elif found:
        box = layout.column(align=True)
        for sentence in estimate.sentences(obj):
            lines(box, sentence)
    if not dataset_of(context)[0]:
        lines(layout, "Choose the dataset of the splat's photographs, or import its cameras in step 1", "INFO")


def draw_job(layout, splat, job):
    facts = job.facts
    layout.label(text=splat.name, icon="OUTLINER_OB_POINTCLOUD")
    if job.state in BUSY:
        layout.progress(factor=share_done(facts), text=time_left(facts))
        lines(layout, facts.get("text") or "Working")
        draw_figures(layout, job)
        if job.seconds_silent > SILENT:
            lines(layout, f"No sign of life for {job.seconds_silent:.0f} s: Cancel ends it", "ERROR")
        row = layout.row(align=True)
        row.operator("svrgs.job_pause", icon="PAUSE")
        row.operator("svrgs.job_cancel", icon="X")
    elif job.state in WAITING:
        lines(layout, f"{WAITING_TEXT[job.state]} at {share_done(facts):.0%}" if facts.get("total") else WAITING_TEXT[job.state], "INFO")
        lines(layout, facts.get("text", ""))
        draw_figures(layout, job)
        row = layout.row(align=True)
        row.operator("svrgs.job_resume", icon="PLAY")
        row.operator("svrgs.job_discard", icon="TRASH")
    else:
        lines(layout, "A finished job was found", "CHECKMARK")
        row = layout.row(align=True)
        row.operator("svrgs.job_load", icon="IMPORT")
        row.operator("svrgs.job_discard", icon="TRASH")


def draw_figures(layout, job):
    facts, icon = job.facts, job_plot.icon(job.folder)
    if facts.get("count"):
        psnr = f", PSNR {facts['psnr']:.2f} dB" if facts.get("psnr") else ""
        layout.label(text=f"{facts['count']:,} Gaussians{psnr}")
    if icon:
        layout.template_icon(icon_value=icon, scale=7)
        layout.label(text="Blue: Gaussians. Orange: PSNR")


def draw_result(layout, pruned):
    original = pruned.get(job_result.ORIGINAL)
    if not job_result.undecided(pruned):
        lines(layout, f"Pruned to {size_of(pruned):,} Gaussians, {file_size(pruned, size_of(pruned))}", "CHECKMARK")
        if original is not None:
            lines(layout, f"The original '{original.name}' ({size_of(original):,}) is hidden")
            layout.operator("svrgs.discard", text="Discard Original", icon="TRASH").what = "ORIGINAL"
        return
    count = job_result.shown_count(pruned)
    layout.label(text=pruned.name, icon="OUTLINER_OB_POINTCLOUD")
    layout.prop(pruned, "svrgs_share", slider=True)
    of = f" of {size_of(original):,}" if original is not None else ""
    layout.label(text=f"{count:,}{of} Gaussians, {file_size(pruned, count)}")
    if job_result.PSNR in pruned:
        before, after = pruned[job_result.PSNR]
        lines(layout, f"PSNR {before:.2f} → {after:.2f} dB, {pruned[job_result.KEPT]:,} recovered")
    if count > pruned[job_result.KEPT]:
        lines(layout, f"{count - pruned['svrgs_kept']:,} more than were recovered: shown as in the original")
    row = layout.row(align=True)
    row.operator("svrgs.apply", icon="CHECKMARK")
    row.operator("svrgs.discard", text="Discard Result", icon="TRASH").what = "RESULT"


def size_of(splat) -> int:
    return len(splat.data.vertices if splat.type == "MESH" else splat.data.points)


def share_done(facts: dict) -> float:
    return facts.get("iteration", 0) / max(1, facts.get("total", 1))


def time_left(facts: dict) -> str:
    if not facts.get("total"):
        return "Starting"
    left = facts.get("seconds_left") or 0
    return f"{share_done(facts):.0%}, {left / 60:.0f} min left" if left >= 90 else f"{share_done(facts):.0%}, {left:.0f} s left"


def lines(layout, text: str, icon: str = "NONE"):
    """Labels of as many lines as the sidebar needs."""
    column, line = layout.column(align=True), ""
    region, scale = bpy.context.region, bpy.context.preferences.system.ui_scale
    room = (region.width / scale if region is not None and scale else 300) / CHARACTER - 3 - 3 * (icon != "NONE")  # no scale without a window
    for word in text.split():
        if line and len(line) + len(word) >= room:
            column.label(text=line, icon=icon)
            line, icon = "", "BLANK1" if icon != "NONE" else icon
        line = f"{line} {word}".strip()
    if line:
        column.label(text=line, icon=icon)


CLASSES = (SVRGS_PT_prune, SVRGS_PT_prune_advanced)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister():
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)

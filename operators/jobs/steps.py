"""The steps of the sidebar: Train, Prune, Compare, Export. One is open at a time: the one that has something
to do; or another one that the user has opened, until something happens (a splat is imported, a job begins or
ends, a result is applied)."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, PointerProperty, StringProperty

from ..data.splat_object import is_splat
from . import job_result, prune_state, train


def next_step(context) -> str:
    """The step that has something to do; empty if the scene has no splat and no cameras."""
    if train.is_shown(context):
        return "train"
    stage, (_, pruned) = prune_state.stage(context), job_result.pair_of(context.object)
    if stage == "READY" and pruned is not None and pruned == context.object:
        return "export"  # the result was applied
    return "" if stage == "NOTHING" else "prune"


def opened(context) -> str:
    """The step that is open; empty if none is."""
    chosen = context.window_manager.svrgs_steps
    return chosen.step if chosen.situation == _situation(context) else next_step(context)


def _situation(context) -> str:
    newest = max((obj.session_uid for obj in context.scene.objects if is_splat(obj)), default=0)
    return f"{prune_state.stage(context)} {next_step(context)} {newest}"


def _is_open(step: str):
    def choose(chosen, value: bool):
        chosen.step, chosen.situation = step if value else "", _situation(bpy.context)

    return BoolProperty(
        name=step.title(),
        description="Open this step and close the others",
        get=lambda _: opened(bpy.context) == step,
        set=choose,
    )


class SVRGS_PG_steps(bpy.types.PropertyGroup):
    """What the user has opened. It belongs to the window manager: files do not keep it."""

    step: StringProperty(options={"HIDDEN"})
    situation: StringProperty(options={"HIDDEN"})  # when it was opened
    train: _is_open("train")
    prune: _is_open("prune")
    compare: _is_open("compare")
    export: _is_open("export")


PROPERTIES = {("WindowManager", "svrgs_steps"): PointerProperty(type=SVRGS_PG_steps)}

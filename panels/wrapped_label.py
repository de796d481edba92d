"""Sentences in a sidebar, which is narrow."""

import bpy

CHARACTER = 6.8  # pixels of one, in the mean
WIDTH = 300  # pixels of a sidebar, where there is no window to ask


def lines(layout, sentence: str, icon: str = "NONE"):
    """Labels of as many lines as the sentence needs; icon: of the first."""
    column, line, room = layout.column(align=True), "", _room() - 3 * (icon != "NONE")
    for word in sentence.split():
        if line and len(line) + len(word) >= room:
            column.label(text=line, icon=icon)
            line, icon = "", "BLANK1" if icon != "NONE" else icon
        line = f"{line} {word}".strip()
    if line:
        column.label(text=line, icon=icon)


def usable(layout, context) -> bool:
    """Whether the native library works; where it does not, a line says what to do."""
    trouble = context.window_manager.svrgs_prune_state.trouble
    if trouble:
        lines(layout, trouble, "ERROR")
    return not trouble


def _room() -> float:
    """Characters of a line."""
    region, scale = bpy.context.region, bpy.context.preferences.system.ui_scale
    return (region.width / scale if region is not None and scale else WIDTH) / CHARACTER - 3

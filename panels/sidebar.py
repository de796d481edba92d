"""What the panels in the sidebar share: their tab, and text of several lines, as it is narrow."""

import re
import unicodedata

import bpy

from ..operators.data.extension import native_problem
from ..operators.data.splat_object import is_splat

CHARACTER_WIDTH = 6.8  # pixels, on average
SIDEBAR_WIDTH = 300  # pixels, if there is no window to ask
MARGINS, BUTTON_HEIGHT = 50, 20  # pixels: of the sidebar's tabs and panels; of one row
WIDE = "\u3040-\u30ff\u3400-\u9fff"  # Chinese and Japanese characters: a line may end after each of them
MARKS = "、。，：；！？）》”"  # punctuation that begins no line
PIECES = re.compile(f"\\s*(?:[{WIDE}][{MARKS}]*|[^\\s{WIDE}]+)")


class SidebarPanel(bpy.types.Panel):
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "SVR-GS"
    manual = "blender.html"  # page of the manual

    def draw_header_preset(self, context):
        manual_button(self.layout, self.manual)


class SplatPanel(SidebarPanel):
    """A panel below the panel Scene, for a splat."""

    bl_parent_id = "SVRGS_PT_scene"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        return is_splat(context.object)


def manual_button(layout, page: str):
    """Opens a page of the manual. page: its name, and # with a section."""
    layout.operator("svrgs.manual", text="", icon="HELP", emboss=False).page = page


def split_column(layout):
    """A column of properties with their names on the left."""
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    return column


def wrapped_label(layout, sentence: str, icon: str = "NONE"):
    """Labels for a sentence in the user's language, broken into lines that fit the region. icon: of the first
    line."""
    column, line = layout.column(align=True), ""
    length = _sidebar_width() / CHARACTER_WIDTH - 3 - 3 * (icon != "NONE")  # characters
    for piece in PIECES.findall(sentence):
        if line and _width(line + piece) > length:
            column.label(text=line, icon=icon, translate=False)
            line, icon = "", "BLANK1" if icon != "NONE" else icon
        line = (line + piece).lstrip()
    if line:
        column.label(text=line, icon=icon, translate=False)


def _width(text: str) -> int:
    """In characters of Latin letters; a Chinese character is twice as wide."""
    return sum(2 if unicodedata.east_asian_width(character) in "WF" else 1 for character in text)


def native_library_works(layout) -> bool:
    """Whether the native library works. If not, a line in the panel says what to do."""
    problem = native_problem()
    if problem:
        wrapped_label(layout, problem, "ERROR")
    return not problem


def sidebar_units() -> float:
    """Width of the sidebar's content, in heights of a button."""
    return max(5.0, (_sidebar_width() - MARGINS) / BUTTON_HEIGHT)


def _sidebar_width() -> float:
    """Pixels, without the scale of the interface."""
    region, scale = bpy.context.region, bpy.context.preferences.system.ui_scale
    return region.width / scale if region is not None and scale else SIDEBAR_WIDTH

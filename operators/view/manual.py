"""The manual, which lies in the extension (tools/manual.py makes it): Manual opens a page of it in the
browser, and so does Online Manual, in the menu of the right mouse button and with F1, for all that is
ours."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.system.errors import SceneError
from ..data.reporting import ReportingOperator

FOLDER = Path(__file__).parents[2] / "manual"  # with a folder for each language
PAGES = (  # of what Blender calls so
    ("bpy.ops.svrgs.select*", "selection.html#in-blender"),
    ("bpy.ops.svrgs.job*", "jobs.html"),
    ("bpy.ops.svrgs.*", "blender.html"),
    ("bpy.types.svrgs_pg_prune*", "blender.html#prune"),
    ("bpy.types.svrgs_pg_train*", "blender.html#train"),
    ("bpy.types.svrgs_pg_grade*", "blender.html#color"),
    ("bpy.types.svrgs_*", "blender.html"),
)


class SVRGS_OT_manual(ReportingOperator):
    bl_label = "Manual"
    bl_description = "Open the page of the manual in the browser. It lies on this computer"
    bl_options = {"INTERNAL"}

    page: bpy.props.StringProperty(options={"HIDDEN"})

    def work(self, context) -> str:
        page, _, section = self.page.partition("#")
        file = language_folder() / page
        if not file.is_file():
            raise SceneError(tr("The manual is not here: only the zip of the extension holds it"))
        bpy.ops.wm.url_open(url=f"{file.as_uri()}#{section}")
        return ""


def locale() -> str:
    """Of Blender's interface, such as de_DE."""
    return bpy.app.translations.locale


def language_folder() -> Path:
    """The folder of the manual in the language of Blender, or in English."""
    language = (locale() or "en").partition("_")[0]
    return FOLDER / (language if (FOLDER / language).is_dir() else "en")


def pages() -> tuple[str, tuple[tuple[str, str], ...]]:
    """What Blender's Online Manual asks for: where the pages are, and which page belongs to what."""
    return f"{language_folder().as_uri()}/", PAGES


def register():
    bpy.utils.register_manual_map(pages)


def unregister():
    bpy.utils.unregister_manual_map(pages)

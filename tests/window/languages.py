"""The panels in English, German and Chinese, and in German without the extension. Writes what was said to
OUT/seen.json."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
import driver
from bpy.app.translations import pgettext_iface
from driver import DATA, OUT, open_panel, shot

PACKAGE = "bl_ext.user_default.svrgs"


def said() -> list[str]:
    """The label of a panel and of an operator, a sentence with figures, and what the goal of the panel Prune
    means."""
    return [
        pgettext_iface("Spatial Mask"),
        pgettext_iface("Estimate", "Operator"),
        importlib.import_module(f"{PACKAGE}.operators.data.splat_size").about(bpy.context.object),
        importlib.import_module(f"{PACKAGE}.operators.jobs.goals").sentence(bpy.context.scene.svrgs_prune),
    ]


def steps():
    seen, view = {}, bpy.context.preferences.view
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.object.delete()
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "scene.ply"))
    yield from driver.sidebar("SVR-GS")
    for language in ("en_US", "de_DE", "zh_HANS"):
        view.language = language
        yield 1.0
        yield from open_panel("Prune")
        shot(language)
        seen[language] = said()
    view.language = "de_DE"
    bpy.ops.preferences.addon_disable(module=PACKAGE)
    seen["without"] = [pgettext_iface("Spatial Mask"), pgettext_iface("Estimate", "Operator")]
    (OUT / "seen.json").write_text(json.dumps(seen))


driver.run(steps())

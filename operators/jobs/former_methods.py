"""Files of an earlier version: says once what their pruning method is called now, and keeps their goal.

A .blend file stores the method as a number of the menu. Every method has kept its number, so an old file
keeps its method; only names have changed. `method_schema` of the scene's settings says which names were in
use when the method was chosen: 0 is before the change. Before schema 2 the default goal was the strength λ_F.
A file that stores a method or a strength, but no goal, keeps it.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.finetune.methods import FORMER_NAMES, METHODS

SCHEMA = 2
FORMER_NAME = {present: former for former, present in FORMER_NAMES.items()}

_renamed: dict[int, str] = {}  # by session_uid of a scene whose method is called otherwise now: the method


def sentence_of(scene: bpy.types.Scene) -> str:
    """What the scene's method is called now, until another method is chosen; empty where its name is the
    same."""
    return renaming(_renamed.get(scene.session_uid, ""))


def method_chosen(settings, context):
    """After the user has chosen a method, which is by its present name."""
    settings.method_schema = SCHEMA
    _renamed.pop(settings.id_data.session_uid, None)


def renaming(name: str) -> str:
    """The sentence for a file in which method `name` was chosen under its former name; empty where the name
    is the same."""
    former = FORMER_NAME.get(name)
    if former is None:
        return ""
    text = tr("Method '{former}' of this file is called '{label}' now ('{name}' on the command line)")
    return text.format(former=former, label=tr(METHODS[name].label), name=name)


@persistent
def _after_load(*_):
    """Scenes of other files are left out: Blender does not save what is written to them."""
    _renamed.clear()
    for scene in (scene for scene in bpy.data.scenes if not scene.library):
        settings = scene.svrgs_prune
        before, has_method = settings.method_schema, settings.is_property_set("method")
        if (
            before < SCHEMA
            and not settings.is_property_set("goal")
            and (has_method or settings.is_property_set("strength"))
        ):
            settings.goal = "LAMBDA"
        if before >= SCHEMA or not has_method:
            continue
        settings.method_schema = SCHEMA
        if before < 1 and settings.method in FORMER_NAME:
            _renamed[scene.session_uid] = settings.method
    for name in dict.fromkeys(_renamed.values()):
        print(f"SVR-GS: {renaming(name)}", flush=True)


def register():
    bpy.app.handlers.load_post.append(_after_load)


def unregister():
    bpy.app.handlers.load_post.remove(_after_load)
    _renamed.clear()

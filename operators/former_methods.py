"""Says once, for a file of an earlier version, what its pruning method is called now.

A .blend file stores the method as a number of the menu. Every method has kept its number, so an old file keeps its method; only names
have changed. `method_schema` of the scene's settings says which names were in use when the method was chosen: 0 is before the change.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..svrgs_addon.finetune.methods import FORMER_NAMES, METHODS
from .option_properties import menu_name

SCHEMA = 1
FORMER_NAME = {present: former for former, present in FORMER_NAMES.items()}

_sentences: dict[int, str] = {}  # by session_uid of a scene whose method is called otherwise now


def sentence_of(scene: bpy.types.Scene) -> str:
    """What the scene's method is called now, until another method is chosen; empty where its name is the same."""
    return _sentences.get(scene.session_uid, "")


def method_chosen(settings, context):
    """After the user has chosen a method, which is by its present name."""
    settings.method_schema = SCHEMA
    _sentences.pop(settings.id_data.session_uid, None)


def renaming(name: str) -> str:
    """The sentence for a file in which method `name` was chosen under its former name; empty where the name is the same."""
    former = FORMER_NAME.get(name)
    if former is None:
        return ""
    on_command_line = f" ('{name}' on the command line)" if METHODS[name].label else ""
    return f"Method '{former}' of this file is called '{menu_name(METHODS[name])}' now{on_command_line}"


@persistent
def _after_load(*_):
    """Scenes of other files are left out: Blender does not save what is written to them."""
    _sentences.clear()
    for scene in (scene for scene in bpy.data.scenes if not scene.library):
        settings = scene.svrgs_prune
        if settings.method_schema >= SCHEMA or not settings.is_property_set("method"):
            continue
        settings.method_schema = SCHEMA
        if sentence := renaming(settings.method):
            _sentences[scene.session_uid] = sentence
    for sentence in dict.fromkeys(_sentences.values()):
        print(f"SVR-GS: {sentence}", flush=True)


def register():
    bpy.app.handlers.load_post.append(_after_load)


def unregister():
    bpy.app.handlers.load_post.remove(_after_load)
    _sentences.clear()

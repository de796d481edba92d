"""`blender --command svrgs …`: the command line of the product, with the Python and the packages of this Blender."""

from __future__ import annotations

import bpy

from ..svrgs_addon.blender import subprocess_python

_commands = []


def run(words: list[str]) -> int:
    """Exit status of `svrgs WORDS`; stdout and stderr are Blender's."""
    return subprocess_python.run(words, capture=False)[0]


def register():
    _commands.append(bpy.utils.register_cli_command("svrgs", run))


def unregister():
    bpy.utils.unregister_cli_command(_commands.pop())

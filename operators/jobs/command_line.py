"""`blender --command svrgs ...`: the command line of svrgs_addon, run with Blender's Python and packages."""

from __future__ import annotations

import bpy

from ...svrgs_addon.system import subprocess_python

_commands: list = []  # what Blender returned when the command was registered


def run(arguments: list[str]) -> int:
    """Runs `svrgs ARGUMENTS` and returns its exit status. stdout and stderr are those of Blender."""
    return subprocess_python.run(arguments, capture=False)[0]


def register():
    _commands.append(bpy.utils.register_cli_command("svrgs", run))


def unregister():
    bpy.utils.unregister_cli_command(_commands.pop())

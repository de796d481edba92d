"""Blender as a Python module, behind the command line of the program: `python run_as_blender.py -b FILE.blend
--python-expr CODE`.

Like Blender it takes its arguments in their order. Unlike Blender it is always in background mode, and an
error in a script ends it with status 1. The extension is enabled if it is installed in
BLENDER_USER_RESOURCES.
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import bpy

EXTENSION = "bl_ext.user_default.svrgs"
COMMANDS: dict[str, Callable[[list[str]], int]] = {}  # of `blender --command`


def install(words: list[str]) -> int:
    """`--command extension install-file -r user_default -e ZIP`."""
    assert words[:-1] == ["install-file", "-r", "user_default", "-e"], words
    bpy.ops.extensions.package_install_files(filepath=words[-1], repo="user_default", enable_on_install=True)
    print("STATUS Installed")
    return 0


def main(words: list[str]) -> int:
    sys.argv = ["blender", *words]
    COMMANDS["extension"] = install
    bpy.utils.register_cli_command = lambda name, run: COMMANDS.update({name: run})
    bpy.utils.unregister_cli_command = lambda handle: None
    if Path(bpy.utils.user_resource("EXTENSIONS"), "user_default/svrgs").is_dir():
        bpy.ops.preferences.addon_enable(module=EXTENSION)
    own = words[: words.index("--")] if "--" in words else words
    while own:
        word, *own = own
        if word == "--command":
            return COMMANDS[own[0]](own[1:])
        if word == "--python":
            runpy.run_path(own.pop(0), run_name="__main__")
        elif word == "--python-expr":
            exec(own.pop(0), {"__name__": "__main__"})
        elif not word.startswith("-"):
            bpy.ops.wm.open_mainfile(filepath=word)
        elif word not in ("-b", "--background"):
            raise SystemExit(f"run_as_blender.py does not know {word}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

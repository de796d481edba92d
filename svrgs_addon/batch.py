"""The command line inside Blender: `blender -b --python svrgs_addon/batch.py -- prune SCENE… --out DIR`.

It needs nothing but Blender: this file may be that of a checkout whose wheels/ is filled, or that of the
installed extension, enabled or not. It runs under plain Python too.

Any command works. `prune` prints one JSON line per scene and skips finished scenes unless --overwrite is
given. If a scene fails, it reports the scene, continues with the others, and exits with a status that is not
0. The work runs in a child process of Blender's own Python: its libraries cannot conflict with those of
Blender, and a crash cannot end Blender.
"""

import importlib
import signal
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

PACKAGE = "svrgs_addon"


def main() -> int:
    """Starts the child process and waits for it. Returns its exit status."""
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if words[:1] == ["prune"]:
        words = [*words, "--batch"]
    exit_status = part("system.exit_status")
    return exit_status.guarded(
        lambda: run(words), lambda sentence: print(f"svrgs: {sentence}", file=sys.stderr)
    )


def part(name: str):
    """A module of svrgs_addon, whose folder is on no path. A script has no package, so it cannot import
    relatively."""
    if PACKAGE not in sys.modules:
        spec = spec_from_file_location(PACKAGE, Path(__file__).resolve().with_name("__init__.py"))
        assert spec is not None and spec.loader is not None
        sys.modules[PACKAGE] = module_from_spec(spec)
        spec.loader.exec_module(sys.modules[PACKAGE])
    return importlib.import_module(f"{PACKAGE}.{name}")


def run(words: list[str]) -> int:
    wheels, library, processes = map(part, ("system.wheels", "native.library_path", "system.processes"))
    own, extensions = blender_folders()
    found = wheels.find(own, extensions)
    variables = part("system.subprocess_python").environment(found)
    variables[part("system.packages").MISSING_VARIABLE] = wheels.missing(found, extensions)
    unpacked = [found[wheels.NATIVE] / wheels.NATIVE] if wheels.NATIVE in found else []
    variables[library.LIBRARY_VARIABLE] = str(library.library_path(unpacked))
    child = processes.ChildProcess([sys.executable, "-m", "svrgs_addon", *words], env=variables)
    for number in processes.stop_signals():
        signal.signal(number, lambda *_: child.ask_to_stop())
    return child.wait()


def blender_folders() -> tuple[list[Path], list[Path]]:
    """(folders of packages that Blender brings along, folders of this extension in Blender); both empty under
    plain Python.

    Blender as a module has its packages, but not on sys.path. The extension need not be enabled.
    """
    bpy = sys.modules.get("bpy")  # only Blender has imported it already
    if bpy is None:
        return [], []
    python = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    own = Path(bpy.utils.resource_path("LOCAL"), "python", "lib", python, "site-packages")
    extensions = [Path(repo.directory) / "svrgs" for repo in bpy.context.preferences.extensions.repos]
    return [own], [folder for folder in extensions if folder.is_dir()]


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    sys.exit(status)

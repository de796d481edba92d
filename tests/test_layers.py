"""The order of layers and rooms, read from the imports themselves; no circles; short files and functions;
quick commands stay quick."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LAYERS = ("svrgs_addon", "operators", "panels")  # each may import those before it
ROOMS = {  # of a layer, likewise; the files beside them are below them all
    "svrgs_addon": (
        "system", "scene", "native", "files", "views", "render", "finetune", "prune", "jobs", "viewer", "cli",
    ),
    "operators": ("data", "scene", "jobs", "io", "view"),
}  # fmt: skip
TOP = ("__main__.py", "batch.py")  # of svrgs_addon, above every room
FILES = [path for layer in LAYERS for path in sorted((ROOT / layer).rglob("*.py"))]
ALL_FILES = [
    path
    for folder in (*LAYERS, "tests", "benchmarks", "examples", "tools")
    for path in sorted((ROOT / folder).rglob("*.py"))
]
NATIVE_FILES = [path for pattern in ("*.h", "*.cc") for path in sorted((ROOT / "native").rglob(pattern))]
BLENDER = {"bpy", "bmesh", "mathutils", "gpu", "bl_ui"}
HEAVY = {"torch", "pycolmap", "OpenImageIO", "scipy", "bpy"}
MAX_FILE, MAX_FUNCTION = 500, 60  # lines
TABLES = {"benchmarks/svrgs_bench/stress_rows.py: rows"}  # functions that are one long table


@cache
def tree_of(file: Path) -> ast.Module:
    return ast.parse(file.read_text())


def imports(nodes: Iterable[ast.AST], file: Path) -> Iterator[tuple[str, bool]]:
    """(module, relative) of every import among the nodes; a relative one as it is called from the
    repository's root."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((alias.name, False) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module, False
        elif isinstance(node, ast.ImportFrom):
            folder = file.relative_to(ROOT).parts[: -node.level]
            names = [node.module] if node.module else [alias.name for alias in node.names]
            yield from ((".".join((*folder, name)), True) for name in names)


def at_top(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes that run on import: no bodies of functions, nothing for type checkers alone."""
    for_checkers = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    if not for_checkers and not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
        yield node
        for below in ast.iter_child_nodes(node):
            yield from at_top(below)


def label(path: Path) -> str:
    return str(path.relative_to(ROOT))


def check_imports(file: Path):
    layer = LAYERS.index(file.relative_to(ROOT).parts[0])
    tree = tree_of(file)
    for module, relative in imports(ast.walk(tree), file):
        top = module.split(".")[0]
        assert layer > 0 or top not in BLENDER, f"only operators and panels may import {top}"
        assert relative or top not in LAYERS, (
            f"{module} must be imported relatively: the extension's package has another name"
        )
        assert top not in LAYERS[layer + 1 :], f"{module} is above"
        # only svrgs_addon/native/ calls the native library
        assert top != "ctypes" or file.parent.name in ("native", "system")
        assert layer < 2 or top != "svrgs_addon", "panels ask operators/, which asks svrgs_addon/"
        # only operators/data/ turns Blender's data into arrays
        assert layer == 0 or top != "numpy" or file.parent == ROOT / "operators/data"
    if layer == 0 and file.name != "torch_engine.py":
        heavy = {module.split(".")[0] for module, _ in imports(at_top(tree), file)} & HEAVY
        assert not heavy, f"{heavy} must be imported inside functions"


def test_imports():
    broken = {}
    for file in FILES:
        try:
            check_imports(file)
        except AssertionError as error:
            broken[label(file)] = str(error).splitlines()[0]
    assert not broken


def test_the_import_reader_sees_every_form():
    code = (
        "import bpy.types\nfrom torch import nn\nfrom ..panels import x\nfrom .. import operators\ndef f():\n"
        "    import scipy\n"
    )
    tree, file = ast.parse(code), ROOT / "svrgs_addon" / "module.py"
    found = [("bpy.types", False), ("torch", False), ("panels", True), ("operators", True), ("scipy", False)]
    assert list(imports(ast.walk(tree), file)) == found
    assert list(imports(at_top(tree), file)) == found[:-1]


# --- rooms and circles; imports inside functions and for type checkers count too


def module_of(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def import_graph() -> dict[str, set[str]]:
    """The modules of the repository that each module imports."""
    modules, graph = {module_of(file): file for file in FILES}, {}
    for name, file in modules.items():
        found = set()
        for node in ast.walk(tree_of(file)):
            if isinstance(node, ast.ImportFrom) and node.level:
                package = ".".join(
                    (*file.relative_to(ROOT).parts[: -node.level], *filter(None, (node.module,)))
                )
                found |= {
                    f"{package}.{alias.name}" if f"{package}.{alias.name}" in modules else package
                    for alias in node.names
                }
        graph[name] = (found & modules.keys()) - {name}
    return graph


def circles(graph: dict[str, set[str]]) -> list[str]:
    """What is left of the graph when modules that import nothing left are taken away again and again."""
    left = {name: set(found) for name, found in graph.items()}
    while free := {name for name, found in left.items() if not found & left.keys()}:
        left = {name: found for name, found in left.items() if name not in free}
    return sorted(left)


def room_of(file: Path) -> int:
    """Its place in ROOMS; a file of TOP stands above them all."""
    layer, *parts = file.relative_to(ROOT).parts
    rooms = ROOMS[layer]
    return len(rooms) if parts[0] in TOP else rooms.index(parts[0]) if len(parts) > 1 else -1


@pytest.mark.parametrize("layer", ROOMS)
def test_rooms_import_no_room_above(layer):
    files = {module_of(file): file for file in FILES if file.is_relative_to(ROOT / layer)}
    above = {
        module: [
            found for found in import_graph()[module] & files.keys() if room_of(files[found]) > room_of(file)
        ]
        for module, file in files.items()
    }
    assert not {module: found for module, found in above.items() if found}


@pytest.mark.parametrize("layer", LAYERS)
def test_there_is_no_circle(layer):
    # whose register() names what is in them
    packages = {module_of(file) for file in FILES if file.name == "__init__.py"}
    graph = {
        name: found - packages
        for name, found in import_graph().items()
        if name.split(".")[0] == layer and name not in packages
    }
    assert circles(graph) == []


def test_a_circle_would_be_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["a", "b", "c"]
    assert circles({"a": {"b"}, "b": {"c"}, "c": set()}) == []


# --- sizes


def test_files_and_functions_are_short():
    """A function is as long as its one thought. These limits are far above that."""
    long = {}
    for file in [*ALL_FILES, *NATIVE_FILES]:
        long[label(file)] = file.read_text().count("\n") - MAX_FILE
        for node in ast.walk(tree_of(file)) if file.suffix == ".py" else ():
            if isinstance(node, ast.FunctionDef):
                long[f"{label(file)}: {node.name}"] = node.end_lineno - node.lineno + 1 - MAX_FUNCTION
    # lines above the limit
    assert not {name: lines for name, lines in long.items() if lines > 0 and name not in TABLES}


# --- what is loaded


def loaded_after(code: str, *arguments: str) -> set[str]:
    """Modules a fresh Python has loaded after `code`."""
    code += "\nimport sys\nprint(*sys.modules, file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return set(done.stderr.split())


def test_importing_the_package_loads_nothing_heavy():
    loaded = loaded_after("import svrgs_addon")
    assert "svrgs_addon" in loaded and not loaded & (HEAVY | {"numpy"})


def test_info_loads_nothing_heavy(tiny):
    code = "import sys\nfrom svrgs_addon.cli.main import main\nassert main(sys.argv[1:]) == 0"
    loaded = loaded_after(code, "info", str(tiny.splat))
    assert "numpy" in loaded and not loaded & HEAVY
    rooms = ("native.rasterizer", "finetune", "views", "render", "prune.pipeline")
    assert not {f"svrgs_addon.{name}" for name in rooms} & loaded

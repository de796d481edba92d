"""The house's one-way streets, read from the imports themselves, and what a quick command must not wait for."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LAYERS = ("svrgs_addon", "operators", "panels")  # each may import those before it
FILES = [path for layer in LAYERS for path in sorted((ROOT / layer).rglob("*.py"))]
BLENDER = {"bpy", "bmesh", "mathutils", "gpu", "bl_ui"}
HEAVY = {"torch", "pycolmap", "OpenImageIO", "scipy", "bpy"}


def imports(tree: ast.AST, file: Path) -> Iterator[tuple[str, bool]]:
    """(module, relative) of every import below `tree`; a relative one as it is called from the repository's root."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, False) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module, False
        elif isinstance(node, ast.ImportFrom):
            folder = file.relative_to(ROOT).parts[: -node.level]
            names = [node.module] if node.module else [alias.name for alias in node.names]
            yield from ((".".join((*folder, name)), True) for name in names)


def at_top(tree: ast.Module) -> ast.Module:
    """Only the statements that run on import: no bodies of functions, nothing for type checkers alone."""

    class Strip(ast.NodeTransformer):
        def visit_FunctionDef(self, node):
            return None

        visit_AsyncFunctionDef = visit_Lambda = visit_FunctionDef

        def visit_If(self, node):
            return None if ast.unparse(node.test) == "TYPE_CHECKING" else self.generic_visit(node)

    return Strip().visit(tree)


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_imports(file):
    layer = LAYERS.index(file.relative_to(ROOT).parts[0])
    tree = ast.parse(file.read_text())
    for module, relative in imports(tree, file):
        top = module.split(".")[0]
        assert layer > 0 or top not in BLENDER, f"only operators and panels may import {top}"
        assert relative or top not in LAYERS, f"{module} must be imported relatively: the extension's package has another name"
        assert top not in LAYERS[layer + 1 :], f"{module} is above"
        assert top != "ctypes" or file.name in ("native.py", "native_library.py"), "only these two call the native library"
        assert layer < 2 or not relative or module.startswith("panels"), "panels know operators and properties by name"
        assert layer == 0 or top != "numpy" or file.name.startswith("bridge"), "only bridge*.py turn Blender's data into arrays"
    if layer == 0 and file.name != "torch_engine.py":
        heavy = {module.split(".")[0] for module, _ in imports(at_top(tree), file)} & HEAVY
        assert not heavy, f"{heavy} must be imported inside functions"


def test_the_import_reader_sees_every_form():
    code = "import bpy.types\nfrom torch import nn\nfrom ..panels import x\nfrom .. import operators\ndef f():\n    import scipy\n"
    tree, file = ast.parse(code), ROOT / "svrgs_addon" / "module.py"
    found = [("bpy.types", False), ("torch", False), ("panels", True), ("operators", True), ("scipy", False)]
    assert list(imports(tree, file)) == found
    assert list(imports(at_top(tree), file)) == found[:-1]


def loaded_after(code: str, *arguments: str) -> set[str]:
    """Modules a fresh Python has loaded after `code`."""
    code += "\nimport sys\nprint(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return set(done.stderr.split())


def test_importing_the_package_loads_nothing_heavy():
    loaded = loaded_after("import svrgs_addon")
    assert "svrgs_addon" in loaded and not loaded & (HEAVY | {"numpy"})


def test_info_loads_nothing_heavy(tiny):
    loaded = loaded_after("import sys\nfrom svrgs_addon.cli.main import main\nassert main(sys.argv[1:]) == 0", "info", str(tiny.splat))
    assert "numpy" in loaded and not loaded & HEAVY
    assert not {f"svrgs_addon.{name}" for name in ("native", "finetune", "photographs", "render", "jobs.run_job")} & loaded

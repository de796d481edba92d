"""The texts of operators/ and panels/ that a user sees, read from the sources. Without Blender."""

from __future__ import annotations

import ast
import json
import string
from collections.abc import Iterator
from pathlib import Path

TRANSLATED = ("tr", "n_")  # functions whose argument is a text of the catalogues
SHOWN = ("text", "message")  # arguments of Blender's functions that Blender translates
LAYOUT = ("label", "operator", "prop", "menu", "progress", "popover")


def sources(root: Path) -> list[Path]:
    return [file for layer in ("operators", "panels") for file in sorted((root / layer).rglob("*.py"))]


def catalogues(root: Path) -> dict[str, dict[str, str]]:
    """{locale: {English text: translation}}"""
    return {
        file.stem: json.loads(file.read_text("utf-8"))
        for file in sorted((root / "operators/catalogues").glob("*.json"))
    }


def fields(text: str) -> list[str]:
    """The placeholders of a template, sorted."""
    return sorted(
        f"{name}!{conversion}:{spec}"
        for _, name, spec, conversion in string.Formatter().parse(text)
        if name is not None
    )


def called(node: ast.AST) -> str:
    """The name of the function that is called, without what is before it; empty for other nodes."""
    if not isinstance(node, ast.Call):
        return ""
    return (
        node.func.attr
        if isinstance(node.func, ast.Attribute)
        else node.func.id
        if isinstance(node.func, ast.Name)
        else ""
    )


def is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and bool(node.value)


def literals(node: ast.AST) -> Iterator[str]:
    """A text, or both of `one if … else other`."""
    if isinstance(node, ast.IfExp):
        yield from (*literals(node.body), *literals(node.orelse))
    elif is_text(node):
        yield node.value


def messages(tree: ast.AST) -> Iterator[str]:
    """The texts in tr("…") and n_("…"), and those that are given to a layout or to Blender's undo."""
    for node in ast.walk(tree):
        name = called(node)
        if name in TRANSLATED:
            yield from literals(node.args[0])
        elif name in LAYOUT or name == "undo_push":
            yield from (text for word in node.keywords if word.arg in SHOWN for text in literals(word.value))


def of_jobs(root: Path) -> set[str]:
    """What a job says it is doing: the panel translates it where it shows it. Sentences with figures, and
    errors, stay in English."""
    found: set[str] = set()
    for file in [
        *(root / "svrgs_addon/finetune").rglob("*.py"),
        *(root / "svrgs_addon/jobs").glob("job_*.py"),
    ]:
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if called(node) in ("tell", "Phase"):
                found |= {
                    text
                    for word in node.keywords
                    if word.arg in ("text", "label")
                    for text in literals(word.value)
                }
            elif isinstance(node, ast.Dict):
                found |= {
                    text
                    for key, value in zip(node.keys, node.values, strict=True)
                    if is_text(key) and key.value == "text"
                    for text in literals(value)
                }
            elif isinstance(node, ast.FunctionDef) and node.name == "resume_point":
                found |= {
                    text.value for text in ast.walk(node) if is_text(text) and text.value.startswith("Resume")
                }
            elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in (
                "(DECIDE, REMOVE)",
                "self.facts['text']",
                "text",
            ):
                found |= {
                    text for value in getattr(node.value, "elts", [node.value]) for text in literals(value)
                }
    return found


def messages_of(root: Path) -> set[str]:
    return {text for file in sources(root) for text in messages(ast.parse(file.read_text("utf-8")))}

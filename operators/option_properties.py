"""Blender properties of the options of `svrgs prune`, made from svrgs_addon/jobs/options.py, and the methods as a menu."""

from __future__ import annotations

from pathlib import Path

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..svrgs_addon.finetune.methods import METHODS
from ..svrgs_addon.finetune.methods.base import Method
from ..svrgs_addon.jobs.options import PruneOptions
from ..svrgs_addon.option_kinds import options_of

KINDS = {bool: BoolProperty, int: IntProperty, float: FloatProperty, str: StringProperty, Path: StringProperty}
UNSET = {int: 0, float: 0.0, str: "", Path: "", bool: False}  # of an option without a default


def sentence(text: str) -> str:
    """The text as Blender writes tooltips: a capital first, no full stop."""
    return text[:1].upper() + text[1:]


def option_property(name: str, /, **more):
    """The property of one option; more: what the property has beyond the option, or instead of it."""
    option, default = options_of(PruneOptions)[name], PruneOptions.__dataclass_fields__[name].default
    kind = option.kind
    words = {"name": name.replace("_", " ").title(), "description": sentence(option.help), "default": UNSET[kind.type] if default is None else default}
    if kind.type in (int, float):
        words |= {key: value for key, value in (("min", kind.minimum), ("max", kind.maximum)) if value is not None}
    elif kind.type is Path:
        words |= {"subtype": "DIR_PATH"}
    if kind.type in (str, Path):
        words["default"] = str(words["default"])
    if option.default_help and kind.type in (str, Path):
        words["description"] += f". Empty: {option.default_help}"
    return KINDS[kind.type](**(words | more))


def method_property():
    """The menu of methods that prune. Its numbers are stored in .blend files."""
    items = [(name, method.label or name, _about(method), "NONE", method.number) for name, method in METHODS.items() if method.prunes]
    return EnumProperty(name="Method", items=items, default=PruneOptions.method, description="How pruning decides which Gaussians go")


def _about(method: Method) -> str:
    """The tooltip of a method: what it does, and what λ_F means there."""
    lambda_f = f". λ_F: {method.lambda_f_help}" if method.lambda_f_help else ""
    share = f". Keeps {method.share:.0%} unless a goal is set" if method.share else ". Needs a percentage, a count or a size" if method.ranks else ""
    return sentence(method.help) + lambda_f + share

"""Blender properties made from the options of `svrgs prune` (svrgs_addon/jobs/options.py), and the menu of methods."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..svrgs_addon.finetune.methods import METHODS
from ..svrgs_addon.finetune.methods.base import Method
from ..svrgs_addon.jobs.options import PruneOptions
from ..svrgs_addon.option_kinds import options_of

PROPERTY_TYPES = {bool: BoolProperty, int: IntProperty, float: FloatProperty, str: StringProperty, Path: StringProperty}
RELATIVE_PATH = {"options": {"ANIMATABLE", "PATH_SUPPORTS_BLEND_RELATIVE"}} if bpy.app.version >= (4, 5, 0) else {}  # of properties that take '//'
UNSET = {int: 0, float: 0.0, str: "", Path: "", bool: False}  # the default of a property whose option has no default


def option_property(name: str, /, **overrides):
    """The property of one option. overrides: arguments of the property that are not those of the option."""
    option, default = options_of(PruneOptions)[name], PruneOptions.__dataclass_fields__[name].default
    kind = option.kind
    arguments: dict = {
        "name": name.replace("_", " ").title(),
        "description": capitalised(option.help),
        "default": UNSET[kind.type] if default is None else default,
    }
    if kind.type in (int, float):
        arguments |= {key: value for key, value in (("min", kind.minimum), ("max", kind.maximum)) if value is not None}
    elif kind.type is Path:
        arguments |= {"subtype": "DIR_PATH", **RELATIVE_PATH}
    if kind.type in (str, Path):
        arguments["default"] = str(arguments["default"])
    if option.default_help and kind.type in (str, Path):
        arguments["description"] += f". Empty: {option.default_help}"
    return PROPERTY_TYPES[kind.type](**(arguments | overrides))


def method_property(**more):
    """The menu of the methods that prune. Blender stores the number of a method in .blend files. more: further arguments of the property."""
    items = [(name, menu_name(method), _tooltip(method), "NONE", method.number) for name, method in METHODS.items() if method.prunes]
    return EnumProperty(name="Method", items=items, default=PruneOptions.method, description="How pruning decides which Gaussians are removed", **more)


def menu_name(method: Method) -> str:
    """How the menu calls a method."""
    return method.label or method.name


def method_sentence(method: Method) -> str:
    """What the method does."""
    return capitalised(method.help)


def lambda_sentence(method: Method) -> str:
    """What λ_F means in this method; empty where it has none."""
    return f"λ_F: {method.lambda_f_help}" if method.lambda_f_help else ""


def capitalised(text: str) -> str:
    """The text with a capital first letter and no full stop, as Blender writes tooltips."""
    return text[:1].upper() + text[1:]


def _tooltip(method: Method) -> str:
    amount = f"Keeps {method.share:.0%} unless a goal is set" if method.share else "Needs a percentage, a count or a size" if method.ranks else ""
    return ". ".join(filter(None, (method_sentence(method), lambda_sentence(method), amount)))

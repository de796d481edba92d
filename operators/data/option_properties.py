"""Blender properties made from the options of `svrgs prune` (svrgs_addon/prune/options.py), and the menu of
methods."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ...svrgs_addon.finetune.methods import DEFAULT, METHODS, PAPER_METHOD
from ...svrgs_addon.finetune.methods.base import Method
from ...svrgs_addon.prune.options import PruneOptions
from ...svrgs_addon.system.option_kinds import options_of

PROPERTY_TYPES = {
    bool: BoolProperty,
    int: IntProperty,
    float: FloatProperty,
    str: StringProperty,
    Path: StringProperty,
}
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"}  # options of paths that take '//'
if "is_path_supports_blend_relative" not in bpy.types.Property.bl_rna.properties:
    RELATIVE = set()
CHOICES = {"RECOMMENDED": DEFAULT, "PAPER": PAPER_METHOD}  # items of the short menu, except OTHER -> method
# what OTHER chooses first: the nearest to the default at small counts (docs/results.md)
FIRST_OTHER = "maskgs"


def option_property(name: str, /, **overrides):
    """The property of one option. overrides: arguments of the property that are not those of the option."""
    option, default = options_of(PruneOptions)[name], PruneOptions.__dataclass_fields__[name].default
    kind, is_text = option.kind, option.kind.type in (str, Path)
    unset = "" if is_text else kind.type()
    arguments: dict = {
        "name": name.replace("_", " ").title(),
        "description": capitalised(option.help),
        "default": unset if default is None else str(default) if is_text else default,
    }
    if kind.type in (int, float):
        limits = {"min": kind.minimum, "max": kind.maximum}
        arguments |= {key: value for key, value in limits.items() if value is not None}
    if kind.type is Path:
        arguments |= {"subtype": "DIR_PATH", "options": RELATIVE}
    if option.default_help and is_text:
        arguments["description"] += f". Empty: {option.default_help}"
    return PROPERTY_TYPES[kind.type](**(arguments | overrides))


def sh_degree_property(**overrides):
    """The highest SH degree of a result."""
    text = (
        "Highest degree of the spherical harmonics of the result. Each degree less makes a smaller file, or"
        " leaves room for more Gaussians: more texture, less that depends on the view"
    )
    return IntProperty(
        **{"name": "SH Degree", "min": 0, "max": 3, "default": 3, "description": text} | overrides
    )


def limited_time_property():
    """Whether the time of a job is limited."""
    text = (
        "Choose the number of steps so that the job takes at most so many seconds. It is chosen for the speed"
        " of this machine"
    )
    return BoolProperty(name="Limit Time", description=text)


def time_property(default: int):
    """The limit of the time of a job, seconds."""
    return IntProperty(
        name="Seconds",
        min=1,
        soft_max=3600,
        default=default,
        description="Seconds that the job may take, reading and measuring included",
    )


def method_choice_property():
    """The short menu of methods, which shows and sets the property `method`."""
    items = [(key, METHODS[name].label, _tooltip(METHODS[name])) for key, name in CHOICES.items()]
    items.append(
        ("OTHER", "Other…", "One of the methods of other papers and variants. Choose it under Advanced")
    )
    return EnumProperty(
        name="Method",
        items=items,
        get=_choice,
        set=_choose,
        description="How pruning decides which Gaussians are removed",
    )


def _choice(settings) -> int:
    return next(
        (number for number, name in enumerate(CHOICES.values()) if name == settings.method), len(CHOICES)
    )


def _choose(settings, number: int):
    if number != _choice(settings):
        settings.method = [*CHOICES.values(), FIRST_OTHER][number]


def method_property():
    """The menu of the methods that prune. Blender stores the number of a method in .blend files."""
    methods = {name: method for name, method in METHODS.items() if method.prunes}
    items = [(name, one.label, _tooltip(one), "NONE", one.number) for name, one in methods.items()]
    return EnumProperty(
        name="Method",
        items=items,
        default=DEFAULT,
        description="How pruning decides which Gaussians are removed",
    )


def capitalised(text: str) -> str:
    """The text with a capital first letter and no full stop, as Blender writes tooltips."""
    return text[:1].upper() + text[1:]


def _tooltip(method: Method) -> str:
    return ". ".join(
        filter(None, (capitalised(method.help), method.lambda_f_help and f"λ_F: {method.lambda_f_help}"))
    )

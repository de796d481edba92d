"""The formats that a splat can be written in, as items of menus."""

from __future__ import annotations

import bpy

from ...svrgs_addon.files.registry import FORMATS, USUAL
from ...svrgs_addon.files.splat_format import SplatFormat
from . import splat_object

WHAT_FOR = {  # by the names of the formats
    "ply": "Every value as it is. All programs read it",
    "compressed-ply": "A quarter of the size, for about 0.1 dB. Read by SuperSplat, PlayCanvas and Brush",
    "spz": (
        "A tenth of the size, for less than 0.1 dB where cameras are imported. Read by many programs and"
        " by web viewers"
    ),
    "glb": "Every value as it is, in a scene file. Read by glTF programs that know splats",
    "glb-spz": "The values of an SPZ, in a scene file. A draft of a standard, which few programs read yet",
    "usd": (
        "Every value as it is, in a stage. Read by Blender 5.3, Omniverse and other programs that know splats"
    ),
    "sog": (
        "An eighth to a fifteenth of the size, for about 0.1 dB where cameras are imported. Read by"
        " SuperSplat and PlayCanvas"
    ),
    "streamed-sog": "A folder for each splat with all levels, which web viewers load as they need them",
    "splat": "Colours that do not depend on the view. Read by web viewers",
}
KINDS = [(one.name, one.label, WHAT_FOR[one.name]) for one in FORMATS if one.write and one.suffixes]


def format_of(kind: str) -> SplatFormat:
    """The format of an item."""
    return next(one for one in FORMATS if one.name == kind)


def default_kind(obj: bpy.types.Object) -> str:
    """The format of the splat's file; the usual one for a PLY, for one that is not of a file, and for one
    whose format is not written."""
    name, kinds = obj.get(splat_object.FORMAT), [kind for kind, *_ in KINDS]
    return name if name in kinds[1:] else USUAL.name

"""The size of the file that a splat would have, from its own columns: a splat without normals, or with further columns, has another size."""

from __future__ import annotations

import bpy

from ..svrgs_addon.files.registry import foreseen_size
from . import bridge


def size_of(obj: bpy.types.Object, count: int) -> int:
    """Bytes of a file with this many of the splat's Gaussians."""
    return foreseen_size(bridge.sample_scene(obj), count)


def size_text(obj: bpy.types.Object, count: int) -> str:
    """size_of as text."""
    size = size_of(obj, count)
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"


def count_in(obj: bpy.types.Object, size: float) -> int:
    """How many of the splat's Gaussians fit into a file of this many bytes; at least 0."""
    header = size_of(obj, 0)
    return max(0, int((size - header) / (size_of(obj, 1) - header)))

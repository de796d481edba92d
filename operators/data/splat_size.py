"""The size of the file that a splat would have, from its own columns: a splat without normals, or with
further columns, has another size."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files.registry import FORMATS, foreseen_size, sampled_size
from ...svrgs_addon.files.sh_rounding import without_bands
from ...svrgs_addon.files.splat_format import SplatFormat
from ...svrgs_addon.system.errors import SplatError
from . import known, quick_order, splat_object
from .file_kinds import format_of

MOST_READ = 1_000_000  # Gaussians of a splat that is read to foresee the size


def about(obj: bpy.types.Object) -> str:
    """Number of Gaussians and SH degree of a splat."""
    return tr("{count:,} Gaussians, SH degree {degree}").format(
        count=quick_order.count(obj), degree=splat_object.sh_degree(obj)
    )


def size_of(obj: bpy.types.Object, count: int) -> int:
    """Bytes of a PLY with this many of the splat's Gaussians."""
    size = foreseen_size(splat_object.sample_scene(obj), count)
    assert size is not None
    return size


def size_text(obj: bpy.types.Object, count: int) -> str:
    """size_of as text."""
    return file_size_text(size_of(obj, count))


def of_its_file(obj: bpy.types.Object) -> str:
    """The format and the size of the file that the splat was imported from; '' for PLY, or without a file."""
    size = obj.get(splat_object.BYTES)
    label = next((one.label for one in FORMATS[1:] if one.name == obj.get(splat_object.FORMAT)), "")
    if not label or not isinstance(size, float):
        return ""
    return tr("Imported from {format}, {size}").format(format=label, size=file_size_text(size))


def file_size_text(size: float) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"


def size_in(obj: bpy.types.Object, count: int, kind: str, quantise: float = 1.0, degree: int = 3) -> str:
    """What an export says on the size of `count` Gaussians of the splat in the format of this name, with SH
    up to this degree; '' for a large splat whose values decide. quantise: as of write_scene(), for formats
    that take it."""
    splat_format, said = format_of(kind), known.of_data(obj).sizes
    key = count, kind, quantise if splat_format.quantises else 1.0, degree
    if key not in said:
        said[key] = _size_in(obj, count, splat_format, *key[2:])
    return said[key]


def _size_in(
    obj: bpy.types.Object, count: int, splat_format: SplatFormat, quantise: float, degree: int
) -> str:
    size = foreseen_size(without_bands(splat_object.sample_scene(obj), degree), count, splat_format)
    if size is None and count > MOST_READ:
        return ""
    try:
        size = size or sampled_size(
            without_bands(splat_object.scene_from_object(obj), degree), splat_format, quantise
        ) * count // max(1, splat_object.count(obj))
    except SplatError:
        return ""
    return tr("{count:,} Gaussians, about {size:.1f} MB").format(count=count, size=size / 1e6)

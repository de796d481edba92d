"""Names and numbers of SOG version 2 (PlayCanvas): a meta.json and textures in lossless WebP, in a folder or
bundled as a zip.

Gaussian i is pixel i of each texture, row by row.

    means_l, means_u    the low and the high bytes of 16 bits in the range mins to maxs, in which x is stored
                        as sign(x) log(1 + |x|)
    scales, sh0         rows of a table of 256 values: logarithms of scales; SH of degree 0. The alpha of sh0
                        is the opacity, 8 bits
    quats               the three smaller components of (w, x, y, z); alpha is 252 and the position of the
                        largest one
    shN_labels          number of an entry of the palette, 16 bits
    shN_centroids       the palette: 64 entries in a row, a pixel for each coefficient, its channels rows of a
                        table

Axes are those of 3DGS.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np

from .reading import json_object

VERSION = 2
META, SUFFIX = "meta.json", ".sog"
MAX_META = 1_000_000  # bytes of meta.json
TABLE = 256  # values of a table
PALETTE_ROW, MAX_ENTRIES = 64, 1 << 16  # entries of the palette in a row of pixels, and in all
LARGEST_QUAT = 252  # alpha of quats for w
HIGHEST = 65535  # of the 16 bits of a position
ROOT2 = np.float32(2**0.5)


def files_of(meta: Path) -> list[Path]:
    """The meta.json of a SOG in a folder and the textures that it names, of which some may be missing; itself
    alone, if it is none."""
    try:
        contents = json_object(meta, MAX_META) or {}
    except OSError:
        return [meta]
    return [meta, *(meta.parent / name for name in named_in(contents) if (meta.parent / name).is_file())]


def named_in(contents: dict[str, Any]) -> list[str]:
    """The textures that a meta.json names, each once."""
    lists = [part.get("files") for part in contents.values() if isinstance(part, dict)]
    found = itertools.chain(*(names for names in lists if isinstance(names, list)))
    return list(dict.fromkeys(name for name in found if isinstance(name, str) and is_texture(name)))


def is_texture(name: str) -> bool:
    """Whether this is the name of a texture in the same folder."""
    return name.endswith(".webp") and Path(name).name == name and "\\" not in name and "\0" not in name

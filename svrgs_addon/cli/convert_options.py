"""The options of `svrgs convert`. Nothing heavy is imported here: the parser of the command line reads this
file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..system.option_kinds import (
    ANGLES,
    BOX,
    FLAG,
    NUMBER,
    PATH,
    POINT,
    POSITIVE_FLOAT,
    SH_DEGREE,
    SHARE,
    SPZ_VERSION,
    TEXT,
    WEIGHT,
    option,
)

# Of an option: its kind and default, its help text, then the rest.
# fmt: off


@dataclass(frozen=True, kw_only=True)
class ConvertOptions:
    """What is changed on the way. Crop, scale, rotation and move are done in this order; all are in the
    coordinates of 3DGS: x right, y down."""

    to: str = option(
        TEXT, "", "suffix of the outputs, if OUT is a folder", metavar="SUFFIX", default_help="that of OUT"
    )
    sh_degree: int | None = option(
        SH_DEGREE, None, "highest degree of the spherical harmonics that is kept", default_help="all"
    )
    spz_version: int | None = option(
        SPZ_VERSION, None,
        "version of an SPZ: some programs read older ones only",
        default_help="4, and 3 without SH, which Blender 5.3 does not read as 4",
    )
    quantise: float = option(
        POSITIVE_FLOAT, 1.0,
        "factor on the error that an SPZ or SOG may make in spherical harmonics: above 1 for smaller files",
    )
    data: Path | None = option(
        PATH, None,
        "dataset of the splat, of which cameras are read: an SPZ or SOG is rounded by where they see each"
        " Gaussian from, and so are spherical harmonics that are left out; it loses less",
        metavar="DIR",
    )
    box: tuple | None = option(
        BOX, None, "keep only the Gaussians inside the box between two opposite corners"
    )
    scale: float = option(POSITIVE_FLOAT, 1.0, "factor on all lengths, around the origin")
    rotate: tuple = option(ANGLES, (0.0, 0.0, 0.0), "degrees around x, then y, then z", default_help="none")
    move: tuple = option(POINT, (0.0, 0.0, 0.0), "lengths along x, y and z", default_help="none")
    exposure: float = option(NUMBER, 0.0, "stops of light, about: a gain of 2^(stops / 2.2)")
    warmth: float = option(NUMBER, 0.0, "stops of red over blue: above 0 for warmer colours")
    tint: float = option(NUMBER, 0.0, "stops of magenta over green")
    saturation: float = option(WEIGHT, 1.0, "of colours: 0 grey, 1 as it is")
    contrast: float = option(WEIGHT, 1.0, "of colours around middle grey: 1 as it is")
    opacity: float = option(SHARE, 1.0, "factor on the opacity of every Gaussian", metavar="OPACITY")
    overwrite: bool = option(FLAG, False, "with several inputs: write those outputs again that exist")

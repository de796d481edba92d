"""Every method by name, each in its own file; base.py says what a method may do."""

from __future__ import annotations

from copy import copy

from ...errors import SceneError
from . import compact3dgs, gns, lightgaussian, maskgs, pressure, saliency, scores, svr, three_dgs
from .base import Method

PAPER = "svr-paper"  # what `--method svr --paper` stands for; not a name of its own on the command line

METHODS: dict[str, Method] = {
    "svr": pressure.Selection(),
    **svr.VARIANTS,
    "svr-worth": saliency.Differences(),
    **maskgs.VARIANTS,
    "compact3dgs": compact3dgs.Compact3DGS(),
    "gns": gns.GNS(),
    "lightgaussian": lightgaussian.LightGaussian(),
    **scores.VARIANTS,
    "3dgs": three_dgs.ThreeDGS(),
}


def method_named(name: str) -> Method:
    """A method for one run. Raises SceneError for a name that is not among METHODS."""
    if name != PAPER and name not in METHODS:
        raise SceneError(f"method '{name}' is unknown; choose one of {', '.join(METHODS)}")
    return copy(svr.PAPER if name == PAPER else METHODS[name])

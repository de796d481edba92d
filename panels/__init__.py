"""What the user sees: one file per panel. Panels ask functions of operators/ what to show."""

from ..operators import registration
from . import (
    compare,
    engine,
    export,
    jobs,
    overlay,
    panorama,
    preferences,
    prune,
    rendering,
    scene,
    select,
    spatial_mask,
    train,
)

MODULES = (
    preferences,
    scene,
    select,
    overlay,
    train,
    prune,
    jobs,
    spatial_mask,
    compare,
    export,
    rendering,
    engine,
    panorama,
)


def register():
    registration.register(MODULES)


def unregister():
    registration.unregister(MODULES)

"""What the user sees: one file per panel. Panels ask functions of operators/ what to show."""

from importlib import import_module

from ..operators import registration

MODULES = [
    import_module(f".{name}", __name__)
    for name in (
        "preferences",
        "scene",
        "photographs",
        "select",
        "color",
        "overlay",
        "train",
        "prune",
        "jobs",
        "spatial_mask",
        "compare",
        "export",
        "rendering",
        "engine",
        "panorama",
    )
]


def register():
    registration.register(MODULES)


def unregister():
    registration.unregister(MODULES)

"""What the user sees: one file per panel or step. Panels ask functions of operators/ what to show."""

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
        "steps",
        "jobs",
        "spatial_mask",
        "compare",
        "rendering",
        "engine",
        "panorama",
    )
]


def register():
    registration.register(MODULES)


def unregister():
    registration.unregister(MODULES)

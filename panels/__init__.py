"""What the user sees: one file per panel or step. Panels ask functions of operators/ what to show."""

from importlib import import_module

# panels of equal bl_order are shown in this order
NAMES = (
    "preferences", "scene", "photographs", "select", "color", "overlay", "steps", "jobs", "spatial_mask",
    "compare", "rendering", "engine", "panorama",
)  # fmt: skip
MODULES = [import_module(f".{name}", __name__) for name in NAMES]

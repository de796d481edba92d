"""The registry of methods by name. Each file in this folder with a tuple METHODS adds its methods; base.py
defines what a method may do."""

from __future__ import annotations

import importlib
import pkgutil
from copy import copy

from ...system.errors import SceneError
from .base import Method

DEFAULT, PAPER_METHOD = "removal", "svr"


def _discovered() -> dict[str, Method]:
    """All methods by name: the default, that of the paper, those that learn, that rank, the others."""
    modules = (
        importlib.import_module(f"{__name__}.{module.name}") for module in pkgutil.iter_modules(__path__)
    )
    found = [method for module in modules for method in getattr(module, "METHODS", ())]
    first = {DEFAULT: 0, PAPER_METHOD: 1}
    found.sort(key=lambda method: (first.get(method.name, 2), not method.prunes, method.ranks, method.name))
    return {method.name: method for method in found}


METHODS = _discovered()


def method_named(name: str) -> Method:
    """A copy of the method for one run. Raises SceneError for an unknown name."""
    if name not in METHODS:
        raise SceneError(f"method '{name}' is unknown: choose one of {', '.join(METHODS)}")
    return copy(METHODS[name])


def paper_method() -> Method:
    """SVR-GS with the printed settings of the paper, for one run: `--method svr --paper`."""
    from .svr import PAPER

    return copy(PAPER)

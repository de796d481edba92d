"""Fields of C structs, for ctypes."""

from __future__ import annotations

from typing import Any


def fields(*of_types: tuple[Any, str]) -> list[tuple[str, Any]]:
    """The _fields_ of a ctypes.Structure, in the order of the struct. of_types: types, names of fields."""
    return [(name, kind) for kind, names in of_types for name in names.split()]

"""The files of photographs: found by name, with or without extension, and which of them are missing."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ..system.errors import SceneError
from ..system.exit_status import printable

MISSING_SHOWN = 3  # names of missing photographs in a message
MIN_PRESENT = 1 / 3  # share of the photographs that must be there
EXTENSIONS = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")  # that some exporters leave out


def photograph(folder: Path, name: str) -> Path | None:
    """The file of a photograph; None if it is missing. The name may lack one of EXTENSIONS."""
    files = (folder / f"{name}{extension}" for extension in ("", *EXTENSIONS))
    return next(filter(os.path.isfile, files), None)


def present(names: Sequence[str], folder: Path) -> tuple[list[int], tuple[str, ...]]:
    """The numbers of photographs that exist, and a sentence on others. Raises SceneError if too few do."""
    found = [i for i, name in enumerate(names) if photograph(folder, name) is not None]
    missing = [names[i] for i in sorted(set(range(len(names))) - set(found))]
    if not missing:
        return found, ()
    shown = ", ".join(map(printable, missing[:MISSING_SHOWN]))
    shown += ", ..." if len(missing) > MISSING_SHOWN else ""
    sentence = f"{folder}: {len(missing)} of {len(names)} photographs are missing: {shown}"
    if len(found) < MIN_PRESENT * len(names):
        raise SceneError(
            f"{sentence}; at least a third must be there: give the name or path of the folder that holds them"
        )
    return found, (f"{sentence}; the other {len(found)} are used",)

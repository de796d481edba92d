"""Writes named arrays into one .npz file, atomically."""

from __future__ import annotations

import os
import zipfile

import numpy as np

from .atomic import atomic_write


def write_arrays(path: str | os.PathLike, arrays: dict[str, np.ndarray]) -> None:
    """As np.savez, but atomic. Raises SceneError if the file cannot be written.

    The archive is always closed here. After an error, np.savez leaves that to the garbage collector, which
    prints a stack trace.
    """
    with atomic_write(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)

"""Named arrays in one .npz file, which replaces the old one as a whole."""

from __future__ import annotations

import os
import zipfile

import numpy as np

from .atomic import atomic_write


def write_arrays(path: str | os.PathLike, arrays: dict[str, np.ndarray]) -> None:
    """np.savez, but where it cannot be written the archive ends here: NumPy's would end when it is forgotten, with a stack trace on
    the terminal. Raises SceneError.
    """
    with atomic_write(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asanyarray(array), allow_pickle=False)

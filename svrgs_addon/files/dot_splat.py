"""The .splat format of antimatter15's viewer: 32 bytes for each Gaussian, without a header.

float32 mean 3, scale 3 (not logarithms); 8 bits each of red, green, blue, opacity, and of the unit quaternion
(w, x, y, z) from -1 to 1. Axes are those of 3DGS. It has the base colour alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from ..scene import activation
from ..scene.gaussians import SH_C0, Scene
from ..system.errors import FormatError
from .atomic import atomic_write, check_space
from .quantised import (
    alphas_of,
    clipped,
    colors_of_sh,
    logits_of,
    logs_of,
    sh_of_colors,
    to_uint8,
    unit_quats,
)
from .reading import MAX_COUNT, open_splat, refuse_unpacking, rows_at, size_of
from .splat_format import PART, SplatFormat

ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)])


def read_parts(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """The Gaussians in file order, in parts. Raises FormatError, which names the file."""
    with open_splat(path) as file:
        size = size_of(file)
        if size % ROW.itemsize:
            raise FormatError(
                f"is no .splat, or incomplete: its {size:,} bytes are not a multiple of {ROW.itemsize}; copy"
                " or export it again"
            )
        count = size // ROW.itemsize
        refuse_unpacking(count, 1, max_count)
        for start in range(0, max(count, 1), PART):
            yield _scene(rows_at(file, start * ROW.itemsize, ROW, min(PART, count - start)))


def write(path: str | os.PathLike, scene: Scene):
    """Writes the scene atomically, with its Gaussians in their order. Raises SceneError."""
    check_space(path, file_size(scene))
    with atomic_write(path) as file:
        for start in range(0, scene.count, PART):
            file.write(_rows(scene.select(slice(start, start + PART))).data)


def file_size(scene: Scene) -> int:
    """Size in bytes of the file that write() would make."""
    return ROW.itemsize * scene.count


def _scene(rows: np.ndarray) -> Scene:
    quats = (rows["quats"].astype(np.float32) - 128) / 128
    sh = sh_of_colors(rows["rgba"][:, :3].astype(np.float32) / 255)
    return Scene.of(rows["means"], logs_of(rows["scales"]), quats, logits_of(rows["rgba"][:, 3]), sh[:, None])


def _rows(scene: Scene) -> np.ndarray:
    rows = np.empty(scene.count, ROW)
    rows["means"], rows["scales"] = scene.means, activation.scales(scene.log_scales)
    rows["rgba"][:, :3] = to_uint8(255 * colors_of_sh(scene.sh[:, 0]))
    rows["rgba"][:, 3] = alphas_of(scene.opacity_logits)
    rows["quats"] = to_uint8(unit_quats(scene.quats) * 128 + 128)
    return rows


FORMAT = SplatFormat(
    name="splat",
    label=".splat",
    suffixes=(".splat",),
    read_parts=read_parts,
    write=write,
    size=file_size,
    most_degree=0,
    limits=lambda scene: clipped(scene, "a .splat", np.inf, 0.5 / SH_C0),
    carries=("order",),
)

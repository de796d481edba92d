"""What all views see of each Gaussian of a divided scene (VISIBILITY, finetune/decimate/order.py): sums over
views, which any number of tasks make.

What a view sees is a whole number of units. Sums of whole numbers do not depend on their order, so neither
the number of tasks nor that of the blocks changes a bit. A view is rendered with all Gaussians that it may
show, in the order of the file, from wherever they are stored, in colours as it sees them. So the sums equal
those of the scene in memory but for the rounding of colours and of units.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...files.atomic import check_space, write_array
from ...finetune.viewed_scene import reduced
from ...native.rasterizer import VISIBILITY, Rasterizer
from ...render.metrics.evaluate import render_options
from ...scene.camera import Camera
from ...system.errors import FormatError, SceneError
from .divided import Divided, Progress
from .visible import DividedView

UNITS = np.array([{"density": 2.0**-16, "squares": 2.0**-20}.get(name, 2.0**-28) for name in VISIBILITY])
MOST_PIXELS = 1 << 33  # of all views: sums over so many fit into 63 bits, with colours up to 4
# what is left of squares has a column of its own: tiny ones count in costs
SQUARES, REST = VISIBILITY.index("squares"), 2.0**-60
PIXELS_SEEN, COLUMNS = VISIBILITY.index("pixels"), len(VISIBILITY) + 1
SCORES = re.compile(r"scores_(\d+)_of_(\d+)_([0-9a-f]{16})\.npy")


def score(
    divided: Divided, cameras: Sequence[Camera], part: int, parts: int, progress: Progress = lambda *_: None
) -> Path:
    """Looks at the views part, part + parts, part + 2 parts … of the cameras. Writes the sums (N, 10) int64,
    in the order of the file, and the pictures of the views into the folder, and returns the path of the sums.
    Raises SplatError."""
    path = divided.folder / f"scores_{part}_of_{parts}_{_key(divided, cameras)}.npy"
    if not 0 <= part < parts:
        raise SceneError(f"part {part + 1} of {parts}: there is no such part of the views")
    if sum(camera.width * camera.height for camera in reduced(cameras)) > MOST_PIXELS:
        raise SceneError(
            f"{len(cameras):,} views of this size have too many pixels together: give fewer, or smaller ones"
        )
    views, rasterizer = reduced(cameras[part::parts]), Rasterizer()
    pictures = sum(3 * 2 * camera.width * camera.height for camera in views)
    check_space(path, pictures + 8 * COLUMNS * divided.count)
    sums = np.zeros((divided.count, COLUMNS), np.int64)
    for number, camera in enumerate(views):
        progress(f"view {camera.name or number}", number / len(views))
        scene, rows = DividedView(divided, camera, rasterizer).seen()
        picture = rasterizer.forward(scene, camera, render_options(scene))["rgb"]
        write_array(picture_path(divided, part + number * parts), picture.astype(np.float16))
        of_view = np.zeros((scene.count, len(VISIBILITY)))
        rasterizer.add_visibility(of_view)
        blended = of_view[:, PIXELS_SEEN] > 0
        sums[rows[blended]] += whole(of_view[blended], cameras[0].unit)
    write_array(path, sums)
    return path


def picture_path(divided: Divided, view: int) -> Path:
    """Of the picture of a view, (H, W, 3) float16, as score() writes it."""
    return divided.folder / f"{view}.picture.npy"


def units(length: float) -> np.ndarray:
    """(9,) float64: the units of VISIBILITY. length: as for whole()."""
    return np.where(np.array(VISIBILITY) == "density", UNITS / length**2, UNITS)


def whole(sums: np.ndarray, length: float) -> np.ndarray:
    """What is seen, (n, 9) float64 in the order of VISIBILITY, as whole numbers of units, (n, 10) int64.
    length: Camera.unit, in which the unit of density counts."""
    scaled = sums / units(length)
    numbers = np.concatenate([np.rint(scaled), np.zeros((len(sums), 1))], axis=1)
    numbers[:, SQUARES] = np.floor(scaled[:, SQUARES])
    numbers[:, -1] = np.rint((sums[:, SQUARES] - numbers[:, SQUARES] * UNITS[SQUARES]) / REST)
    return numbers.astype(np.int64)


def visibility(numbers: np.ndarray, length: float) -> np.ndarray:
    """Sums of whole numbers (n, 10) as (n, 9) float64. length: as for whole()."""
    sums = numbers[:, :-1] * units(length)
    sums[:, SQUARES] += numbers[:, -1] * REST
    return sums


def total(divided: Divided, cameras: Sequence[Camera]) -> np.ndarray:
    """The sums over all views, (N, 10) int64, of the parts that are in the folder. Raises SceneError if one
    is missing, FormatError for a damaged one."""
    key, found = _key(divided, cameras), dict[int, dict[int, Path]]()
    for path in divided.folder.glob("scores_*.npy"):
        name = SCORES.fullmatch(path.name)
        if name and name[3] == key:
            found.setdefault(int(name[2]), {})[int(name[1])] = path
    complete = [paths for parts, paths in sorted(found.items()) if set(paths) == set(range(parts))]
    if not complete:
        lacking = [f"{parts - len(paths)} of {parts}" for parts, paths in sorted(found.items())]
        raise SceneError(
            f"{divided.folder}: parts of the scores are missing ({', '.join(lacking) or 'all'}); score them"
            " first"
        )
    sums = np.zeros((divided.count, COLUMNS), np.int64)
    for path in complete[0].values():
        sums += _scores(path, divided.count)
    return sums


def _scores(path: Path, count: int) -> np.ndarray:
    try:
        found = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise FormatError(f"{path}: cannot be read ({error}); score this part again") from None
    if found.shape != (count, COLUMNS) or found.dtype != np.int64:
        raise FormatError(f"{path}: is not of this scene; score this part again")
    return found


def _key(divided: Divided, cameras: Sequence[Camera]) -> str:
    """Of the scene and the cameras, in hexadecimal digits: sums of others are not added."""
    digest = hashlib.sha256(divided.digest.encode() + b"".join(camera.key for camera in cameras))
    return digest.hexdigest()[:16]

"""What all views see of each Gaussian of a divided scene (VISIBILITY, decimate/order.py): sums over views, which any number of tasks make.

What a view sees is a whole number of units. Sums of whole numbers do not depend on their order, so neither the number of tasks nor that of the blocks changes
a bit. A view is rendered with all Gaussians that it may show, in the order of the file, from wherever they are stored, in colours as it sees them. So the sums
equal those of the scene in memory but for the rounding of colours and of units.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from .. import memory
from ..camera import Camera
from ..errors import FormatError, SceneError
from ..files.atomic import atomic_write
from ..finetune.saliency import reduced
from ..metrics.evaluate import render_options
from ..native import VISIBILITY, Rasterizer, threads, thresholds
from ..render.quads import colors, recolored
from ..scene import Scene
from .blocks import Block, Divided, Tell

UNITS = np.array([{"density": 2.0**-16, "squares": 2.0**-20}.get(name, 2.0**-28) for name in VISIBILITY])
MOST_PIXELS = 1 << 33  # of all views: sums over so many fit into 63 bits, with colours up to 4
SQUARES, REST = VISIBILITY.index("squares"), 2.0**-60  # what is left of squares has a column of its own: tiny ones count in costs
COLUMNS = len(VISIBILITY) + 1
SCORES = re.compile(r"scores_(\d+)_of_(\d+)_([0-9a-f]{16})\.npy")
SHAPES = {"means": (3,), "log_scales": (3,), "quats": (4,), "opacity_logits": (), "sh": (1, 3)}  # of a Gaussian in one colour
SIGMAS, PIXELS, SLACK = 3.34, 2.0, 1e-3  # how far a Gaussian is seen, in its largest scale and in pixels; share of its distance that rounding may change
PART = 1 << 18  # Gaussians that are tested together
ROW = 3 * 4 * 14  # bytes of a Gaussian in one colour: its values, and copies while they are put in order


def score(divided: Divided, cameras: Sequence[Camera], part: int, parts: int, tell: Tell = lambda *_: None) -> Path:
    """Looks at the views part, part + parts, part + 2 parts … of the cameras. Writes the sums (N, 10) int64, in the order of the file, into the
    folder, and returns the path. Raises SplatError."""
    path = divided.folder / f"scores_{part}_of_{parts}_{_key(divided, cameras)}.npy"
    if not 0 <= part < parts:
        raise SceneError(f"part {part + 1} of {parts}: there is no such part of the views")
    if sum(camera.width * camera.height for camera in reduced(cameras)) > MOST_PIXELS:
        raise SceneError(f"{len(cameras):,} views of this size have too many pixels together: give fewer, or smaller ones")
    sums, views, rasterizer = np.zeros((divided.count, COLUMNS), np.int64), reduced(cameras[part::parts]), Rasterizer()
    for number, camera in enumerate(views):
        tell(f"view {camera.name or number}", number / len(views))
        scene, rows = seen(divided, camera)
        rasterizer.forward(scene, camera, render_options(scene), outputs=())
        of_view = np.zeros((scene.count, len(VISIBILITY)))
        rasterizer.add_visibility(of_view)
        sums[rows] += whole(of_view)
    with atomic_write(path) as file:
        np.save(file, sums)
    return path


def whole(sums: np.ndarray) -> np.ndarray:
    """What is seen, (n, 9) float64 in the order of VISIBILITY, as whole numbers of units, (n, 10) int64."""
    scaled = sums / UNITS
    numbers = np.concatenate([np.rint(scaled), np.zeros((len(sums), 1))], axis=1)
    numbers[:, SQUARES] = np.floor(scaled[:, SQUARES])
    numbers[:, -1] = np.rint((sums[:, SQUARES] - numbers[:, SQUARES] * UNITS[SQUARES]) / REST)
    return numbers.astype(np.int64)


def visibility(numbers: np.ndarray) -> np.ndarray:
    """Sums of whole numbers (n, 10) as (n, 9) float64."""
    sums = numbers[:, :-1] * UNITS
    sums[:, SQUARES] += numbers[:, -1] * REST
    return sums


def seen(divided: Divided, camera: Camera) -> tuple[Scene, np.ndarray]:
    """The Gaussians that a view may show, in the order of the file, in colours as it sees them (SH degree 0), and their rows in the file (n,). Raises
    SplatError."""
    near = [block for block in divided.blocks if _may_show(block, camera)]
    with ThreadPoolExecutor(threads()) as pool:
        found = list(zip(near, pool.map(lambda block: _rows_in(block, camera), near), strict=True))
        count = sum(len(some) for _, some in found)
        needed = memory.rendering(count, camera.width, camera.height) + ROW * count
        memory.refuse_excess(f"{divided.source}: rendering the {count:,} Gaussians of the view {camera.name}", needed)
        parts = list(pool.map(lambda one: _colored(one[0], one[1], divided, camera), found))
    rows = np.concatenate([block.rows[some] for block, some in found]) if found else np.zeros(0, np.uint32)
    order = np.argsort(rows, kind="stable")
    empty = {name: np.zeros((0, *width), np.float32) for name, width in SHAPES.items()}
    arrays: dict[str, Any] = {name: np.concatenate([one[name] for one in parts or [empty]])[order] for name in empty}
    return Scene(**arrays, antialiased=divided.antialiased), rows[order]


def total(divided: Divided, cameras: Sequence[Camera]) -> np.ndarray:
    """The sums over all views, (N, 10) int64, of the parts that are in the folder. Raises SceneError if one is missing, FormatError for a damaged
    one."""
    key, found = _key(divided, cameras), dict[int, dict[int, Path]]()
    for path in divided.folder.glob("scores_*.npy"):
        name = SCORES.fullmatch(path.name)
        if name and name[3] == key:
            found.setdefault(int(name[2]), {})[int(name[1])] = path
    complete = [paths for parts, paths in sorted(found.items()) if set(paths) == set(range(parts))]
    if not complete:
        lacking = [f"{parts - len(paths)} of {parts}" for parts, paths in sorted(found.items())]
        raise SceneError(f"{divided.folder}: parts of the scores are missing ({', '.join(lacking) or 'all'}); score them first")
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
    return hashlib.sha256(divided.digest.encode() + b"".join(camera.key for camera in cameras)).hexdigest()[:16]


def _may_show(block: Block, camera: Camera) -> bool:
    """Whether a view may show a Gaussian of the block: not, if the ball around its box, with all its Gaussians, is outside."""
    middle, half = (block.low + block.high) / 2, np.linalg.norm(block.high - block.low) / 2
    return bool(_near_view(middle[None].astype(np.float64), np.array([half + SIGMAS * np.exp(float(block.largest))]), camera)[0])


def _rows_in(block: Block, camera: Camera) -> np.ndarray:
    """The places in the block of the Gaussians that a view may show, ascending."""
    found = []
    for start in range(0, block.count, PART):
        geometry = block.geometry[start : start + PART]
        radius = SIGMAS * np.exp(np.maximum(np.maximum(geometry[:, 3], geometry[:, 4]), geometry[:, 5]).astype(np.float64))
        found.append(start + np.flatnonzero(_near_view(geometry[:, :3].astype(np.float64), radius, camera)))
    return np.concatenate(found) if found else np.zeros(0, np.int64)


def _near_view(points: np.ndarray, radius: np.ndarray, camera: Camera) -> np.ndarray:
    """Whether balls (n,) around points (n, 3) may touch the view, (n,) bool. It leaves room for what the rasterizer adds: it widens what a slanting ray
    meets, and adds a blur."""
    x, y, z = camera.viewmat[:3, :3] @ points.T + camera.viewmat[:3, 3:]
    depth = np.ones_like(z) if camera.orthographic else np.maximum(z, thresholds().near)
    front = z + radius + SLACK * np.abs(z) > thresholds().near
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    stretch = 1.0 if camera.orthographic else 1 + camera.width / fx + camera.height / fy  # more than 1 / cos of any ray, also of balls behind the camera
    reach = radius * max(fx, fy) * stretch / depth + PIXELS
    slack = SLACK * (np.abs(x) * fx + np.abs(y) * fy) / depth
    u, v = x * fx / depth + cx, y * fy / depth + cy
    reach = reach + slack
    return front & (u + reach > 0) & (u - reach < camera.width) & (v + reach > 0) & (v - reach < camera.height)


def _colored(block: Block, some: np.ndarray, divided: Divided, camera: Camera) -> dict[str, np.ndarray]:
    """These Gaussians of a block in the colours that the camera sees: the arrays of a scene."""
    geometry = block.geometry[some]
    parts = {"means": geometry[:, :3], "log_scales": geometry[:, 3:6], "quats": geometry[:, 6:10], "opacity_logits": geometry[:, 10]}
    arrays: dict[str, Any] = {name: np.ascontiguousarray(array) for name, array in parts.items()}
    sh = np.empty((len(some), 1, 3), np.float32)
    for start in range(0, len(some), PART):
        rows = some[start : start + PART]
        one = Scene(**{name: array[start : start + PART] for name, array in arrays.items()}, sh=block.sh(divided.coefficients)[rows])
        sh[start : start + PART] = recolored(one, colors(one, np.arange(one.count), camera)).sh
    return arrays | {"sh": sh}

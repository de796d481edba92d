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
from dataclasses import replace
from pathlib import Path

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
from .blocks import WIDTH, Block, Divided, Tell, arrays_of

UNITS = np.array([{"density": 2.0**-16, "squares": 2.0**-20}.get(name, 2.0**-28) for name in VISIBILITY])
MOST_PIXELS = 1 << 33  # of all views: sums over so many fit into 63 bits, with colours up to 4
SQUARES, REST = VISIBILITY.index("squares"), 2.0**-60  # what is left of squares has a column of its own: tiny ones count in costs
PIXELS_SEEN, COLUMNS = VISIBILITY.index("pixels"), len(VISIBILITY) + 1
SCORES = re.compile(r"scores_(\d+)_of_(\d+)_([0-9a-f]{16})\.npy")
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
        scene, rows = seen(divided, camera, rasterizer)
        rasterizer.forward(scene, camera, render_options(scene), outputs=())
        of_view = np.zeros((scene.count, len(VISIBILITY)))
        rasterizer.add_visibility(of_view)
        blended = of_view[:, PIXELS_SEEN] > 0
        sums[rows[blended]] += whole(of_view[blended])
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


def seen(divided: Divided, camera: Camera, rasterizer: Rasterizer) -> tuple[Scene, np.ndarray]:
    """The Gaussians that a view may show, in the order of the file, in colours as it sees them (SH degree 0), and their rows in the file (n,). Those that
    the view does not blend, which are behind others or too small, have no colours: theirs are not read. Raises SplatError."""
    near = [block for block in divided.blocks if _may_show(block, camera)]
    with ThreadPoolExecutor(threads()) as pool:
        places = list(pool.map(lambda block: _rows_in(block, camera), near))
        count = sum(map(len, places))
        needed = memory.rendering(count, camera.width, camera.height) + ROW * count
        memory.refuse_excess(f"{divided.source}: rendering the {count:,} Gaussians of the view {camera.name}", needed)
        geometry = _joined(list(pool.map(lambda block, some: block.geometry[some], near, places)), (WIDTH,))
        rows = _joined([block.rows[some] for block, some in zip(near, places, strict=True)], ()).astype(np.uint32)
        order = np.argsort(rows, kind="stable")
        scene = Scene(**arrays_of(geometry[order]), sh=np.zeros((count, 1, 3), np.float32), antialiased=divided.antialiased)
        del geometry  # of a view of a town, gigabytes
        blended = np.empty(count, bool)
        blended[order] = _blended(scene, camera, rasterizer)
        ends = np.cumsum([0, *map(len, places)])
        parts = [some[blended[start:end]] for some, start, end in zip(places, ends, ends[1:], strict=False)]
        sh = np.zeros((count, 1, 3), np.float32)
        sh[blended] = _joined(list(pool.map(lambda block, some: _colors(block, some, divided, camera), near, parts)), (1, 3))
    return replace(scene, sh=sh[order]), rows[order]


def _joined(parts: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    return np.concatenate(parts) if parts else np.zeros((0, *shape), np.float32)


def _blended(scene: Scene, camera: Camera, rasterizer: Rasterizer) -> np.ndarray:
    """Which Gaussians the view blends into a pixel, (n,) bool. It does not depend on colours."""
    pixels = np.zeros(scene.count, np.int64)
    rasterizer.forward(scene, camera, render_options(scene), outputs=())
    rasterizer.add_scores(np.zeros(scene.count), np.zeros(scene.count, np.float32), pixels)
    return pixels > 0


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


def _colors(block: Block, some: np.ndarray, divided: Divided, camera: Camera) -> np.ndarray:
    """The colours of these Gaussians of a block as the camera sees them, as SH of degree 0, (n, 1, 3) float32."""
    sh = np.empty((len(some), 1, 3), np.float32)
    for start in range(0, len(some), PART):
        rows = some[start : start + PART]
        one = Scene(**arrays_of(block.geometry[rows]), sh=block.sh(divided.coefficients)[rows])
        sh[start : start + PART] = recolored(one, colors(one, np.arange(one.count), camera)).sh
    return sh

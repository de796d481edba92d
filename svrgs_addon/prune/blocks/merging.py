"""Merges and removes in a divided scene: each cell has an order of operations (finetune/decimate/order.py),
and one cost for the whole scene says how far each goes.

Cells are small parts of the k-d tree whose large parts are the blocks. So the same Gaussians are merged
whatever the number of blocks, if these are not smaller than cells. Beside the blocks lie

    NUMBER.visibility   float64, 9 for each Gaussian: the sums over all views
    NUMBER.order.npz    the operations on its cells and their costs, down to MIN_SHARE_OF_CELL
                        of each cell; steps: their number for each cell
    reduced.json        a point and a length of about a pixel, of the whole scene; what the views see
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...files.atomic import check_space, write_arrays, write_bytes, write_json
from ...files.reading import json_object
from ...files.registry import too_faint
from ...finetune.decimate.order import Order, hidden
from ...finetune.scores import top
from ...native.decimation import REMOVED, Merges, decimate
from ...native.rasterizer import VISIBILITY
from ...scene.camera import Camera
from ...scene.concatenate import concatenated
from ...scene.gaussians import PARAMETERS, Scene
from ...system.errors import FormatError, SceneError
from ..belonging import Seen
from .divided import OPACITY, Block, Divided, Progress, leaves, scene_of
from .scoring import SQUARES, total, units, visibility

REDUCED, MIN_SHARE_OF_CELL = "reduced.json", 0.01
CELL = 1 << 16  # Gaussians of a cell, at most
MOST_LOST = 0.01  # share of the Gaussians that are seen, but too thinly for the units of their sums
OPERATIONS = ("a", "b", "costs")  # arrays of Merges
NEEDED = "reduce the scores first"


def reduce(divided: Divided, cameras: Sequence[Camera]):
    """Adds the parts of the scores and writes those of each block. Raises SplatError."""
    sums = total(divided, cameras)
    columns = dict(zip(VISIBILITY, sums.T, strict=False))
    seen = columns["views"] > 0
    if not seen.any():
        raise SceneError(
            f"{divided.source}: no view sees any of its Gaussians: the cameras belong to another scene"
        )
    check_space(divided.folder / REDUCED, 8 * sums.size)
    length = cameras[0].unit
    unit = dict(zip(VISIBILITY, units(length), strict=True))
    views, density = (columns[name][seen] * unit[name] for name in ("views", "density"))
    if not (density > 0).mean() > 1 - MOST_LOST:  # sums of whole units: none is left, or too many
        raise SceneError(
            f"{divided.source}: its coordinates are too large or too small to be pruned by blocks: scale it"
            " first (svrgs convert --scale)"
        )
    pixel = float(np.median(np.sqrt(views[density > 0] / density[density > 0])))
    drawn, unseen = 0, 0
    for block in divided.blocks:
        values = visibility(sums[block.rows], length)
        write_bytes(divided.folder / f"{block.number}.visibility", values.data)
        visible = ~too_faint(block.geometry[:, OPACITY])
        drawn, unseen = drawn + int(visible.sum()), unseen + hidden(values[visible])
    means = np.concatenate([block.geometry[seen[block.rows], :3] for block in divided.blocks])
    middle = [float(np.median(means[:, axis])) for axis in range(3)]
    facts = {"pixel": pixel, "middle": middle, "seen": 1 - unseen / max(1, drawn), "views": len(cameras)}
    write_json(divided.folder / REDUCED, facts)


def merge(divided: Divided, number: int):
    """Orders the operations on the cells of the block with this number, and writes them. Raises
    SplatError."""
    if not 0 <= number < len(divided.blocks):
        raise SceneError(f"{divided.folder}: has no block {number}, only 0 to {len(divided.blocks) - 1}")
    block, (pixel, middle, _) = divided.blocks[number], _reduced(divided)
    scene, sums = scene_of(divided, block), _visibility(block)
    found = [
        decimate(scene.select(rows), sums[rows], middle, pixel, max(1, round(MIN_SHARE_OF_CELL * len(rows))))
        for rows in _cells(block)
    ]
    arrays = {name: np.concatenate([getattr(one, name) for one in found]) for name in OPERATIONS}
    results = {name: np.concatenate([one.results[name] for one in found]) for name in PARAMETERS}
    write_arrays(_order_path(block), {"steps": np.array([len(one.a) for one in found]), **arrays, **results})


def counts(divided: Divided, wanted: int) -> list[list[int]]:
    """How many Gaussians each cell of each block keeps, so that together they are `wanted`, or as few as the
    orders allow: operations are done whose cost, or that of one before them in the cell, is below one bound.
    Raises SplatError."""
    cells = [[len(rows) for rows in _cells(block)] for block in divided.blocks]
    costs = [
        np.maximum.accumulate(one)
        for block, some in zip(divided.blocks, cells, strict=True)
        for one in _costs(block, some)
    ]
    most = sum(map(len, costs))
    steps = min(max(divided.count - wanted, 0), most)
    if not steps:
        return cells
    bound = np.partition(np.concatenate(costs), steps - 1)[steps - 1]
    done = [int(np.searchsorted(one, bound, "left")) for one in costs]
    spare = steps - sum(done)
    for number, one in enumerate(costs):  # of operations at the bound, as many as are still needed
        more = min(spare, int(np.searchsorted(one, bound, "right")) - done[number])
        done[number], spare = done[number] + more, spare - more
    left = iter(done)
    return [[count - next(left) for count in some] for some in cells]


def merged(
    divided: Divided, kept: Sequence[Sequence[int]], progress: Progress = lambda *_: None
) -> Iterator[Scene]:
    """What is left of each block, cell after cell. kept: from counts(). Raises SplatError."""
    for block, wanted in zip(divided.blocks, kept, strict=True):
        progress("writes what stays", block.number / len(divided.blocks))
        scene = scene_of(divided, block)
        cells = zip(_cells(block), _merges(block), wanted, strict=True)
        yield concatenated(
            [Order(scene.select(rows), one).at(count) for rows, one, count in cells], columns=True
        )


def most_needed(divided: Divided, wanted: int, progress: Progress = lambda *_: None) -> Iterator[Scene]:
    """The `wanted` Gaussians of highest removal error (finetune/saliency.py), block after block; of each
    block one at least. Raises SplatError."""
    # a view would keep all columns in memory
    errors = [_visibility(block)[:, SQUARES].copy() for block in divided.blocks]
    stays = np.split(
        top(np.concatenate(errors), wanted), np.cumsum([block.count for block in divided.blocks])[:-1]
    )
    for block, error, some in zip(divided.blocks, errors, stays, strict=True):
        progress("writes what stays", block.number / len(divided.blocks))
        some[np.argmax(error)] = True
        yield scene_of(divided, block).select(np.flatnonzero(some))


def _cells(block: Block) -> list[np.ndarray]:
    """The places in the block of the Gaussians of each of its cells, ascending."""
    return list(leaves(block.geometry[:, :3], np.arange(block.count), CELL))


def _costs(block: Block, counts: Sequence[int]) -> list[np.ndarray]:
    """The costs of the operations on each cell. counts: of its Gaussians."""
    arrays = _order(block, ("steps", "costs"))
    if (
        len(arrays["steps"]) != len(counts)
        or (arrays["steps"] >= counts).any()
        or arrays["steps"].sum() != len(arrays["costs"])
    ):
        raise FormatError(f"{_order_path(block)}: is not of this block; merge it again")
    return np.split(arrays["costs"], np.cumsum(arrays["steps"])[:-1])


def _merges(block: Block) -> Iterator[Merges]:
    """The operations on each cell."""
    arrays = _order(block, ("steps", *OPERATIONS, *PARAMETERS))
    ends = np.cumsum(arrays["steps"])
    made = np.cumsum([0, *(np.count_nonzero(one != REMOVED) for one in np.split(arrays["b"], ends[:-1]))])
    if len(arrays["means"]) != made[-1]:
        raise FormatError(f"{_order_path(block)}: is damaged; merge it again")
    for start, end, first, last in zip(ends - arrays["steps"], ends, made, made[1:], strict=False):
        a, b, costs = (arrays[name][start:end] for name in OPERATIONS)
        yield Merges(a, b, costs, {name: arrays[name][first:last] for name in PARAMETERS})


def with_seen(divided: Divided, result: dict[str, Any]) -> dict[str, Any]:
    """The JSON result, with what the views see of the scene. Raises SplatError before reduce()."""
    seen = _reduced(divided)[2]
    return result | seen.facts() | {"notes": [seen.sentence(), *result["notes"]]}


def _reduced(divided: Divided) -> tuple[float, np.ndarray, Seen]:
    path = divided.folder / REDUCED
    try:
        found = json_object(path, 1 << 16) or {}
        middle = np.array(found["middle"], np.float64).reshape(3)
        return float(found["pixel"]), middle, Seen(float(found["seen"]), int(found["views"]))
    except OSError:
        raise SceneError(f"{path}: is not there; {NEEDED}") from None
    except (KeyError, TypeError, ValueError):
        raise FormatError(f"{path}: is damaged; {NEEDED}") from None


def _visibility(block: Block) -> np.ndarray:
    path = block.folder / f"{block.number}.visibility"
    try:
        return np.fromfile(path, np.float64).reshape(block.count, len(VISIBILITY))
    except (OSError, ValueError) as error:
        raise FormatError(f"{path}: cannot be read ({error}); {NEEDED}") from None


def _order(block: Block, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Arrays of the operations on a block. Raises SplatError."""
    try:
        with np.load(_order_path(block), allow_pickle=False) as stored:
            return {name: stored[name] for name in names}
    except FileNotFoundError:
        raise SceneError(
            f"{_order_path(block)}: is not there; merge the block {block.number} first"
        ) from None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise FormatError(f"{_order_path(block)}: cannot be read ({error}); merge the block again") from None


def _order_path(block: Block) -> Path:
    return block.folder / f"{block.number}.order.npz"

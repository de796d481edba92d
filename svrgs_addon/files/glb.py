"""glTF 2.0 in one binary file (.glb), with the extension KHR_gaussian_splatting as Khronos ratified it: all
values as float32.

A primitive of points has the attributes POSITION, ROTATION (x, y, z, w), SCALE (not logarithms), OPACITY (0
to 1) and SH_DEGREE_l_COEF_n. Axes are right, up, back. All such primitives of a scene are read, moved as
their nodes say; what else is in the file is ignored. A primitive whose values are packed as an SPZ (a draft,
glb_spz.py) is read too.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..scene import activation
from ..scene.concatenate import concatenated
from ..scene.gaussians import SH_COEFFICIENTS, Scene
from ..scene.rotations import rotation_matrices
from ..system.errors import FormatError
from . import spz
from .atomic import atomic_write, check_space
from .axes import AXES, placed, turned_around, turned_over
from .glb_container import Glb, glb_of
from .quantised import colors_of_sh, logits_of_opacities, logs_of, opacities_of, to_uint8, unit_quats
from .reading import MAX_COUNT, open_splat, refuse_whole
from .splat_format import PART, SplatFormat

EXTENSION = "KHR_gaussian_splatting"
# names of the draft; the first one is written
PACKED = (f"{EXTENSION}_compression_spz_2", f"{EXTENSION}_compression_spz")
COLORS = "srgb_rec709_display"  # display-referred, as in training
FLOAT, BYTE = 5126, 5121  # types of components
MAX_NODES, MAX_PACKED = 20_000, 64  # nodes, and packed splats in a file


def read_parts(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """All Gaussians as one part. Raises FormatError, which names the file."""
    with open_splat(path) as file:
        glb = Glb.read(file)
        found = list(_placed(glb))
        if not found:
            raise FormatError(f"holds no splat: no points with the extension {EXTENSION}")
        unpacked = _unpacked(glb, {splat.view for splat, _ in found} - {None}, min(max_count, MAX_COUNT))
        counts, degrees = zip(*(_count_and_degree(glb, splat, unpacked) for splat, _ in found), strict=True)
        refuse_whole(sum(counts), SH_COEFFICIENTS[max(degrees)], max_count)
        scene = placed(((_scene(glb, splat, unpacked), matrix) for splat, matrix in found), "node")
    yield scene


def write(path: str | os.PathLike, scene: Scene):
    """Writes the scene atomically, with its Gaussians in their order. Raises SceneError."""
    head, lengths = _head(scene)
    check_space(path, file_size(scene))
    starts = len(head) + np.cumsum([0, *lengths])
    with atomic_write(path) as file:
        file.write(head)
        for first in range(0, scene.count, PART):
            arrays = _arrays(scene.select(slice(first, first + PART)))
            for start, length, array in zip(starts, lengths, arrays.values(), strict=False):
                file.seek(int(start) + length // scene.count * first)
                file.write(np.ascontiguousarray(array).data)


def file_size(scene: Scene) -> int:
    """Size in bytes of the file that write() would make."""
    head, lengths = _head(scene)
    return len(head) + sum(lengths)


def _head(scene: Scene) -> tuple[bytes, list[int]]:
    """What is before the arrays, and the length of each in bytes."""
    arrays = _arrays(scene.select(slice(0)))
    lengths = [
        scene.count * array.dtype.itemsize * int(np.prod(array.shape[1:])) for array in arrays.values()
    ]
    return glb_of(contents(scene), lengths), lengths


def _arrays(scene: Scene) -> dict[str, np.ndarray]:
    """The attributes of these Gaussians."""
    scene = turned_over(scene)
    opacities = opacities_of(scene.opacity_logits).astype("<f4")
    arrays = {
        "POSITION": scene.means,
        "COLOR_0": to_uint8(255 * np.column_stack([colors_of_sh(scene.sh[:, 0]), opacities])),
        f"{EXTENSION}:ROTATION": np.roll(unit_quats(scene.quats), -1, axis=1),
        f"{EXTENSION}:SCALE": activation.scales(scene.log_scales),
        f"{EXTENSION}:OPACITY": opacities,
    }
    return arrays | {f"{EXTENSION}:{name}": scene.sh[:, k] for name, k in _coefficients(scene.sh_degree)}


def contents(scene: Scene) -> dict[str, Any]:
    """The JSON of a mesh with the Gaussians as points, without buffers; a view for each accessor."""
    ends = [np.zeros(3), np.zeros(3)]
    if scene.count:
        ends = [scene.means.min(axis=0) * AXES, scene.means.max(axis=0) * AXES]
    bounds, arrays = [np.minimum(*ends).tolist(), np.maximum(*ends).tolist()], _arrays(scene.select(slice(0)))
    accessors: list[dict[str, Any]] = []
    for number, (name, array) in enumerate(arrays.items()):
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[array.shape[1] if array.ndim > 1 else 1]
        accessor = {"bufferView": number, "componentType": FLOAT, "count": scene.count, "type": kind}
        if array.dtype == np.uint8:
            accessor |= {"componentType": BYTE, "normalized": True}
        if name == "POSITION":
            accessor |= dict(zip(("min", "max"), bounds, strict=True))
        accessors.append(accessor)
    primitive = {
        "attributes": {name: number for number, name in enumerate(arrays)}, "mode": 0,
        "extensions": {EXTENSION: {"kernel": "ellipse", "colorSpace": COLORS}},
    }  # fmt: skip
    whole = {
        "asset": {"version": "2.0", "generator": "SVR-GS"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
    }
    return whole | {"nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}], "accessors": accessors}


def _coefficients(degree: int) -> list[tuple[str, int]]:
    """(name without the extension, number of the coefficient) of all SH coefficients up to a degree."""
    return [(f"SH_DEGREE_{d}_COEF_{n}", d * d + n) for d in range(degree + 1) for n in range(2 * d + 1)]


@dataclass(frozen=True)
class _Splat:
    """What a primitive says of its Gaussians."""

    attributes: dict[str, Any]  # accessors by name
    view: int | None  # the buffer view with an SPZ that has all values; None: the accessors have them
    names_kernel: bool  # as all but the first drafts do

    @property
    def degree(self) -> int:
        """The highest degree of SH of which all coefficients are there."""
        complete = lambda degree: all(
            f"{EXTENSION}:{name}" in self.attributes for name, _ in _coefficients(degree)
        )
        return max(filter(complete, range(4)), default=0)


def _placed(glb: Glb) -> Iterator[tuple[_Splat, np.ndarray]]:
    """(splat, matrix to the world) of each one in the scene. Raises FormatError (without the name of the
    file), as the functions below."""
    nodes, meshes, scenes = glb.items("nodes"), glb.items("meshes"), glb.items("scenes")
    roots = list(range(len(nodes)))
    if scenes:
        roots = _list_of(glb.of(scenes, glb.contents.get("scene", 0)), "nodes")
    left, seen = [(number, np.eye(4)) for number in roots], set[int]()
    while left:
        number, above = left.pop()
        node = glb.of(nodes, number)
        if number in seen or len(seen) == MAX_NODES:
            raise FormatError(
                f"has more than {MAX_NODES:,} nodes, or some below themselves or below two others; export it"
                " again"
            )
        seen.add(number)
        children = _list_of(node, "children")
        if "mesh" not in node and not children:
            continue
        matrix = above @ _matrix(node)
        left += [(child, matrix) for child in children]
        if "mesh" in node:
            found = map(_splat_of, _list_of(glb.of(meshes, node["mesh"]), "primitives"))
            yield from ((splat, matrix) for splat in found if splat)


def _list_of(found: dict, name: str) -> list:
    """A list of an object; empty if it has none, or something else in its place."""
    values = found.get(name, [])
    return values if isinstance(values, list) else []


def _splat_of(primitive: Any) -> _Splat | None:
    """The splat of a primitive; None if it is none."""
    extensions = primitive.get("extensions") if isinstance(primitive, dict) else None
    splat = extensions.get(EXTENSION) if isinstance(extensions, dict) else None
    if not isinstance(splat, dict):
        return None
    inner, view = splat.get("extensions"), None
    if isinstance(inner, dict) and inner:
        packed = [inner[name] for name in PACKED if name in inner]
        if not packed:
            names = ", ".join(sorted(re.sub(r"\W", "?", name)[:60] for name in inner))
            raise FormatError(
                f"holds a splat that is packed by {names}, which is not read; export it without"
            )
        view = packed[0].get("bufferView") if isinstance(packed[0], dict) else None
        if not isinstance(view, int):
            raise FormatError("has a packed splat without its values; export it again")
    if splat.get("kernel", "ellipse") != "ellipse" or splat.get("colorSpace", COLORS) != COLORS:
        raise FormatError(
            f"holds a splat with another kernel than ellipse, or other colours than {COLORS}, which are not"
            " read"
        )
    attributes = primitive.get("attributes")
    if view is None and not isinstance(attributes, dict):
        raise FormatError("has a splat without attributes; export it again")
    return _Splat(attributes, view, "kernel" in splat)


def _matrix(node: dict) -> np.ndarray:
    """(4, 4): the transform of a node."""
    numbers: Callable[[str, list], np.ndarray] = lambda name, default: np.array(
        node.get(name, default), np.float64
    )
    try:
        if "matrix" in node:
            return numbers("matrix", []).reshape(4, 4).T
        matrix, xyzw = np.eye(4), numbers("rotation", [0, 0, 0, 1]).reshape(4)
        # a rotation of zeros gives no numbers, and is refused where the splat is placed
        with np.errstate(invalid="ignore"):
            matrix[:3, :3] = rotation_matrices(np.roll(xyzw, 1)[None])[0]
        matrix[:3, :3] *= numbers("scale", [1, 1, 1]).reshape(3)
        matrix[:3, 3] = numbers("translation", [0, 0, 0]).reshape(3)
        return matrix
    except (ValueError, TypeError, OverflowError):
        raise FormatError("has a node with a transform that is none; export it again") from None


def _unpacked(glb: Glb, numbers: set, max_count: int) -> dict[int, Scene]:
    """The splats that these buffer views hold, in the axes of a Scene."""
    packed = {number: glb.view(number) for number in sorted(numbers)}
    if len(packed) > MAX_PACKED or sum(map(len, packed.values())) > len(glb.data):
        raise FormatError(
            f"has more than {MAX_PACKED} packed splats, or some that lie in the same bytes; export it again"
        )
    return {
        number: concatenated(list(spz.parts_of(data, max_count)), columns=True)
        for number, data in packed.items()
    }


def _count_and_degree(glb: Glb, splat: _Splat, unpacked: dict[int, Scene]) -> tuple[int, int]:
    """How many Gaussians a splat has, and the degree of their SH."""
    if splat.view is not None:
        return unpacked[splat.view].count, unpacked[splat.view].sh_degree
    return glb.count(splat.attributes.get("POSITION")), splat.degree


def _scene(glb: Glb, splat: _Splat, unpacked: dict[int, Scene]) -> Scene:
    """The Gaussians of a splat in its own coordinates."""
    # first drafts, with no kernel, took the axes of an SPZ as they were; later ones turn them
    if splat.view is not None:
        stored = turned_over(unpacked[splat.view])
        return turned_around(stored) if splat.names_kernel else stored
    degree, attributes = splat.degree, splat.attributes
    means = glb.values(attributes.get("POSITION"), 3)
    count = len(means)
    read: Callable[[str, int], np.ndarray] = lambda name, width: glb.values(
        attributes.get(f"{EXTENSION}:{name}"), width, count
    )
    sh = np.zeros((count, SH_COEFFICIENTS[degree], 3), np.float32)
    for name, k in _coefficients(degree):
        sh[:, k] = read(name, 3)
    logits, logs = logits_of_opacities(read("OPACITY", 1)[:, 0]), logs_of(read("SCALE", 3))
    return Scene.of(means, logs, np.roll(read("ROTATION", 4), 1, axis=1), logits, sh)


FORMAT = SplatFormat(
    name="glb",
    label="glTF",
    suffixes=(".glb",),
    sniff=lambda head: head.startswith(b"glTF"),
    read_parts=read_parts,
    write=write,
    size=file_size,
    carries=("order",),
)

"""A scene as point attributes in the layout of Blender 5.3's own splats, and back. No bpy in here: names, kinds and arrays.

What that layout cannot hold bit by bit lies beside it: raw values under names of our own (they hold as long as they stand for
the activated ones, see activation.py), and as notes what the file said beside its numbers.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator

import numpy as np

from ..scene import SH_COEFFICIENTS, Scene
from . import activation

POSITION, SCALE, ROTATION, BASE, SH = "position", "scale", "rotation", "radiance:base", "radiance:sh_"
RAW_SCALE, RAW_ROTATION, RAW_OPACITY = "svrgs:log_scale", "svrgs:quaternion", "svrgs:opacity_logit"
REQUIRED = (SCALE, ROTATION, BASE)
RESERVED = re.compile(r"(position|scale|rotation|radius|removed|material_index|id)$|[.]|radiance:|svrgs:|ply:")
NAME_LIMIT = 60  # bytes of a name; Blender 4.2 allows 63
STORED_AS = {"f4": ("FLOAT", "f4"), "f8": ("INT32_2D", "i4"), "u4": ("INT", "i4")}  # the same bits; smaller integers: INT

Get = Callable[[str], np.ndarray | None]


def to_attributes(scene: Scene) -> Iterator[tuple[str, str, np.ndarray]]:
    """(name, Blender's data type, values with one row a Gaussian) of every attribute; FLOAT_COLOR may be FLOAT4 where Blender has it."""
    yield POSITION, "FLOAT_VECTOR", scene.means
    yield SCALE, "FLOAT_VECTOR", activation.scales(scene.log_scales)
    yield ROTATION, "QUATERNION", activation.rotations(scene.quats)
    yield BASE, "FLOAT_COLOR", np.concatenate([scene.sh[:, 0], activation.opacities(scene.opacity_logits)[:, None]], axis=1)
    for k in range(1, scene.sh.shape[1]):
        yield f"{SH}{k - 1}", "FLOAT_VECTOR", scene.sh[:, k]
    yield RAW_SCALE, "FLOAT_VECTOR", scene.log_scales
    yield RAW_ROTATION, "QUATERNION", scene.quats
    yield RAW_OPACITY, "FLOAT", scene.opacity_logits
    for name, (attribute, code) in _further(scene).items():
        kind, same_bits = STORED_AS.get(code, ("INT", ""))
        column = scene.attributes[name]
        yield attribute, kind, column.view(same_bits) if same_bits else column.astype(np.int32)


def notes_of(scene: Scene) -> str:
    """JSON to be kept with the attributes."""
    return json.dumps({"antialiased": scene.antialiased, "comments": scene.comments, "order": scene.property_order, "further": _further(scene)})


def from_attributes(get: Get, float_names: list[str], notes: str) -> Scene:
    """The scene of attributes named and shaped as by to_attributes; get: values by name, None where there are none.

    notes: of notes_of, or "" for a splat that Blender imported; then float_names, further attributes of one number, are kept.
    SH bands that are not complete, and those above degree 3, are left out.
    """
    position, scale, rotation, base = (_required(get, name) for name in (POSITION, SCALE, ROTATION, BASE))
    said = json.loads(notes or "{}")
    return Scene(
        means=position,
        log_scales=activation.raw_scales(scale, get(RAW_SCALE)),
        quats=activation.raw_rotations(rotation, get(RAW_ROTATION)),
        opacity_logits=activation.raw_opacities(base[:, 3], get(RAW_OPACITY)),
        sh=_harmonics(get, base),
        antialiased=said.get("antialiased", False),
        attributes=_columns(get, said["further"]) if said else {name: _required(get, name) for name in float_names if _can_be_in_a_file(name)},
        comments=tuple(said.get("comments", ())),
        property_order=tuple(said.get("order", ())),
    )


def _required(get: Get, name: str) -> np.ndarray:
    values = get(name)
    assert values is not None, f"a splat has no attribute {name}"
    return values


def _further(scene: Scene) -> dict[str, tuple[str, str]]:
    """Name in the file: name of the attribute, and type in the file."""
    free = lambda name: len(name.encode()) <= NAME_LIMIT and not RESERVED.match(name)  # noqa: E731
    return {name: (name if free(name) else f"ply:{i}", column.dtype.str[1:]) for i, (name, column) in enumerate(scene.attributes.items())}


def _harmonics(get: Get, base: np.ndarray) -> np.ndarray:
    rest: list[np.ndarray] = []
    while len(rest) + 1 < max(SH_COEFFICIENTS) and (values := get(f"{SH}{len(rest)}")) is not None:
        rest.append(values)
    coefficients = max(k for k in SH_COEFFICIENTS if k <= len(rest) + 1)
    return np.ascontiguousarray(np.stack([base[:, :3], *rest[: coefficients - 1]], axis=1))


def _columns(get: Get, further: dict) -> dict[str, np.ndarray]:
    """Columns of the file that are no Gaussian's, as they were; those deleted since are left out."""
    columns = {}
    for name, (attribute, code) in further.items():
        values = get(attribute)
        if values is not None:
            columns[name] = values.reshape(-1).view(code) if code in STORED_AS else values.astype(code)
    return columns


def _can_be_in_a_file(name: str) -> bool:
    return bool(re.fullmatch("[!-~]+", name)) and not RESERVED.match(name)

"""Converts a scene to point attributes in the layout of Blender 5.3's own splats, and back. No bpy: names,
types and arrays.

Blender's attributes hold activated values, from which float32 cannot restore every bit of a file. So a splat
also has:

- raw values, as attributes svrgs:log_scale, svrgs:quaternion, svrgs:opacity_logit. They count while their
  activation still equals Blender's attribute. After an edit, or without raw values (a splat that Blender
  imported), the activated values are inverted (activation.py).
- the position, as svrgs:position. Blender's Apply and Join move points and leave shapes and colours as they
  were. Where points were moved together since, shapes and colours are transformed when the splat is read
  (scene/moved_points.py).
- each further column of the file, as an attribute of its own.
- types, order and comments of the file, as a property of the data-block: a JSON text (notes_of).

So a splat that was not edited is exported byte for byte.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator

import numpy as np

from . import activation
from .gaussians import SH_COEFFICIENTS, Scene
from .moved_points import follow_points

POSITION, SCALE, ROTATION, BASE, SH = "position", "scale", "rotation", "radiance:base", "radiance:sh_"
RAW_SCALE, RAW_ROTATION, RAW_OPACITY = "svrgs:log_scale", "svrgs:quaternion", "svrgs:opacity_logit"
RAW_POSITION = "svrgs:position"  # where a point was when its shape and colours were written
REQUIRED = (SCALE, ROTATION, BASE)
RESERVED = re.compile(
    r"(position|scale|rotation|radius|removed|material_index|id)$|[.]|radiance:|svrgs:|ply:"
)
NAME_LIMIT = 60  # bytes of an attribute name; Blender 4.2 allows 63
STORED_AS = {
    "f4": ("FLOAT", "f4"),
    "f8": ("INT32_2D", "i4"),
    "u4": ("INT", "i4"),
}  # types that keep their bits: (data type in Blender, NumPy code there); smaller integers are stored as INT

Get = Callable[[str], np.ndarray | None]  # the values of an attribute by name, None if there is none


def to_attributes(scene: Scene) -> Iterator[tuple[str, str, np.ndarray]]:
    """Yields (name, Blender's data type, values with one row per Gaussian) of each attribute. FLOAT_COLOR may
    be replaced by FLOAT4 in versions of Blender that have it."""
    yield POSITION, "FLOAT_VECTOR", scene.means
    yield SCALE, "FLOAT_VECTOR", activation.scales(scene.log_scales)
    yield ROTATION, "QUATERNION", activation.rotations(scene.quats)
    opacities = activation.opacities(scene.opacity_logits)
    yield BASE, "FLOAT_COLOR", np.concatenate([scene.sh[:, 0], opacities[:, None]], axis=1)
    for k in range(1, scene.sh.shape[1]):
        yield f"{SH}{k - 1}", "FLOAT_VECTOR", scene.sh[:, k]
    yield RAW_POSITION, "FLOAT_VECTOR", scene.means
    yield RAW_SCALE, "FLOAT_VECTOR", scene.log_scales
    yield RAW_ROTATION, "QUATERNION", scene.quats
    yield RAW_OPACITY, "FLOAT", scene.opacity_logits
    for name, (attribute, code) in _extra_columns(scene).items():
        kind, same_bits = STORED_AS.get(code, ("INT", ""))
        column = scene.attributes[name]
        yield attribute, kind, column.view(same_bits) if same_bits else column.astype(np.int32)


def notes_of(scene: Scene) -> str:
    """Types, order and comments of the file and the antialiased flag, as the data-block keeps them: JSON."""
    return json.dumps(
        {
            "antialiased": scene.antialiased,
            "comments": scene.comments,
            "order": scene.property_order,
            "further": _extra_columns(scene),
        }
    )


def from_attributes(get: Get, float_names: list[str], notes: str) -> Scene:
    """The scene of attributes with the names and shapes of to_attributes.

    get: values of an attribute by name, or None. notes: the text of notes_of, or "" for a splat that Blender
    imported. In that case, the attributes float_names, which have one number per Gaussian, become further
    columns if a PLY can store their names. Incomplete SH degrees and degrees above 3 are left out. Shapes and
    colours follow points that were moved together.
    """
    position, scale, rotation, base = (_required(get, name) for name in (POSITION, SCALE, ROTATION, BASE))
    file_facts = json.loads(notes or "{}")
    if file_facts:
        attributes = _columns(get, file_facts["further"])
    else:
        printable = re.compile("[!-~]+")  # what a PLY can store
        free = [name for name in float_names if printable.fullmatch(name) and not RESERVED.match(name)]
        attributes = {name: _required(get, name) for name in free}
    scene = Scene(
        means=position,
        log_scales=activation.raw_scales(scale, get(RAW_SCALE)),
        quats=activation.raw_rotations(rotation, get(RAW_ROTATION)),
        opacity_logits=activation.raw_opacities(base[:, 3], get(RAW_OPACITY)),
        sh=_harmonics(get, base),
        antialiased=file_facts.get("antialiased", False),
        attributes=attributes,
        comments=tuple(file_facts.get("comments", ())),
        property_order=tuple(file_facts.get("order", ())),
    )
    written_at = get(RAW_POSITION)
    return scene if written_at is None else follow_points(scene, written_at)[0]


def _required(get: Get, name: str) -> np.ndarray:
    """The values of an attribute that every splat has."""
    values = get(name)
    assert values is not None, f"a splat has no attribute {name}"
    return values


def _extra_columns(scene: Scene) -> dict[str, tuple[str, str]]:
    """Further columns as {name in the file: (name of the attribute, NumPy type code in the file)}. Names that
    are too long or reserved become ply:0, ply:1, ..."""
    free = lambda name: len(name.encode()) <= NAME_LIMIT and not RESERVED.match(name)
    return {
        name: (name if free(name) else f"ply:{i}", column.dtype.str[1:])
        for i, (name, column) in enumerate(scene.attributes.items())
    }


def _harmonics(get: Get, base: np.ndarray) -> np.ndarray:
    """SH coefficients (N, K, 3) float32 of all complete degrees up to 3."""
    rest: list[np.ndarray] = []
    while len(rest) + 1 < max(SH_COEFFICIENTS) and (values := get(f"{SH}{len(rest)}")) is not None:
        rest.append(values)
    coefficients = max(k for k in SH_COEFFICIENTS if k <= len(rest) + 1)
    return np.ascontiguousarray(np.stack([base[:, :3], *rest[: coefficients - 1]], axis=1))


def _columns(get: Get, further: dict) -> dict[str, np.ndarray]:
    """Further columns with their types in the file. Columns whose attribute was deleted are left out."""
    return {
        name: values.reshape(-1).view(code) if code in STORED_AS else values.astype(code)
        for name, (attribute, code) in further.items()
        if (values := get(attribute)) is not None
    }

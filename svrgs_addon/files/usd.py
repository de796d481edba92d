"""OpenUSD with prims ParticleField3DGaussianSplat (26.03 and later), as float32: read and written by pxr,
which Blender brings along, or usd-core.

positions, orientations (unit quaternions), scales (not logarithms), opacities (0 to 1),
radiance:sphericalHarmonicsCoefficients, those of one Gaussian together. Stages are written with y up: right,
up, back. All such prims of a stage are read, at its first frame, moved as their parents say; what else is in
it is ignored.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..scene import activation
from ..scene.gaussians import SH_COEFFICIENTS, Scene
from ..system import limited, packages
from ..system.errors import FormatError, SceneError
from ..system.processes import ChildProcess
from . import usd_arrays
from .atomic import atomic_path, check_space
from .axes import placed, turned_over
from .quantised import logits_of_opacities, logs_of, opacities_of, unit_quats
from .reading import BROKEN, MAX_COUNT, open_splat, refuse_whole, size_of
from .splat_format import SplatFormat
from .usd_arrays import DEGREE, SH, TYPE

# attributes, and the numbers of a Gaussian in each
ROWS = {"positions": 3, "orientations": 4, "scales": 3, "opacities": 1}
Z_TO_Y = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)
SECONDS, LONGER = 5, 4  # of the processor that reading a small file may take; factor on it, for a clock
# of addresses for a small file: OpenUSD and NumPy take most of them; for each byte of a larger one
MEGABYTES, TIMES_FILE = 4096, 8
FREE_SPACE = 3  # bytes of free space for each byte of the values
POINTS = ("Points", "Mesh")  # prims in which Blender exports the data of a splat


def read_parts(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """All Gaussians as one part. Raises FormatError, naming the file, SceneError if pxr is missing."""
    with open_splat(path) as file, _arrays_of(Path(path), size_of(file)) as arrays:
        number = sum(name.endswith(":positions") for name in arrays)
        if not number:
            raise FormatError(f"holds no splat: no prim of the type {TYPE}")
        degree = max(_degree(arrays, one) for one in range(number))
        count = sum(arrays[f"{one}:positions"].size // 3 for one in range(number))
        refuse_whole(count, SH_COEFFICIENTS[degree], max_count)
        upright = Z_TO_Y if arrays["z_up"] else np.eye(4)
        part = lambda one: (_scene(arrays, one, degree), upright @ arrays[f"{one}:matrix"])
        scene = placed(map(part, range(number)), "prim")
    yield scene


@contextlib.contextmanager
def _arrays_of(path: Path, size: int) -> Iterator[Any]:
    """The arrays of the stage (usd_arrays.py). Raises FormatError (without a name), as below, SceneError."""
    if not packages.is_installed("pxr"):
        module("Usd")  # raises
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "arrays.npz"
        seconds = SECONDS + (size >> 22)
        megabytes = MEGABYTES + TIMES_FILE * (size >> 20)
        words = [limited.__file__, seconds, megabytes, usd_arrays.__file__, path.absolute(), out]
        command, nowhere = [sys.executable, "-P", *map(str, words)], subprocess.DEVNULL
        with ChildProcess(command, stdin=nowhere, stdout=nowhere, stderr=nowhere) as child:
            try:
                child.wait(LONGER * seconds)
            except subprocess.TimeoutExpired:
                child.kill()
        if child.returncode or not out.is_file():
            raise FormatError(f"is damaged: OpenUSD cannot read it{BROKEN}")
        with np.load(out, allow_pickle=False) as arrays:
            yield dict(arrays)


def write(path: str | os.PathLike, scene: Scene):
    """Writes a stage with one prim, atomically, with the Gaussians in their order. Raises SceneError."""
    Usd, UsdGeom, Sdf = map(module, ("Usd", "UsdGeom", "Sdf"))
    check_space(path, FREE_SPACE * scene.count * 4 * (11 + 3 * scene.sh.shape[1]))
    layer = Sdf.Layer.CreateAnonymous(Path(path).suffix.lower())
    stage = Usd.Stage.Open(layer)
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    prim = stage.DefinePrim("/Splat", TYPE)
    stage.SetDefaultPrim(prim)
    _fill(prim, turned_over(scene))
    with atomic_path(path) as temporary:
        # OpenUSD renames its own file to this one; Windows refuses that for `temporary`, which is open
        exported = temporary.with_name(f"{temporary.stem}-usd{temporary.suffix}")
        try:
            _export(layer, exported, path)
            shutil.copyfile(exported, temporary)
        finally:
            exported.unlink(missing_ok=True)


def _export(layer: Any, out: Path, path: str | os.PathLike):
    """Writes a layer. path: the file of which errors speak. Raises SceneError."""
    try:
        if layer.Export(str(out)):
            return
    except UnicodeError:
        raise SceneError(
            f"{path}: OpenUSD writes only where all names are UTF-8; choose another folder"
        ) from None
    except module("Tf").ErrorException:
        pass
    raise SceneError(f"{path}: cannot be written by OpenUSD; is the disk full, or the path too long?")


def replace_points(stage: Any, path: Any, scene: Scene):
    """In a stage that Blender exports: makes the points below the prim of an object this splat, in the
    object's coordinates; also those of an instance, in its prototype. Raises SceneError if there are none, or
    without pxr."""
    Usd = module("Usd")
    everything = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)  # prototypes too
    found = [
        prim
        for prim in stage.GetPrimAtPath(path).GetFilteredChildren(everything)
        if prim.GetTypeName() in (*POINTS, TYPE)
    ]
    if not found:
        raise SceneError(f"{path}: has no points in the stage, so its splat is not in it")
    spec = found[0].GetPrimStack()[-1]
    spec.typeName = TYPE
    for attribute in list(spec.properties):
        spec.RemoveProperty(attribute)
    _fill(stage.GetPrimAtPath(spec.path), scene)


def _fill(prim: Any, scene: Scene):
    """Sets the attributes of a prim, in its own coordinates."""
    Sdf, Vt = map(module, ("Sdf", "Vt"))
    kinds = Sdf.ValueTypeNames
    scales, extent = activation.scales(scene.log_scales), np.zeros((2, 3), np.float32)
    if scene.count:
        radius = 3 * scales.max()
        extent = np.array([scene.means.min(axis=0) - radius, scene.means.max(axis=0) + radius])
    values = {
        "positions": (kinds.Point3fArray, Vt.Vec3fArray, scene.means),
        "orientations": (kinds.QuatfArray, Vt.QuatfArray, np.roll(unit_quats(scene.quats), -1, axis=1)),
        "scales": (kinds.Float3Array, Vt.Vec3fArray, scales),
        "opacities": (kinds.FloatArray, Vt.FloatArray, opacities_of(scene.opacity_logits)),
        SH: (kinds.Float3Array, Vt.Vec3fArray, scene.sh.reshape(-1, 3)),
        "extent": (kinds.Float3Array, Vt.Vec3fArray, extent),
    }
    for name, (kind, array, rows) in values.items():
        prim.CreateAttribute(name, kind, False).Set(array.FromNumpy(np.ascontiguousarray(rows, np.float32)))
    prim.CreateAttribute(DEGREE, kinds.Int, False, Sdf.VariabilityUniform).Set(scene.sh_degree)


def _scene(arrays: dict[str, np.ndarray], number: int, degree: int) -> Scene:
    """The Gaussians of a prim in its own coordinates, with SH up to `degree`."""
    count, own = arrays[f"{number}:positions"].size // 3, _degree(arrays, number)
    means, orientations, scales, opacities = (
        _rows(arrays, number, name, count, width) for name, width in ROWS.items()
    )
    sh = np.zeros((count, SH_COEFFICIENTS[degree], 3), np.float32)
    stored = _rows(arrays, number, "sh", count, 3 * SH_COEFFICIENTS[own])
    sh[:, : SH_COEFFICIENTS[own]] = stored.reshape(count, -1, 3)
    quats, logits = np.roll(orientations, 1, axis=1), logits_of_opacities(opacities[:, 0])
    return Scene.of(means, logs_of(scales), quats, logits, sh)


def _degree(arrays: dict[str, np.ndarray], number: int) -> int:
    degree = int(arrays[f"{number}:degree"])
    if degree not in range(len(SH_COEFFICIENTS)):
        raise FormatError(
            f"has spherical harmonics of degree {degree}; 0 to {len(SH_COEFFICIENTS) - 1} are read"
        )
    return degree


def _rows(arrays: dict[str, np.ndarray], number: int, name: str, count: int, width: int) -> np.ndarray:
    """(count, width) float32."""
    found = arrays[f"{number}:{name}"]
    if found.size != count * width:
        raise FormatError(
            f"has a splat whose {name} are missing, or not those of {count:,} Gaussians{BROKEN}"
        )
    return found.reshape(count, width)


def module(name: str) -> Any:
    """A module of pxr. Raises SceneError if it is not installed."""
    return packages.load(f"pxr.{name}", "reading and writing USD")


def lack() -> str:
    """ "": USD can be written. Raises SceneError if usd-core is not installed."""
    module("Usd")
    return ""


FORMAT = SplatFormat(
    name="usd",
    label="USD",
    suffixes=(".usd", ".usdc", ".usda"),
    read_parts=read_parts,
    write=write,
    carries=("order",),
    needs=lack,
)

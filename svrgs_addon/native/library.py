"""Loads the native library and calls its functions: structs of the interface, checks of arrays, names,
thresholds, threads.

`native/include/svrgs.h` is the manual; names, shapes and units here are the same. Only this room and
system/ import ctypes.
"""

from __future__ import annotations

import ctypes as c
import functools
from collections.abc import Callable
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from ..scene.camera import Camera
from ..scene.gaussians import PARAMETERS
from ..system.errors import Cancelled, NativeError
from ..system.structs import fields
from .library_path import library_path
from .outputs import OUTPUTS

INTERFACE_VERSION = 26
GRADS = (*PARAMETERS, "masks", "means2d", "camera")
# images whose gradients backward() accepts
LOSS_IMAGES = tuple(output.name for output in OUTPUTS.values() if output.differentiable)
_CANCELLED = 3  # of enum svrgs_status
_LEVEL_NAMES, _MASK_KIND_NAMES, _SKIP_NAMES, _STAGE_NAMES = range(4)  # enum svrgs_names

# Types of the arguments of the functions in svrgs.h: i int32, l int64, u uint64, d double, p a pointer.
ARGUMENTS = {
    "svrgs_name": "ii",
    "svrgs_get_thresholds": "p",
    "svrgs_level_supported": "i",
    "svrgs_set_threads": "i",
    "svrgs_trace": "i",
    "svrgs_traced": "pp",
    "svrgs_context_create": "ip",
    "svrgs_context_destroy": "p",
    "svrgs_forward": "ppppp",
    "svrgs_visible": "ppp",
    "svrgs_count_work": "pip",
    "svrgs_stage_seconds": "pp",
    "svrgs_measure_machine": "ip",
    "svrgs_backward": "ppp",
    "svrgs_scores": "ppppppp",
    "svrgs_moments": "pp",
    "svrgs_removal": "ppp",
    "svrgs_visibility": "pp",
    "svrgs_slopes": "pp",
    "svrgs_dominance": "pp",
    "svrgs_loss": "pppiiddpp",
    "svrgs_mask_loss": "ppldpp",
    "svrgs_flip": "ippiidp",
    "svrgs_convolve": "ipiiippip",
    "svrgs_linear_rgba": "ipplpp",
    "svrgs_expose": "ipplpp",
    "svrgs_expose_vjp": "ippplppp",
    "svrgs_adam": "pppppplip",
    "svrgs_backward_update": "ppppp",
    "svrgs_sample_masks": "pluupp",
    "svrgs_decimate": "ippppp",
    "svrgs_draw_triangles": "ppp",
    "svrgs_add_view": "pp",
}
_KINDS = {"i": c.c_int32, "l": c.c_int64, "u": c.c_uint64, "d": c.c_double, "p": c.c_void_p}

_int, _long, _double, _pointer = c.c_int32, c.c_int64, c.c_double, c.c_void_p
_reals = c.c_void_p  # to values in the type of the level


def _struct(name: str, *of_types: tuple[Any, str]) -> Any:
    """A struct of svrgs.h. of_types: as for fields()."""
    return type(name, (c.Structure,), {"_fields_": fields(*of_types)})


_PARAMETERS = " ".join(PARAMETERS)
SceneStruct = _struct(
    "SceneStruct", (_long, "count"), (_int, "sh_coefficients"), (_reals, _PARAMETERS), (_pointer, "masks")
)
CameraStruct = _struct(
    "CameraStruct",
    (_double * 16, "viewmat"),
    (_double, "fx fy cx cy"),
    (_int, "width height orthographic"),
    (_double * 3, "background"),
    (_double, "near_depth"),
)
OptionsStruct = _struct(
    "OptionsStruct",
    (_int, "sh_degree antialiased full mask_kind"),
    (_double, "eps_a"),
    (_int, "disabled_skips"),
    (_long, "max_pairs"),
    (_pointer, "cancel"),
    (_reals, "depth_limit"),
    (_int, "picture_only"),
    (_pointer, "valid"),
    (_double, "stop"),
)
ImagesStruct = _struct("ImagesStruct", (_reals, " ".join(OUTPUTS)))
ImageGradsStruct = _struct("ImageGradsStruct", (_reals, " ".join(LOSS_IMAGES)))
GradsStruct = _struct("GradsStruct", (_reals, " ".join(GRADS)))
AdamStruct = _struct(
    "AdamStruct", (_pointer, "lr"), (_double, "beta1 beta2 eps"), (_long, "step"), (_int, "shared")
)
TrainedStruct = _struct("TrainedStruct", (_reals, "param"), (_pointer, "moments lr"))
UpdateStruct = _struct(
    "UpdateStruct", (AdamStruct, "adam"), (TrainedStruct, f"{_PARAMETERS} masks"), (_reals, "slope frozen")
)
WorkStruct = _struct("WorkStruct", (_long, "visible pairs used_pairs blocks hit_blocks hits contributing"))
TextureStruct = _struct("TextureStruct", (_pointer, "texels"), (_int, "width height repeat"))
TrianglesStruct = _struct(
    "TrianglesStruct",
    (_long, "count"),
    (_pointer, "corners colors light uvs textures holdout texture"),
    (_int, "texture_count"),
    (_double, "ambient"),
)
LayersStruct = _struct("LayersStruct", (_pointer, "share depth rgba"))
ViewStruct = _struct(
    "ViewStruct",
    (_pointer, "image"),
    (_int, "width height channels along"),
    (_double * 9, "turn"),
    (_double, "focal cx cy"),
)
PanoramaStruct = _struct(
    "PanoramaStruct",
    (_pointer, "sums"),
    (_int, "width height"),
    (_pointer, "latitudes row_weights longitudes column_weights"),
)
DecimationStruct = _struct(
    "DecimationStruct",
    (_long, "count"),
    (_int, "sh_coefficients antialiased"),
    (_pointer, f"{_PARAMETERS} visibility"),
    (_double * 3, "middle"),
    (_double, "unit"),
    (_long, "least"),
)
MergesStruct = _struct("MergesStruct", (_pointer, f"a b costs {_PARAMETERS}"))
MachineStruct = _struct("MachineStruct", (_double, "fma read update"))


@functools.cache
def library() -> c.CDLL:
    """The loaded library. Raises NativeError if it is missing, does not load, or has another version."""
    path = library_path()
    try:
        loaded = c.CDLL(str(path))
        loaded.svrgs_last_error.restype = c.c_char_p
    except (OSError, AttributeError) as error:
        raise NativeError(
            f"the native library {path} does not load ({error}): build it for this computer with 'make setup'"
        ) from None
    if (found := loaded.svrgs_interface_version()) != INTERFACE_VERSION:
        raise NativeError(
            f"{path} has interface version {found}, this code needs {INTERFACE_VERSION}: rebuild it with"
            " 'make setup'"
        )
    loaded.svrgs_name.restype = c.c_char_p
    for name, kinds in ARGUMENTS.items():
        getattr(loaded, name).argtypes = [_KINDS[kind] for kind in kinds]
    return loaded


def call_library(name: str, *arguments):
    """Calls a function that returns a status. Raises Cancelled, or NativeError with its sentence."""
    loaded = library()
    status = getattr(loaded, name)(*arguments)
    if status == _CANCELLED:
        raise Cancelled
    if status:
        raise NativeError(loaded.svrgs_last_error().decode())


def check(array: np.ndarray, name: str, shape: tuple, dtype) -> int:
    """The address of `array`. Raises TypeError unless it is C-contiguous, of this shape and dtype."""
    if (
        not isinstance(array, np.ndarray)
        or array.dtype != dtype
        or array.shape != shape
        or not array.flags.c_contiguous
    ):
        found = f"{array.dtype}{array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise TypeError(f"{name} is {found}; expected C-contiguous {np.dtype(dtype).name}{shape}")
    return array.ctypes.data


def check_out(array: np.ndarray, name: str, shape: tuple, dtype) -> int:
    """As check(), for an array that the library writes. Raises TypeError also if it is read-only."""
    address = check(array, name, shape, dtype)
    if not array.flags.writeable:
        raise TypeError(f"{name} is read-only")
    return address


def camera_struct(camera: Camera, background=(0.0, 0.0, 0.0)) -> c.Structure:
    """The struct of a camera. background: display sRGB."""
    (fx, _, cx), (_, fy, cy), _ = camera.K
    viewmat = (_double * 16)(*np.asarray(camera.viewmat, np.float64).ravel())
    size = camera.width, camera.height, camera.orthographic
    return CameraStruct(viewmat, fx, fy, cx, cy, *size, (_double * 3)(*background), near_depth(camera.unit))


class Thresholds(NamedTuple):
    """Constants of the rasterizer in this build of the library; svrgs_thresholds in svrgs.h."""

    near: float  # a Gaussian is rendered if near < z < far, z the depth of its centre; see near_depth()
    far: float
    blur: float  # pixels^2, added to both variances of a projected Gaussian
    # share of half the image size; the Jacobian clamps x/z and y/z at this distance outside the image
    frustum_margin: float
    alpha_cut: float  # a Gaussian hits a pixel where alpha >= alpha_cut
    alpha_max: float  # alpha is clamped to this
    stop: float  # blending of colours stops before the transmittance would fall below this
    compensation_floor: float  # smallest det(before blur) / det(after blur), in antialiased scenes
    tile: int  # side of a square tile, pixels
    block_width: int  # pixels
    block_height: int  # pixels


ThresholdsStruct = _struct(
    "ThresholdsStruct",
    *((_double if kind is float else _int, name) for name, kind in get_type_hints(Thresholds).items()),
)


@functools.cache
def thresholds() -> Thresholds:
    """The constants of the rasterizer, as the library reports them."""
    found = ThresholdsStruct()
    library().svrgs_get_thresholds(c.byref(found))
    return Thresholds(**{name: getattr(found, name) for name in Thresholds._fields})


def near_depth(unit: float) -> float:
    """Centres up to this depth are not drawn, world units: that of 3DGS, or less in a small world. unit:
    Camera.unit."""
    return thresholds().near * min(1.0, unit)


@functools.cache
def _names(which: int) -> tuple[str, ...]:
    """Names of the values of one enum of the library, in its order. which: a value of enum svrgs_names."""
    ask = library().svrgs_name
    names: list[str] = []
    while name := ask(which, len(names)):
        names.append(name.decode())
    return tuple(names)


def levels() -> dict[str, int]:
    """SIMD levels as {name: number in the interface}, float levels from slow to fast, then 'float64'."""
    return {name: number for number, name in enumerate(_names(_LEVEL_NAMES))}


def mask_kinds() -> dict[str, int]:
    """Forms of the spatial mask F and its gradient as {name: number}; svrgs_mask_kind in svrgs.h."""
    return {name: number for number, name in enumerate(_names(_MASK_KIND_NAMES))}


def skips() -> dict[str, int]:
    """Work that the rasterizer skips, since it changes nothing, as {name: bit}; svrgs_skip in svrgs.h."""
    return {name: 1 << number for number, name in enumerate(_names(_SKIP_NAMES))}


def stages() -> tuple[str, ...]:
    """Names of the stages whose durations are measured: four of forward (project, tiles, sort, blend), two of
    backward, loss, Adam."""
    return _names(_STAGE_NAMES)


def best_level() -> str:
    """Name of the fastest float SIMD level that this processor supports."""
    return list(levels())[library().svrgs_best_level()]


def supported_levels() -> list[str]:
    """Names of all levels that this processor supports, 'float64' included."""
    return [name for name, code in levels().items() if library().svrgs_level_supported(code)]


def peaks(level: str) -> dict[str, float]:
    """Measured peak rates of all threads together at a level.

    'fma': operations/s of fused multiply-adds, 2 operations per lane. 'read': bytes/s read from memory.
    'update': bytes/s while three streams are read and two of them written, as in Adam.
    """
    machine = MachineStruct()
    call_library("svrgs_measure_machine", levels()[level], c.byref(machine))
    return {name: getattr(machine, name) for name, *_ in MachineStruct._fields_}


def set_threads(count: int):
    """Sets the size of the thread pool; 0: one thread per core that this process may use. Results do not
    depend on it. More than 32 threads, or 8 per core, would only slow each other down: that many are taken
    then."""
    library().svrgs_set_threads(min(count, 2**31 - 1))


def threads() -> int:
    """Size of the thread pool."""
    return library().svrgs_threads()


def traced(call: Callable[[], object]) -> list[np.ndarray]:
    """Seconds of each task of the thread pool during call(), an array per job. Nothing with more threads."""
    lib, seconds, count = library(), c.POINTER(c.c_double)(), c.c_int64()
    lib.svrgs_trace(1)
    try:
        call()
    finally:
        lib.svrgs_trace(0)
    lib.svrgs_traced(c.byref(seconds), c.byref(count))
    if not count.value:
        return []
    found = np.ctypeslib.as_array(seconds, (count.value,)).copy()
    return [job[1:] for job in np.split(found, np.flatnonzero(found < 0))[1:]]

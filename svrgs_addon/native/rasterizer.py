"""The renderer of the native library: forward and backward passes, statistics, loss and Adam; sampled masks.

`native/include/svrgs.h` is the manual; names, shapes and units here are the same. Array arguments must have
exactly the stated dtype and shape and be C-contiguous, else TypeError is raised. A call that fails raises
NativeError with the library's sentence.
"""

from __future__ import annotations

import ctypes as c
from dataclasses import dataclass, field

import numpy as np

from ..scene.camera import Camera
from ..scene.gaussians import PARAMETERS, parameter_shapes
from ..system.errors import NativeError
from . import library
from .library import GRADS, LOSS_IMAGES, call_library, camera_struct, check, check_out
from .outputs import OUTPUTS

# trailing channels, 0: none
IMAGES = {output.name: output.channels for output in OUTPUTS.values() if not output.integer}
COUNTS = tuple(output.name for output in OUTPUTS.values() if output.integer)
Maybe = np.ndarray | None  # an output that is not asked for is None
MOMENTS = ("uu", "uv", "vv", "uuu", "uuv", "uvv", "vvv", "uuuu", "uuuv", "uuvv", "uvvv", "vvvv")
VISIBILITY = ("weights", "transmittance", "pixels", "squares", "red", "green", "blue", "views", "density")


@dataclass(frozen=True)
class RenderOptions:
    """Options of one forward pass; svrgs_options in svrgs.h describes each."""

    sh_degree: int = 3  # at most the degree of the scene is used
    antialiased: bool = False  # opacity is compensated for the 2-D low-pass filter
    full: bool = True  # F counts each ray to its end, not only to where the colours stop
    mask_kind: str = "none"  # form of the spatial mask F, a name from mask_kinds()
    eps_a: float = 1e-3  # epsilon of mask kind 'a'
    # names from skips() that are turned off: the same picture, but slower; for measurements
    disabled_skips: tuple[str, ...] = ()
    max_pairs: int = 0  # a view with more (Gaussian, tile) pairs raises NativeError; 0: 2^31 - 1
    # colour behind all Gaussians, display sRGB
    background: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))
    picture_only: bool = False  # the view is not kept for gradients and statistics: less time and memory
    # a ray ends where it and its neighbours let less than this through: less time; values of alpha T from
    # this on are the same. At least that of 3DGS, 1e-4; only without a mask_kind
    stop: float = 0.0


class Rasterizer:
    """One renderer with its buffers. Only one thread may use it at a time.

    level: a SIMD level from levels(); default: the fastest. Arrays in and out have the type `dtype`: float64
    for level 'float64', else float32. Any thread may set cancel[0] = 1; the running call then stops and
    raises Cancelled.
    """

    def __init__(self, level: str | None = None):
        self.level = level or library.best_level()
        if self.level not in library.levels():
            raise ValueError(f"level {level!r} is unknown; one of {', '.join(library.levels())}")
        self.dtype = np.dtype(np.float64 if self.level == "float64" else np.float32)
        self.cancel = np.zeros(1, np.int32)
        self._context = c.c_void_p()
        # arrays that the library reads until the next forward; they must stay alive
        self._view: tuple | None = None
        self._valid: np.ndarray | None = None
        self._shape = (0, 0, 0)  # H, W, K of the last view
        self._shapes: dict[str, tuple] = {}  # shapes of the arrays of the last scene
        self._buffers: dict[str, np.ndarray] = {}
        call_library("svrgs_context_create", library.levels()[self.level], c.byref(self._context))

    def __del__(self):
        if getattr(self, "_context", None):
            library.library().svrgs_context_destroy(self._context)
            self._context = c.c_void_p()

    def forward(
        self,
        scene,
        camera: Camera,
        options: RenderOptions = RenderOptions(),
        masks=None,
        outputs=("rgb",),
        depth_limit=None,
    ) -> dict:
        """Renders one view (SVR-GS, Eq. 1, 2 and 5).

        scene: an object with the arrays of Scene in self.dtype. masks: (N,) uint8 of 0 and 1; None: all 1.
        outputs: names from IMAGES and COUNTS. depth_limit: (H, W) in self.dtype; a pixel then takes only
        Gaussians whose centre has a smaller camera z, and the view has no gradients, scores, moments or pixel
        counts. Returns {name: (H, W) or (H, W, 3)}; rgb is not clamped. Where camera.valid is 0, rgb, F and
        counts are 0, and gradients and statistics count nothing.
        """
        arrays, size = self._scene(scene, masks), (camera.height, camera.width)
        images, pointers = self._images(camera, outputs)
        limit = None
        if depth_limit is not None:
            limit = check(depth_limit, "depth_limit", size, self.dtype)
        degree = min(options.sh_degree, int(arrays.sh_coefficients**0.5) - 1)
        native = library.OptionsStruct(
            degree,
            options.antialiased,
            options.full,
            library.mask_kinds()[options.mask_kind],
            options.eps_a,
            sum(library.skips()[name] for name in options.disabled_skips),
            options.max_pairs,
            self.cancel.ctypes.data,
            limit,
            options.picture_only,
            None if (valid := camera.valid) is None else check(valid, "valid", size, np.uint8),
            options.stop,
        )
        self._valid = valid
        self._shape = (*size, arrays.sh_coefficients)
        view = camera_struct(camera, options.background)
        call_library("svrgs_forward", self._context, *map(c.byref, (arrays, view, native, pointers)))
        return images

    def visible(self) -> np.ndarray:
        """Rows (V,) uint32, ascending, of Gaussians that can reach the rectangle of pixels that count."""
        ids, count = c.POINTER(c.c_uint32)(), c.c_int64()
        call_library("svrgs_visible", self._context, c.byref(ids), c.byref(count))
        return np.ctypeslib.as_array(ids, (count.value,)).copy() if count.value else np.empty(0, np.uint32)

    def work(self, count_pixels: bool = False) -> dict[str, int]:
        """Counts of the last view (svrgs_work in svrgs.h): visible Gaussians, (Gaussian, tile) pairs; with
        count_pixels also used_pairs, blocks and hit_blocks (4x4 pixels), and (Gaussian, pixel) pairs:
        evaluated, hits (alpha >= 1/255), contributing (blended)."""
        work = library.WorkStruct()
        call_library("svrgs_count_work", self._context, count_pixels, c.byref(work))
        if not count_pixels:
            return {"visible": work.visible, "pairs": work.pairs}
        counts = {name: getattr(work, name) for name, *_ in library.WorkStruct._fields_}
        return counts | {"evaluated": 16 * work.blocks}

    def stage_seconds(self) -> dict[str, float]:
        """Durations in seconds of the stages of the last calls, by name from stages()."""
        seconds = (c.c_double * len(library.stages()))()
        call_library("svrgs_stage_seconds", self._context, seconds)
        return dict(zip(library.stages(), seconds, strict=True))

    def backward(self, image_grads: dict, wanted=GRADS) -> dict:
        """Gradients of the last view, one row per visible Gaussian in the order of visible().

        image_grads: dL/dimage by name from LOSS_IMAGES ('rgb', 'depth', 'alpha', 'mask'), with the shape of
        the image; depth needs a forward pass with output depth. wanted: names from GRADS; others are not
        computed. Returns {name: (V, ...)}, valid until the next backward. Raises ValueError for unknown
        names.
        """
        grads_in, grads, grads_out = self._gradients(image_grads, wanted)
        call_library("svrgs_backward", self._context, c.byref(grads_in), c.byref(grads_out))
        return grads

    def backward_update(
        self,
        image_grads: dict,
        tensors: dict,
        rates: dict,
        *,
        step,
        slope=None,
        frozen: Maybe = None,
        betas=(0.9, 0.999),
        eps=1e-15,
        wanted=(),
    ) -> tuple[dict, int]:
        """backward() and adam() in one call, with the same bits, but without storing the gradients.

        The view cannot be used afterwards, because its scene has changed. tensors: {name: (param, moments)};
        param is the scene's own array; sh must be among them. 'masks': the existence logits (N,), whose
        gradient is dL/dM times slope (N,). rates: {name: one rate, or one per column}. step: from 1. frozen:
        (N,) uint8, 1 for Gaussians that are not updated; they no longer count as visible. wanted: gradients
        to return, not of tensors. Returns ({name: (V, ...)}, number of rows that were skipped because their
        gradient was not finite).
        """
        if both := {*wanted} & {*tensors}:
            names = ", ".join(sorted(both))
            raise ValueError(f"these tensors are updated, so their gradients are not stored: {names}")
        grads_in, grads, grads_out = self._gradients(image_grads, wanted)
        columns, update = {}, library.UpdateStruct(adam=library.AdamStruct(None, *betas, eps, step))
        for name, (param, moments) in tensors.items():
            columns[name] = _rates(rates[name], self._shapes[name])
            addresses = self._trained(param, moments, self._shapes[name], f" of {name}")
            setattr(update, name, library.TrainedStruct(*addresses, columns[name].ctypes.data))
        if "masks" in tensors:
            update.slope = check(slope, "slope", self._shapes["masks"], self.dtype)
        update.frozen = None if frozen is None else check(frozen, "frozen", self._shapes["masks"], np.uint8)
        bad = c.c_int64()
        call_library(
            "svrgs_backward_update", self._context, *map(c.byref, (grads_in, update, grads_out, bad))
        )
        left = self.work()["visible"]
        return {name: rows[:left] for name, rows in grads.items()}, bad.value

    def add_scores(
        self,
        sum_: Maybe = None,
        max_: Maybe = None,
        hits: Maybe = None,
        transmittance: Maybe = None,
        reached: Maybe = None,
        pixels: Maybe = None,
    ):
        """Adds the last view to those statistics (N,) of each Gaussian that are given, over the pixels in
        which it is blended: sum of alpha T float64, maximum of alpha T float32, number of pixels int64, sum
        of T float64. Marks with 1 in `reached`, uint8, those that hit a ray before it stops (or, if F was
        rendered to the end of rays, any ray); colours are the same without the others. pixels: (H, W) uint8,
        only those that are not 0 count, but for `reached`, and not in a view whose camera has others."""
        given = {"sum": (sum_, np.float64), "max": (max_, np.float32), "hits": (hits, np.int64)}
        given |= {"transmittance": (transmittance, np.float64), "reached": (reached, np.uint8)}
        shape = (self._count("score"),)
        outs = (
            None if array is None else check_out(array, name, shape, dtype)
            for name, (array, dtype) in given.items()
        )
        counting = None if pixels is None else check(pixels, "pixels", self._shape[:2], np.uint8)
        call_library("svrgs_scores", self._context, counting, *outs)

    def moments(self) -> np.ndarray:
        """Moments of each visible Gaussian of the last view, (V, 12) float64: sums over pixels of w u^a v^b
        in the order of MOMENTS. w: sum over channels of (alpha dC/dalpha)^2; (u, v): whitened offset of the
        pixel from the centre; see svrgs.h."""
        self._count("take moments of")
        rows = np.empty((self.work()["visible"], len(MOMENTS)))
        call_library("svrgs_moments", self._context, rows.ctypes.data)
        return rows

    def add_removal(self, error: np.ndarray, residuals: np.ndarray):
        """Adds the removal error of each Gaussian in the last view to `error` (N,) float64 (the Delta SE of
        GaussianPOP).

        It is the exact growth of the sum of squared residuals if this Gaussian alone were removed: the sum
        over pixels and channels of d^2 - 2 r d with d = alpha T (c - b). residuals r: (H, W, 3), rendered
        colours minus photograph; see svrgs.h.
        """
        count = self._count("score")
        given = check(residuals, "residuals", (*self._shape[:2], 3), self.dtype)
        call_library("svrgs_removal", self._context, given, check_out(error, "error", (count,), np.float64))

    def add_slopes(self, sums: np.ndarray):
        """Adds the last view to `sums` (N,) float64: the sum over pixels of (sum over channels of dC/dG)^2, G
        the value of the Gaussian, alpha = opacity G (the score of Speedy-Splat)."""
        self._add("svrgs_slopes", sums)

    def add_dominance(self, pixels: np.ndarray):
        """Adds the last view to `pixels` (N,) float64: the number of pixels in which the Gaussian has the
        largest alpha T of all."""
        self._add("svrgs_dominance", pixels)

    def add_visibility(self, sums: np.ndarray):
        """Adds the last view to `sums` (N, 9) float64, what decimation.decimate() needs of all views;
        its columns are those of VISIBILITY."""
        self._add("svrgs_visibility", sums, (len(VISIBILITY),))

    def _add(self, function: str, totals: np.ndarray, columns: tuple[int, ...] = ()):
        address = check_out(totals, "totals", (self._count("score"), *columns), np.float64)
        call_library(function, self._context, address)

    def _count(self, purpose: str) -> int:
        """The number of Gaussians in the last view. Raises NativeError without one. purpose: a verb."""
        if self._view is None:
            raise NativeError(f"there is no rendered view to {purpose}: call forward() first")
        return len(self._view[0])

    def loss(self, image, target, l1_weight=0.8, ssim_weight=0.2, want_grad=True):
        """Image loss L = l1_weight mean|image - target| + ssim_weight (1 - SSIM) of two (H, W, 3) images in
        self.dtype.

        Returns (mean|image - target|, SSIM, dL/dimage). The gradient is None without want_grad, and valid
        until the next loss.
        """
        shape = np.shape(image)
        grad = self._buffer("loss", shape) if want_grad else None
        values = (c.c_double * 2)()
        call_library(
            "svrgs_loss",
            self._context,
            check(image, "image", (*shape[:2], 3), self.dtype),
            check(target, "target", shape, self.dtype),
            *shape[:2],
            l1_weight,
            ssim_weight,
            None if grad is None else grad.ctypes.data,
            values,
        )
        return values[0], values[1], grad

    def mask_loss(self, mask, weight: float) -> tuple[float, np.ndarray]:
        """L_F = mean F^2 (SVR-GS Eq. 10) and `weight` times its gradient, (H, W), valid until the next call.
        mask: F (H, W) in self.dtype."""
        grad, value = self._buffer("mask_loss", np.shape(mask)), c.c_double()
        address, outs = check(mask, "mask", grad.shape, self.dtype), (grad.ctypes.data, c.byref(value))
        call_library("svrgs_mask_loss", self._context, address, mask.size, weight, *outs)
        return value.value, grad

    def adam(self, param, moments, grad, ids, *, lr, step, betas=(0.9, 0.999), eps=1e-15) -> int:
        """One Adam step (Kingma and Ba) on some rows of param (N, ...), in place.

        ids: numbers of the rows, uint32, ascending; None: all. grad: (rows, ...). moments: zeros of the shape
        and dtype of moments_like() at first; finetune/moments.py decodes them. lr: one rate, or one per
        column of a flattened row. step: from 1. Returns the number of rows that were skipped because their
        gradient was not finite. Raises ValueError if ids do not ascend.
        """
        shape = np.shape(param)
        rates = _rates(lr, shape)
        rows = len(param) if ids is None else len(ids)
        settings = library.AdamStruct(rates.ctypes.data, *betas, eps, step, len(shape) == 3)
        bad = c.c_int64()
        addresses: list[int | None] = [*self._trained(param, moments, shape)]
        addresses.append(check(grad, "grad", (rows, *shape[1:]), self.dtype))
        addresses.append(check(ids, "ids", (rows,), np.uint32) if ids is not None else None)
        if ids is not None and rows and (ids[-1] >= len(param) or (ids[1:] <= ids[:-1]).any()):
            raise ValueError(f"ids must be in ascending order and below {len(param)}")
        sizes = rows, len(rates)
        call_library("svrgs_adam", self._context, c.byref(settings), *addresses, *sizes, c.byref(bad))
        return bad.value

    def _trained(self, param, moments, shape: tuple, of: str = "") -> tuple[int, int]:
        """Checks both arrays and returns their addresses. of: addition to their names in messages."""
        address = check_out(param, f"param{of}", shape, self.dtype)
        return address, check_out(moments, f"moments{of}", *moments_like(shape, self.dtype))

    def _gradients(self, image_grads: dict, wanted):
        """The struct of image gradients, arrays {name: (V, ...)} for the gradients, and their struct."""
        if unknown := {*image_grads} - {*LOSS_IMAGES} | {*wanted} - {*GRADS}:
            raise ValueError(
                f"{', '.join(sorted(unknown))}: unknown gradient; image_grads may hold"
                f" {', '.join(LOSS_IMAGES)}, wanted {', '.join(GRADS)}"
            )
        height, width, coefficients = self._shape
        given = {
            name: check(g, f"d{name}", _image_shape(name, height, width), self.dtype)
            for name, g in image_grads.items()
        }
        count = self.work()["visible"]
        shapes = parameter_shapes(count, coefficients) | {"masks": (count,), "means2d": (count, 2)}
        shapes["camera"] = (count, 6)
        grads = {name: self._buffer(name, shapes[name]) for name in wanted}
        addresses = {name: rows.ctypes.data for name, rows in grads.items()}
        return library.ImageGradsStruct(**given), grads, library.GradsStruct(**addresses)

    def _scene(self, scene, masks):
        """The struct of a scene whose arrays were checked. The arrays are kept alive until the next view."""
        arrays = {name: getattr(scene, name) for name in PARAMETERS}
        n, k = len(arrays["means"]), np.shape(arrays["sh"])[1] if np.ndim(arrays["sh"]) == 3 else 1
        self._shapes = parameter_shapes(n, k) | {"masks": (n,)}
        pointers = {name: check(arrays[name], name, self._shapes[name], self.dtype) for name in PARAMETERS}
        if masks is not None:
            pointers["masks"] = check(masks, "masks", (n,), np.uint8)
        self._view = (*arrays.values(), masks)
        return library.SceneStruct(count=n, sh_coefficients=k, **pointers)

    def _images(self, camera: Camera, outputs):
        """New arrays for the outputs by name, and the struct of their addresses."""
        images = {}
        for name in outputs:
            dtype = np.int32 if name in COUNTS else self.dtype
            images[name] = np.empty(_image_shape(name, camera.height, camera.width), dtype)
        return images, library.ImagesStruct(**{name: image.ctypes.data for name, image in images.items()})

    def _buffer(self, name: str, shape: tuple) -> np.ndarray:
        """An array of this shape in a buffer that only grows: steps do not allocate it again."""
        size = int(np.prod(shape, dtype=np.int64))
        if name not in self._buffers or self._buffers[name].size < size:
            self._buffers[name] = np.empty(size + size // 4, self.dtype)
        return self._buffers[name][:size].reshape(shape)


def moments_like(shape: tuple, dtype) -> tuple[tuple, np.dtype]:
    """Shape and dtype of the Adam moments of parameters of the given shape (N, ...) and dtype.

    Both moments of a value are packed into one element. A row of SH coefficients (N, K, 3) has the first
    moment of each value and one second moment for all. The bits are described in svrgs.h (svrgs_adam) and
    docs/methods.md (Adam).
    """
    single = np.dtype(dtype) == np.float32
    if len(shape) < 3:
        return tuple(shape), np.dtype(np.uint32 if single else np.complex128)
    first = shape[1] * shape[2]
    if single:
        return (shape[0], (first + 1) // 2 + 1), np.dtype(np.uint32)
    return (shape[0], first + 1), np.dtype(np.float64)


def _rates(lr, shape: tuple) -> np.ndarray:
    """One learning rate per column of a tensor (N, ...) with flattened rows, float64."""
    width = int(np.prod(shape[1:], dtype=np.int64))
    return np.ascontiguousarray(np.broadcast_to(np.asarray(lr, np.float64), (width,)))


def _image_shape(name: str, height: int, width: int) -> tuple:
    if name not in IMAGES and name not in COUNTS:
        raise ValueError(f"output {name!r} is unknown; one of {', '.join((*IMAGES, *COUNTS))}")
    return (height, width, 3) if IMAGES.get(name) else (height, width)


def sample_masks(logits: np.ndarray, seed: int, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Samples a mask for each Gaussian from its existence logit (MaskGaussian, form with one logit).

    logits m: (N,) float32. The logistic noise e is keyed by (seed, step, row), so a sample can be repeated.
    Returns the masks M = 1[m + e > 0], (N,) uint8, and the slopes dM/dm = y (1 - y) with y = sigmoid(m + e),
    (N,) float32 (straight-through).
    """
    n = np.shape(logits)[:1]
    masks, slope = np.empty(n, np.uint8), np.empty(n, np.float32)
    address, outs = check(logits, "logits", (*n,), np.float32), (masks.ctypes.data, slope.ctypes.data)
    call_library("svrgs_sample_masks", address, len(logits), seed, step, *outs)
    return masks, slope

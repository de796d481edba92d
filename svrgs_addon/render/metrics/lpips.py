"""LPIPS v0.1 with the VGG16 backbone (Zhang et al. 2018). The weights are not part of this project: `make
lpips` fetches them. With the package lpips installed, this line writes the same file:

    np.savez("lpips_vgg.npz", **{k: v.numpy() for k, v in lpips.LPIPS(net="vgg").state_dict().items()})

It must have these keys, all with floats; other keys are ignored:
    backbone  features.I.weight, features.I.bias   as in torchvision's vgg16; or net.sliceS.I.weight … as in
              the package lpips
    heads     linK.model.1.weight, K = 0 … 4       or lins.K.model.1.weight; shape (1, C, 1, 1)
"""

from __future__ import annotations

import os
import re
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import numpy as np

from ...native.pictures import convolved, filter_panels
from ...scene.camera import Camera
from ...system.errors import FormatError, SceneError
from ...system.wheels import cache_folder
from .measures import image_pair

NAME = "lpips_vgg.npz"  # of the weight file in the user's cache folder
VARIABLE = "SVRGS_LPIPS_WEIGHTS"  # of the environment: another weight file; empty: none
# VGG16 up to relu5_3: (index in torchvision's `features`, output channels) of convolutions, a row per stage
STAGES = (
    ((0, 64), (2, 64)),
    ((5, 128), (7, 128)),
    ((10, 256), (12, 256), (14, 256)),
    ((17, 512), (19, 512), (21, 512)),
    ((24, 512), (26, 512), (28, 512)),
)
# the scaling layer (x - SHIFT) / SCALE: mean and deviation of ImageNet for inputs in [-1, 1]
SHIFT = np.array([-0.030, -0.088, -0.188], np.float32)
SCALE = np.array([0.458, 0.448, 0.450], np.float32)
# factor and offset of colours in [0, 1] before the network: none, as in the scripts of 3DGS and later work,
# or those that give [-1, 1], as its authors say
INPUT_RANGES = {"3dgs": (1.0, 0.0), "authors": (2.0, -1.0)}
MIN_SIDE = 2 ** (len(STAGES) - 1)  # pixels; the network halves the image four times
ROWS = 32  # of pixels, that are compared at once
UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError),
    *(TypeError, ValueError, KeyError, AttributeError),  # which NumPy raises for malformed content
)
NO_WEIGHTS = "no LPIPS weights: give --lpips-weights; in a checkout, make lpips fetches them"
KEY_PATTERNS = (
    (re.compile(r"net\.slice\d\.(\d+)\.(weight|bias)"), r"features.\1.\2"),
    (re.compile(r"lins\.(\d)\.model\.1\.weight"), r"lin\1.model.1.weight"),
)


class Lpips:
    """The network with loaded weights. Call it with two images."""

    def __init__(self, weights: dict[str, np.ndarray], input_range: str = "3dgs"):
        """weights: float32 arrays by the first of the key names above. input_range: of INPUT_RANGES."""
        self.input_range = input_range
        # but for the convolutions', of which it keeps panels
        self._weights = {key: w for key, w in weights.items() if key.endswith("bias") or w.shape[0] == 1}
        self._panels = {
            index: filter_panels(weights[f"features.{index}.weight"])
            for stage in STAGES
            for index, _ in stage
        }

    def __call__(self, a: np.ndarray, b: np.ndarray) -> float:
        """LPIPS distance >= 0 of two images (H, W, 3) in [0, 1], H and W at least MIN_SIDE; lower is better,
        0: equal images. Distances of different INPUT_RANGES cannot be compared. Raises SceneError."""
        a, b = image_pair(a, b)
        if min(a.shape[:2]) < MIN_SIDE:
            raise SceneError(
                f"LPIPS needs images of at least {MIN_SIDE} x {MIN_SIDE} pixels, not {a.shape[1]} x"
                f" {a.shape[0]}"
            )
        pairs = zip(self._features(a), self._features(b), strict=True)
        return sum(self._distance(k, *pair) for k, pair in enumerate(pairs))

    def _features(self, image: np.ndarray) -> Iterator[np.ndarray]:
        """The values (h, w, C) after the last ReLU of each stage."""
        factor, offset = INPUT_RANGES[self.input_range]
        x = (image.astype(np.float32) * np.float32(factor) + np.float32(offset) - SHIFT) / SCALE
        for k, stage in enumerate(STAGES):
            if k > 0:
                x = _halved(x)
            for index, _ in stage:
                x = convolved(x, self._panels[index], self._weights[f"features.{index}.bias"])
            yield x

    def _distance(self, k: int, a: np.ndarray, b: np.ndarray) -> float:
        """Squared difference of normalised features, weighted by channel, mean over pixels (equation 1)."""
        weights, total = self._weights[f"lin{k}.model.1.weight"].ravel(), 0.0
        for top in range(0, len(a), ROWS):
            rows = slice(top, top + ROWS)
            difference = a[rows] / (_length(a[rows]) + 1e-10) - b[rows] / (_length(b[rows]) + 1e-10)
            total += float((np.square(difference) @ weights).sum(dtype=np.float64))
        return total / (a.shape[0] * a.shape[1])


def _length(x: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("hwc,hwc->hw", x, x))[:, :, None]


def _halved(x: np.ndarray) -> np.ndarray:
    """The largest of each 2 x 2 values; a last odd row or column is left out."""
    height, width = x.shape[0] // 2 * 2, x.shape[1] // 2 * 2
    rows = np.maximum(x[0:height:2, :width], x[1:height:2, :width])
    return np.maximum(rows[:, 0::2], rows[:, 1::2])


def load_lpips(path: str | Path | None, input_range: str = "3dgs") -> tuple[Lpips | None, str]:
    """Loads the network from a weight file. Returns (network, ""), or (None, reason), which a report can
    print. path: None: weights_file(); "": none. input_range: a key of INPUT_RANGES.

    Reasons are: no such file. Raises FormatError if the file exists but is not a complete set of LPIPS-VGG16
    weights.
    """
    file = weights_file() if path is None else Path(path or os.devnull)
    if not file.is_file():
        return None, f"LPIPS weight file {path} does not exist" if path else NO_WEIGHTS
    found = {_plain_key(key): value for key, value in _read(file).items()}
    return Lpips(
        {key: _checked(found, key, shape, file) for key, shape in _expected().items()}, input_range
    ), ""


def measurable(
    found: tuple[Lpips | None, str], cameras: Iterable[Camera], asked: bool
) -> tuple[Lpips | None, str]:
    """What load_lpips() has found, without the network if a view of the cameras is too small for it and it
    was not asked for."""
    small = any(min(camera.width, camera.height) < MIN_SIDE for camera in cameras)
    return (None, f"a view has less than {MIN_SIDE} x {MIN_SIDE} pixels") if small and not asked else found


@cache
def default_lpips() -> Lpips:
    """The network with the weights of weights_file(). Raises SceneError if they are missing."""
    network, reason = load_lpips(None)
    if network is None:
        raise SceneError(reason)
    return network


def weights_file() -> Path:
    """That of VARIABLE, or else what `make lpips` writes; os.devnull where there is neither."""
    try:
        return Path(os.environ.get(VARIABLE, cache_folder() / NAME) or os.devnull)
    except SceneError:  # the user has no folder
        return Path(os.devnull)


def _read(path: Path) -> dict[str, np.ndarray]:
    """The content of the file by its own keys, unchecked. Raises FormatError if it cannot be read."""
    if path.suffix != ".npz":
        raise FormatError(f"{path} is not an LPIPS weight file, which ends with .npz")
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}
    except UNREADABLE as error:
        raise FormatError(f"{path} cannot be read as LPIPS weights ({type(error).__name__})") from error


def _plain_key(key: str) -> str:
    """The first of the two names of a key (see above); other keys are returned unchanged."""
    for pattern, plain in KEY_PATTERNS:
        if pattern.fullmatch(key):
            return pattern.sub(plain, key)
    return key


def _expected() -> dict[str, tuple[int, ...]]:
    """{key: shape} of all arrays that the network needs."""
    shapes: dict[str, tuple[int, ...]] = {}
    channels = 3
    for k, stage in enumerate(STAGES):
        for index, out in stage:
            shapes[f"features.{index}.weight"] = (out, channels, 3, 3)
            shapes[f"features.{index}.bias"] = (out,)
            channels = out
        shapes[f"lin{k}.model.1.weight"] = (1, channels, 1, 1)
    return shapes


def _checked(found: dict[str, np.ndarray], key: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    """The array of a key as float32. Raises FormatError if it is missing, another one, or not finite."""
    if key not in found:
        raise FormatError(
            f"{path} lacks {key}, so it is not a complete set of LPIPS-VGG16 weights; write the file again"
        )
    array = found[key]
    if not np.issubdtype(array.dtype, np.floating) or array.shape != shape:
        raise FormatError(f"{path}: {key} is {array.dtype}{array.shape}; expected floats of shape {shape}")
    if not np.isfinite(array).all():
        raise FormatError(f"{path}: {key} holds NaN or infinite values; write the file again")
    return array.astype(np.float32)

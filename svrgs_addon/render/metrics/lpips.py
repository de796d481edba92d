"""LPIPS v0.1 with the VGG16 backbone (Zhang et al. 2018). The user gives one weight file.

The weights are not part of this project. With the package lpips installed, this line writes a weight file:

    torch.save(lpips.LPIPS(net="vgg").state_dict(), "lpips_vgg.pt")

The file is a state dict (.pt, .pth) or arrays (.npz). It must have these keys, all with floats; other keys
are ignored:
    backbone  features.I.weight, features.I.bias   as in torchvision's vgg16; or net.sliceS.I.weight … as in
              the package lpips
    heads     linK.model.1.weight, K = 0 … 4       or lins.K.model.1.weight; shape (1, C, 1, 1)
"""

from __future__ import annotations

import importlib.util
import pickle
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ...system.errors import FormatError, SceneError
from .measures import image_pair

# VGG16 up to relu5_3: (index in torchvision's `features`, output channels) of each convolution, one row per
# stage.
STAGES = (
    ((0, 64), (2, 64)),
    ((5, 128), (7, 128)),
    ((10, 256), (12, 256), (14, 256)),
    ((17, 512), (19, 512), (21, 512)),
    ((24, 512), (26, 512), (28, 512)),
)
# the scaling layer (x - SHIFT) / SCALE: mean and deviation of ImageNet for inputs in [-1, 1]
SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)
MIN_SIDE = 2 ** (len(STAGES) - 1)  # pixels; the network halves the image four times
UNREADABLE = (
    # of NumPy and torch
    *(pickle.UnpicklingError, zipfile.BadZipFile, zlib.error, OSError, EOFError, RuntimeError),
    *(TypeError, ValueError, KeyError, AttributeError),  # which they raise for malformed content
)
SUFFIXES = (".npz", ".pt", ".pth")
KEY_PATTERNS = (
    (re.compile(r"net\.slice\d\.(\d+)\.(weight|bias)"), r"features.\1.\2"),
    (re.compile(r"lins\.(\d)\.model\.1\.weight"), r"lin\1.model.1.weight"),
)


class Lpips:
    """The network with loaded weights. Call it with two images."""

    def __init__(self, weights: dict[str, Any]):
        """weights: all tensors, torch float32, by the first of the two key names above."""
        self._weights = weights

    def __call__(self, a: np.ndarray, b: np.ndarray) -> float:
        """LPIPS distance >= 0 of two images (H, W, 3) in [0, 1], H and W at least MIN_SIDE; lower is better,
        0: equal images.

        Values in [0, 1] are the direct input of the network, as in the scripts of 3DGS and later work, so
        that results can be compared. The network was made for inputs in [-1, 1], so the call in its authors'
        README gives other results. Raises SceneError.
        """
        import torch

        a, b = image_pair(a, b)
        if min(a.shape[:2]) < MIN_SIDE:
            raise SceneError(
                f"LPIPS needs images of at least {MIN_SIDE} x {MIN_SIDE} pixels, not {a.shape[1]} x"
                f" {a.shape[0]}"
            )
        batch = torch.from_numpy(np.stack([a, b])).permute(0, 3, 1, 2).contiguous()
        with torch.no_grad():
            return sum(
                self._stage_distance(k, activations)
                for k, activations in enumerate(self._stage_activations(batch))
            )

    def _stage_activations(self, batch):
        """Yields the activations (2, C, h, w) after the last ReLU of each stage."""
        import torch
        from torch.nn.functional import conv2d, max_pool2d

        x = (batch - torch.tensor(SHIFT).view(1, 3, 1, 1)) / torch.tensor(SCALE).view(1, 3, 1, 1)
        for k, stage in enumerate(STAGES):
            if k > 0:
                x = max_pool2d(x, 2)
            for index, _ in stage:
                weight, bias = (self._weights[f"features.{index}.{part}"] for part in ("weight", "bias"))
                x = conv2d(x, weight, bias, padding=1).relu_()
            yield x

    def _stage_distance(self, k: int, activations) -> float:
        """Squared difference of normalised feature vectors, weighted per channel, mean over pixels (equation
        1 of the paper)."""
        unit = activations / (activations.norm(dim=1, keepdim=True) + 1e-10)
        squared = (unit[0] - unit[1]).square()
        head = self._weights[f"lin{k}.model.1.weight"].view(-1, 1, 1)
        return float((head * squared).sum(dim=0).mean())


def load_lpips(path: str | Path | None) -> tuple[Lpips | None, str]:
    """Loads the network from a weight file. Returns (network, ""), or (None, reason), which a report can
    print.

    Reasons are: no path, no such file, torch is not installed. Raises FormatError if the file exists but is
    not a complete set of LPIPS-VGG16 weights. Pickled code in the file is never run.
    """
    if path is None:
        return None, "no LPIPS weight file was given"
    path = Path(path)
    if not path.is_file():
        return None, f"LPIPS weight file {path} does not exist"
    if importlib.util.find_spec("torch") is None:
        return None, "LPIPS needs torch, which is not installed"
    found = {_plain_key(key): value for key, value in _read(path).items()}
    return Lpips({key: _checked(found, key, shape, path) for key, shape in _expected().items()}), ""


def _read(path: Path) -> dict[str, Any]:
    """The content of the file by its own keys, unchecked. Raises FormatError if it cannot be read."""
    import torch

    if path.suffix not in SUFFIXES:
        raise FormatError(f"{path} is not an LPIPS weight file; expected one of {', '.join(SUFFIXES)}")
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                return {key: torch.from_numpy(archive[key]) for key in archive.files}
        content = torch.load(path, map_location="cpu", weights_only=True)
    except UNREADABLE as error:
        raise FormatError(f"{path} cannot be read as LPIPS weights ({type(error).__name__})") from error
    if not isinstance(content, dict):
        raise FormatError(f"{path} holds a {type(content).__name__}; expected a state dict")
    return content


def _plain_key(key: str) -> str:
    """The first of the two names of a key (see above); other keys are returned unchanged."""
    for pattern, plain in KEY_PATTERNS:
        if pattern.fullmatch(str(key)):
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


def _checked(found: dict[str, Any], key: str, shape: tuple[int, ...], path: Path):
    """The tensor of a key as float32. Raises FormatError if it is missing, has another shape or type, or is
    not finite."""
    import torch

    if key not in found:
        raise FormatError(
            f"{path} lacks {key}, so it is not a complete set of LPIPS-VGG16 weights; write the file again"
        )
    tensor = found[key]
    if not isinstance(tensor, torch.Tensor) or not tensor.is_floating_point() or tuple(tensor.shape) != shape:
        kind = type(tensor).__name__
        if isinstance(tensor, torch.Tensor):
            kind = f"{tensor.dtype}{tuple(tensor.shape)}"
        raise FormatError(f"{path}: {key} is {kind}; expected floats of shape {shape}")
    if not tensor.isfinite().all():
        raise FormatError(f"{path}: {key} holds NaN or infinite values; write the file again")
    return tensor.float()

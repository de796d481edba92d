"""What else steps could learn from, so that few Gaussians keep the texture: the runs of benchmarks/methods.py
--study texture. Written to be read, not to be fast: seconds of these runs say nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, conv2d, max_pool2d, relu

from svrgs_addon.finetune import engine, run
from svrgs_addon.finetune.torch_engine import ssim
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.metrics import lpips
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import PARAMETERS

SIZES = 3  # full, half and a quarter
SQUARE = 96  # side of the square of a picture that the network sees in a step, in pixels


def sizes(picture: Tensor, photo: Tensor) -> list[tuple[Tensor, Tensor]]:
    """Both (1, C, H, W) in full size, half and a quarter."""
    return [(avg_pool2d(picture, 2**k), avg_pool2d(photo, 2**k)) for k in range(SIZES)]


def gradients(picture: Tensor, photo: Tensor) -> Tensor:
    """Mean absolute difference of the horizontal and the vertical gradients, over all sizes."""
    errors = [a - b for a, b in sizes(picture, photo)]
    return torch.stack([e.diff(dim=2).abs().mean() + e.diff(dim=3).abs().mean() for e in errors]).mean()


def scales(picture: Tensor, photo: Tensor) -> Tensor:
    """1 - SSIM in half the size and a quarter."""
    smaller = [[x[0].permute(1, 2, 0) for x in pair] for pair in sizes(picture, photo)[1:]]
    return torch.stack([1 - ssim(a, b) for a, b in smaller]).mean()


def contrast(picture: Tensor, photo: Tensor) -> Tensor:
    """Mean absolute difference of the standard deviations of the luminance in windows of 7 x 7 pixels, over
    all sizes."""

    def deviation(image: Tensor) -> Tensor:
        grey = image.mean(1, keepdim=True)
        return (avg_pool2d(grey**2, 7, 1) - avg_pool2d(grey, 7, 1) ** 2).clamp_min(1e-8).sqrt()

    pairs = sizes(picture, photo)
    return torch.stack([(deviation(a) - deviation(b)).abs().mean() for a, b in pairs]).mean()


class Network:
    """LPIPS itself, of a square of the picture that is another one in each step."""

    def __init__(self):
        network = lpips.default_lpips()
        self._weights = {key: torch.from_numpy(value) for key, value in network._weights.items()}
        self._filters = {
            index: torch.from_numpy(np.ascontiguousarray(panels.transpose(0, 4, 3, 1, 2))).flatten(0, 1)
            for index, panels in network._panels.items()
        }
        self._rng = np.random.default_rng(0)

    def __call__(self, picture: Tensor, photo: Tensor) -> Tensor:
        top, left = (self._rng.integers(0, max(1, side - SQUARE + 1)) for side in picture.shape[2:])
        place = np.s_[:, :, top : top + SQUARE, left : left + SQUARE]
        with torch.no_grad():
            wanted = self._features(photo[place])
        pairs = zip(self._features(picture[place]), wanted, strict=True)
        return torch.stack([self._distance(k, a, b) for k, (a, b) in enumerate(pairs)]).sum()

    def _features(self, x: Tensor) -> list[Tensor]:
        shift, scale = (torch.from_numpy(v)[None, :, None, None] for v in (lpips.SHIFT, lpips.SCALE))
        x, found = (x - shift) / scale, []
        for k, stage in enumerate(lpips.STAGES):
            x = max_pool2d(x, 2) if k else x
            for index, _ in stage:
                x = relu(conv2d(x, self._filters[index], self._weights[f"features.{index}.bias"], padding=1))
            found.append(x)
        return found

    def _distance(self, k: int, a: Tensor, b: Tensor) -> Tensor:
        a, b = (x / ((x**2).sum(1, keepdim=True) + 1e-20).sqrt() for x in (a, b))
        return ((a - b) ** 2 * self._weights[f"lin{k}.model.1.weight"].reshape(1, -1, 1, 1)).sum(1).mean()


TERMS: dict[str, Callable[[], Callable[[Tensor, Tensor], Tensor]]] = {
    "gradients": lambda: gradients,
    "SSIM of smaller sizes": lambda: scales,
    "local contrast": lambda: contrast,
    "LPIPS": Network,
}


def add_term(name: str, weight: float):
    """Every step of this process also learns from a term of TERMS, which is added to the loss."""
    term, own = TERMS[name](), engine.NativeEngine._image_loss

    def image_loss(self, step, rgb):
        l1, similarity, grad = own(self, step, rgb)
        picture, photo = (
            torch.from_numpy(np.ascontiguousarray(x)).permute(2, 0, 1)[None] for x in (rgb, step.target)
        )
        picture.requires_grad_(True)
        (weight * term(picture, photo)).backward()
        return l1, similarity, np.ascontiguousarray(grad + picture.grad[0].permute(1, 2, 0).numpy())

    engine.NativeEngine._image_loss = image_loss


def add_teacher():
    """Every second step of this process sees a view halfway between a camera and its nearest neighbour, and
    learns from the picture that the scene had there before the first step."""
    step, advance = engine.NativeEngine.step, run.Run.advance
    seen, rasterizer, original = {}, Rasterizer(), []

    def advancing(self):
        if not original:
            arrays = {name: getattr(self.model, name).copy() for name in PARAMETERS}
            original.append(SimpleNamespace(**arrays, count=self.model.count))
        advance(self)

    def stepping(self, model, given):
        seen[given.camera.name] = given.camera
        if given.number % 2 and len(seen) > 1:
            camera = halfway(given.camera, list(seen.values()))
            picture = rasterizer.forward(original[0], camera, given.options)["rgb"]
            given = replace(given, camera=camera, target=np.clip(picture, 0, 1))
        return step(self, model, given)

    engine.NativeEngine.step, run.Run.advance = stepping, advancing


def halfway(camera: Camera, others: list[Camera]) -> Camera:
    """The view between a camera and the nearest of the others."""
    near = min(
        (other for other in others if other is not camera),
        key=lambda other: float(np.linalg.norm(other.position - camera.position)),
    )
    u, _, v = np.linalg.svd(camera.viewmat[:3, :3] + near.viewmat[:3, :3])
    viewmat = np.eye(4)
    viewmat[:3, :3] = u @ v
    viewmat[:3, 3] = -(u @ v) @ (camera.position + near.position) / 2
    return replace(camera, viewmat=viewmat, valid_bits=None)

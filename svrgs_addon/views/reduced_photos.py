"""Photographs at the size and type that a loss needs."""

from __future__ import annotations

import numpy as np

from ..scene.camera import Camera

MIN_SIDE = 16  # pixels: no photograph is reduced to a shorter side


def fitting_reduction(factor: int, width: int, height: int) -> int:
    """`factor`, halved until the reduced shorter side has at least MIN_SIDE pixels; at least 1."""
    while factor > 1 and min(width, height) < factor * MIN_SIDE:
        factor //= 2
    return factor


def reduction_to(side: int, camera: Camera) -> int:
    """By what a view is reduced so that its longer side has about `side` pixels, and its shorter one some."""
    factor = min(max(camera.width, camera.height) // side, min(camera.width, camera.height) // MIN_SIDE)
    return camera.reducible(max(1, factor))


def as_real(image: np.ndarray, dtype, factor: int = 1) -> np.ndarray:
    """A photograph for the loss: (H // factor, W // factor, 3) of the given dtype, display sRGB in 0..1. Each
    pixel is the mean of factor x factor pixels of the photograph (see Camera.reduced)."""
    scale = dtype.type((1 / 255 if image.dtype == np.uint8 else 1.0) / factor**2)
    if factor == 1:
        return np.ascontiguousarray(image, dtype) if scale == 1 else np.multiply(image, scale, dtype=dtype)
    height, width = image.shape[0] // factor, image.shape[1] // factor
    sums = np.uint16 if image.dtype == np.uint8 else dtype
    rows = sum_of(sums, [image[k : height * factor : factor] for k in range(factor)])
    reduced = np.empty((height, width, 3), dtype)
    # one channel at a time, so that NumPy's inner loop runs along rows: 2 to 9 times as fast
    for channel in range(3):
        columns = [rows[:, k : width * factor : factor, channel] for k in range(factor)]
        np.multiply(sum_of(rows.dtype, columns), scale, out=reduced[:, :, channel])
    return reduced


def photo_of(camera: Camera, image: np.ndarray, dtype, factor: int) -> np.ndarray:
    """as_real() of the photograph of a view; 0 where pixels do not count, also where a part of them does not.
    camera: reduced by the factor."""
    photo, valid = as_real(image, dtype, factor), camera.valid if factor > 1 else None
    return photo if valid is None else photo * valid[..., None]


def reduced_view(camera: Camera, image: np.ndarray, side: int) -> tuple[Camera, np.ndarray]:
    """A view whose longer side has about `side` pixels, and its photograph, float32. image: as
    Dataset.image() gives it."""
    factor = reduction_to(side, camera)
    small = camera.reduced(factor)
    return small, photo_of(small, image, np.dtype(np.float32), factor)


def toned(image: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """An image (..., 3), uint8 or float in 0..1, whose channels follow a curve (3, 256): the value in 0..1
    for each 8-bit value. It keeps its type."""
    if image.dtype == np.uint8:
        table = np.rint(255 * curve).astype(np.uint8)
        return np.stack([table[k][image[..., k]] for k in range(3)], axis=-1)
    values = np.linspace(0, 1, curve.shape[1])
    channels = [np.interp(image[..., k], values, curve[k]) for k in range(3)]
    return np.stack(channels, axis=-1).astype(image.dtype)


def sum_of(dtype, parts: list[np.ndarray]) -> np.ndarray:
    """The sum of arrays of one shape, of the given dtype."""
    total = parts[0].astype(dtype)
    for part in parts[1:]:
        total += part
    return total

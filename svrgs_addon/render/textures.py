"""Pictures on triangles: sRGB with levels of half the size, so that far surfaces do not flicker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..files.images import linear_to_srgb, srgb_to_linear, to_bytes

LARGEST = 2048  # texels on the longer side; larger pictures begin with a smaller level


@dataclass(frozen=True)
class Texture:
    """A picture and its levels, each with half the sides of the one before, rounded up, down to 1 x 1."""

    texels: np.ndarray  # (n, 3) uint8 display sRGB, level after level, rows from v = 0 on
    width: int  # of the first level
    height: int
    repeat: bool  # outside 0..1: the picture again; else its border

    @property
    def mean(self) -> np.ndarray:
        """(3,) linear colour."""
        return srgb_to_linear(self.texels[-1] / np.float32(255))


def texture(pixels: np.ndarray, repeat: bool = True) -> Texture:
    """pixels: (H, W, 3) display sRGB, float32 0..1 or uint8, rows from v = 0 on. Means are linear."""
    levels = [to_bytes(pixels)]
    linear = srgb_to_linear(np.arange(256, dtype=np.float32) / 255)[levels[0]]
    while max(linear.shape[:2]) > 1:
        linear = _halved(linear)
        if max(levels[0].shape[:2]) > LARGEST:
            levels.clear()
        levels.append(to_bytes(linear_to_srgb(linear)))
    height, width, _ = levels[0].shape
    return Texture(np.concatenate([level.reshape(-1, 3) for level in levels]), width, height, repeat)


def _halved(pixels: np.ndarray) -> np.ndarray:
    """Means of 2 x 2 pixels; a last odd row or column counts twice."""
    height, width, _ = pixels.shape
    even = np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / np.float32(4)

"""A picture in the colours of its photograph, for cc-PSNR: what is left of the error once exposure and white
balance no longer count. As mip-NeRF 360, Nerfstudio and gsplat measure held-out views.

Each channel becomes a quadratic polynomial of the three channels, by least squares over the pixels that are
neither black nor white, in either picture. As these change with the colours, it is done ROUNDS times.
"""

from __future__ import annotations

import numpy as np

ROUNDS, CLIPPED = 5, 0.5 / 255
STRIP = 1 << 15  # pixels that are done at a time


def colour_matched(image: np.ndarray, photo: np.ndarray, valid: np.ndarray | None = None) -> np.ndarray:
    """The image with the colours of the photograph, (H, W, 3) float32 in 0..1. image, photo: (H, W, 3) in
    0..1. valid: (H, W), 0 where pixels do not count and stay as they are; None: all do."""
    counts = slice(None) if valid is None else valid.ravel() != 0
    colours = image.reshape(-1, 3)[counts].astype(np.float64)
    wanted = photo.reshape(-1, 3)[counts]
    usable = _usable(colours) & _usable(wanted)
    strips = [slice(k, k + STRIP) for k in range(0, len(colours), STRIP)]
    for _ in range(ROUNDS):
        products, sums, pixels = np.zeros((3, 10, 10)), np.zeros((3, 10)), np.zeros(3)
        for strip in strips:
            terms = _terms(colours[strip])
            rows = usable[strip] & _usable(colours[strip])
            pixels += rows.sum(axis=0)
            for channel in range(3):
                weighted = terms * rows[:, channel]  # sums over pixels, without a copy of those that count
                products[channel] += weighted @ terms.T
                sums[channel] += weighted @ wanted[strip, channel]
        fitted = [k for k in range(3) if pixels[k] > len(sums[k])]
        weights = {k: np.linalg.lstsq(products[k], sums[k], rcond=None)[0] for k in fitted}
        for strip in strips:
            terms = _terms(colours[strip])
            for channel in fitted:
                colours[strip, channel] = np.clip(weights[channel] @ terms, 0, 1)
    result = image.astype(np.float32).reshape(-1, 3).copy()
    result[counts] = colours
    return result.reshape(image.shape)


def _usable(values: np.ndarray) -> np.ndarray:
    return (values >= CLIPPED) & (values <= 1 - CLIPPED)


def _terms(colours: np.ndarray) -> np.ndarray:
    """(10, n): the products of two channels, the channels, and 1."""
    channels = np.ascontiguousarray(colours.T)
    pairs = [channels[i] * channels[j] for i in range(3) for j in range(i, 3)]
    return np.stack([*pairs, *channels, np.ones(len(colours))])

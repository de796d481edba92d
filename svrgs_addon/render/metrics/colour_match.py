"""A picture in the colours of its photograph, for cc-PSNR: what is left of the error once exposure and white
balance no longer count. As mip-NeRF 360, Nerfstudio and gsplat measure held-out views.

Each channel becomes a quadratic polynomial of the three channels, by least squares over the pixels that are
neither black nor white, in either picture. As these change with the colours, it is done ROUNDS times.
"""

from __future__ import annotations

import numpy as np

ROUNDS, CLIPPED = 5, 0.5 / 255


def colour_matched(image: np.ndarray, photo: np.ndarray, valid: np.ndarray | None = None) -> np.ndarray:
    """The image with the colours of the photograph, (H, W, 3) float32 in 0..1. image, photo: (H, W, 3) in
    0..1. valid: (H, W), 0 where pixels do not count and stay as they are; None: all do."""
    counts = slice(None) if valid is None else valid.ravel() != 0
    colours = image.reshape(-1, 3)[counts].astype(np.float64)
    wanted = photo.reshape(-1, 3)[counts].astype(np.float64)
    usable = _usable(colours) & _usable(wanted)
    for _ in range(ROUNDS):
        terms = _terms(colours)
        matched = colours.copy()
        for channel in range(3):
            rows = (usable[:, channel] & _usable(colours[:, channel])).astype(np.float64)
            if rows.sum() > len(terms):
                weighted = terms * rows  # sums over pixels, without a copy of those that count
                weights = np.linalg.lstsq(weighted @ terms.T, weighted @ wanted[:, channel], rcond=None)[0]
                matched[:, channel] = np.clip(weights @ terms, 0, 1)
        colours = matched
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

"""Perceptually uniform colour maps, which people with colour vision deficiency can read too."""

from __future__ import annotations

import numpy as np

from ..files.images import srgb_to_linear

# By S. van der Walt, N. Smith and E. Firing (CC0); 17 of 256 colours of each. Linear interpolation differs
# from the full tables by at most 7 of 255.
_HEX = {
    "inferno": (
        "000003 0a0723 200c4a 3c0965 570f6d 70196e 892269 a32b61 bb3754 d14643 e45a31 f1721d f98e08 fbac10"
        " f8cb34 f1e968 fcfea4"
    ),
    "viridis": (
        "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c 1f9f88 27ad81 3dbc74 5cc863 81d34d"
        " aadc32 d5e21a fde725"
    ),
    "magma": (
        "000004 0a0822 1d1147 36106b 51127c 6a1c81 832681 9c2e7f b73779 cf4070 e55064 f4695c fb8761 fea571"
        " fec287 fde0a1 fcfdbf"
    ),
    "grey": "000000 ffffff",
}
NAMES = tuple(_HEX)


def hex_colors() -> tuple[str, ...]:
    """Evenly spaced colours of inferno from low to high, '#rrggbb' in display sRGB."""
    return tuple(f"#{code}" for code in _HEX["inferno"].split())


def pixels(values: np.ndarray, top: float, name: str) -> np.ndarray:
    """Values (H, W) as linear colours (H, W, 3) of the map `name`; without such a map, as they are."""
    if name in NAMES:
        return srgb_to_linear(colored(values, top, name))
    return np.repeat(values[..., None], 3, axis=2)


def colored(values: np.ndarray, top: float, name: str = "inferno") -> np.ndarray:
    """Maps finite values (...) to display sRGB colours (..., 3) float64 in 0..1. Values <= 0 have the first
    colour of the map, values >= top the last one."""
    table = np.array([list(bytes.fromhex(code)) for code in _HEX[name].split()]) / 255
    scaled = np.asarray(values, np.float64) * ((len(table) - 1) / top if top > 0 else 0)
    return np.stack([np.interp(scaled, np.arange(len(table)), table[:, c]) for c in range(3)], axis=-1)

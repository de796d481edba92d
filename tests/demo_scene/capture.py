"""What a phone makes of the light: blur, exposure and white balance that drift, noise. Plain NumPy: no
Blender here."""

import math

import numpy as np

DRIFT = 0.10  # of exposure and of the ratio of red to blue, from their least to their greatest
FOCUS = 0.7  # pixels, standard deviation of the blur of lens and sensor
# pixels that the picture moves while it is taken: most views, every SHAKEN-th view
SHAKE = (0.0, 1.5), (2.0, 3.0)
SHAKEN = 6
NOISE = 0.008  # standard deviation where the linear value is 1; it grows with the square root of the light


def gains(count: int) -> np.ndarray:
    """Factors of linear red, green and blue in each of `count` views, (count, 3), smooth from view to
    view."""
    along = np.linspace(0, 1, count)
    exposure = 1 + DRIFT / 2 * np.sin(2 * np.pi * (0.75 * along + 0.1))
    warmth = np.sqrt(1 + DRIFT / 2 * np.cos(np.pi * along))
    return exposure[:, None] * np.stack([warmth, np.ones(count), 1 / warmth], axis=1)


def photograph(linear: np.ndarray, gain: np.ndarray, seed: int) -> np.ndarray:
    """A linear picture (H, W, 3) as view number `seed` of a phone shows it: (H, W, 3) uint8 sRGB."""
    rng = np.random.default_rng([7, seed])
    light = (
        _shaken(_blurred(linear), rng.uniform(*SHAKE[seed % SHAKEN == SHAKEN - 1]), rng.uniform(0, np.pi))
        * gain
    )
    light += NOISE * np.sqrt(light) * rng.standard_normal(light.shape)
    return srgb(light)


def srgb(linear: np.ndarray) -> np.ndarray:
    """Linear values to uint8; those outside 0..1 are clipped."""
    value = np.clip(linear, 0, 1)
    encoded = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.rint(encoded * 255).astype(np.uint8)


def _blurred(picture: np.ndarray) -> np.ndarray:
    reach = math.ceil(3 * FOCUS)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / FOCUS) ** 2)
    for axis in (0, 1):
        ends = [(reach, reach) if k == axis else (0, 0) for k in range(3)]
        padded = np.pad(picture, ends, mode="edge")
        shifted = [
            np.take(padded, np.arange(k, k + picture.shape[axis]), axis=axis) for k in range(len(weights))
        ]
        picture = np.tensordot(weights / weights.sum(), shifted, axes=1)
    return picture


def _shaken(picture: np.ndarray, length: float, angle: float) -> np.ndarray:
    """The mean of the picture along a line of `length` pixels, whose middle is the pixel itself."""
    steps = np.linspace(-length / 2, length / 2, 9)
    return np.mean([_shifted(picture, step * np.cos(angle), step * np.sin(angle)) for step in steps], axis=0)


def _shifted(picture: np.ndarray, right: float, down: float) -> np.ndarray:
    """Moved by less than two pixels, bilinearly; the border is continued."""
    height, width = picture.shape[:2]
    padded = np.pad(picture, ((2, 2), (2, 2), (0, 0)), mode="edge")
    x, y = 2 - right, 2 - down
    col, row = math.floor(x), math.floor(y)
    total = np.zeros_like(picture)
    for dx, across in ((0, 1 - (x - col)), (1, x - col)):
        for dy, along in ((0, 1 - (y - row)), (1, y - row)):
            total += across * along * padded[row + dy : row + dy + height, col + dx : col + dx + width]
    return total

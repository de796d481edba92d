"""LDR-FLIP (Andersson et al. 2020, doi 10.1145/3406183) in float64, of whole images and with whole filters.
Sections and equations are those of the paper."""

from __future__ import annotations

import math

import numpy as np

# Contrast sensitivity of the channels Y, Cx, Cz as sums of Gaussians with parameters (a, b) (table 1).
SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
COLOUR_EXPONENT, COLOUR_SPLIT, SPLIT_VALUE = 0.7, 0.4, 0.95  # q_c, p_c, p_t
FEATURE_WIDTH, FEATURE_EXPONENT = 0.082, 0.5  # w (degrees), q_f


def _xyz_from_rgb() -> np.ndarray:
    """Matrix (3, 3) from linear sRGB to XYZ divided by the XYZ of white, from the primaries and the white
    point D65 of IEC 61966-2-1."""
    x, y = np.array([[0.64, 0.30, 0.15], [0.33, 0.60, 0.06]])
    primaries = np.array([x / y, np.ones(3), (1 - x - y) / y])
    white = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
    matrix = primaries * np.linalg.solve(primaries, white)
    return matrix / matrix.sum(axis=1, keepdims=True)


XYZ_FROM_RGB = _xyz_from_rgb()
RGB_FROM_XYZ = np.linalg.inv(XYZ_FROM_RGB)


def flip_map(a: np.ndarray, b: np.ndarray, ppd: float) -> np.ndarray:
    """FLIP of each pixel (H, W) in [0, 1] (equation 13). a, b: (H, W, 3) display sRGB in [0, 1]. ppd: pixels
    per degree."""
    a, b = _opponents(a), _opponents(b)
    colour = _colour_difference(_hunt_lab(_contrast_filtered(a, ppd)), _hunt_lab(_contrast_filtered(b, ppd)))
    return colour ** (1 - _feature_difference(a[0], b[0], ppd))


def _opponents(image: np.ndarray) -> np.ndarray:
    """YCxCz (3, H, W) without scale and offset: (Y, X - Y, Y - Z) relative to white."""
    linear = np.where(image <= 0.04045, image / 12.92, ((np.maximum(image, 0) + 0.055) / 1.055) ** 2.4)
    x, y, z = np.einsum("ij,hwj->ihw", XYZ_FROM_RGB, linear)
    return np.stack([y, x - y, y - z])


def _hunt_lab(xyz: np.ndarray) -> np.ndarray:
    """CIELAB with a and b multiplied by L/100, the Hunt effect (section 4.1.2)."""
    delta = 6 / 29
    x, y, z = np.where(xyz > delta**3, np.cbrt(xyz), xyz / (3 * delta**2) + 4 / 29)
    lightness = 116 * y - 16
    return np.stack([lightness, 5 * (x - y) * lightness, 2 * (y - z) * lightness])


def _contrast_filtered(opponents: np.ndarray, ppd: float) -> np.ndarray:
    """Each channel filtered with its contrast sensitivity (equation 5), clamped to the sRGB gamut; XYZ
    relative to white."""
    y, cx, cz = (
        _filtered(plane, _sensitivity(terms, ppd))
        for plane, terms in zip(opponents, SENSITIVITY, strict=True)
    )
    rgb = np.einsum("ij,jhw->ihw", RGB_FROM_XYZ, np.stack([cx + y, y, y - cz]))
    return np.einsum("ij,jhw->ihw", XYZ_FROM_RGB, np.clip(rgb, 0, 1))


def _sensitivity(terms, ppd: float) -> np.ndarray:
    widest = max(b for channel in SENSITIVITY for _, b in channel)
    x, y = _offsets(math.ceil(3 * math.sqrt(widest / (2 * math.pi**2)) * ppd)) / ppd
    kernel = sum(a * np.sqrt(np.pi / b) * np.exp(-(np.pi**2) * (x**2 + y**2) / b) for a, b in terms)
    return kernel / kernel.sum()


def _offsets(radius: int) -> np.ndarray:
    """x and y of the taps of a filter, (2, 2 radius + 1, 2 radius + 1)."""
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float64)
    return np.stack([x, y])


def _filtered(plane: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """The plane correlated with an odd square kernel; outside are the values of the border."""
    radius = len(kernel) // 2
    padded = np.pad(plane, radius, "edge")
    return np.einsum("hwij,ij->hw", np.lib.stride_tricks.sliding_window_view(padded, kernel.shape), kernel)


def _hyab(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    d = p - q
    return np.abs(d[0]) + np.hypot(d[1], d[2])


def _colour_difference(lab_a: np.ndarray, lab_b: np.ndarray) -> np.ndarray:
    """HyAB distance to the power q_c, mapped piecewise linearly: p_c of the largest one becomes p_t (sections
    4.1.2, 4.1.3)."""
    green, blue = (_hunt_lab(XYZ_FROM_RGB[:, [c]]) for c in (1, 2))
    largest = _hyab(green, blue)[0] ** COLOUR_EXPONENT
    error, split = _hyab(lab_a, lab_b) ** COLOUR_EXPONENT, COLOUR_SPLIT * largest
    high = SPLIT_VALUE + (error - split) * (1 - SPLIT_VALUE) / (largest - split)
    return np.where(error < split, error * SPLIT_VALUE / split, high)


def _feature_difference(y_a: np.ndarray, y_b: np.ndarray, ppd: float) -> np.ndarray:
    """The larger one of the edge and the point difference (equation 12)."""
    edges, points = (np.abs(fa - fb) for fa, fb in zip(_features(y_a, ppd), _features(y_b, ppd), strict=True))
    return np.minimum(np.maximum(edges, points) / math.sqrt(2), 1) ** FEATURE_EXPONENT


def _features(y: np.ndarray, ppd: float) -> tuple[np.ndarray, np.ndarray]:
    """Norms of the first and of the second Gaussian derivatives of the luminance (section 4.2)."""
    sigma = 0.5 * FEATURE_WIDTH * ppd
    x, _ = _offsets(math.ceil(3 * sigma))
    gaussian = np.exp(-(_offsets(math.ceil(3 * sigma)) ** 2).sum(0) / (2 * sigma**2))
    derivatives = (_balanced(x * gaussian), _balanced((x**2 / sigma**2 - 1) * gaussian))
    edge, point = (np.hypot(_filtered(y, kernel), _filtered(y, kernel.T)) for kernel in derivatives)
    return edge, point


def _balanced(kernel: np.ndarray) -> np.ndarray:
    """Positive values scaled to sum 1, negative ones to sum -1."""
    return np.where(kernel > 0, kernel / kernel[kernel > 0].sum(), kernel / -kernel[kernel < 0].sum())

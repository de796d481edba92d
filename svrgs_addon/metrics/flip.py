"""LDR-FLIP: the difference that a viewer sees when flipping between two images.

Reference: P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström, M. D. Fairchild: "FLIP: A Difference
Evaluator for Alternating Images", HPG 2020 (doi 10.1145/3406183); sections, equations and tables below are those of
this paper.

Accuracy, measured against the authors' flip-evaluator 1.7 on nine pairs of 720 x 537 photographs (noise, blur, two views) and on
random images: means agree within 6e-6, single pixels within 6e-5.
"""

from __future__ import annotations

import math

import numpy as np

from .arrays import Window, filter_separable, image_pair, over_tiles

PIXELS_PER_DEGREE = 0.7 * (3840 / 0.7) * np.pi / 180  # 67.02: a monitor 0.7 m wide with 3840 pixels, seen from 0.7 m

# Contrast sensitivity of the channels Y, Cx, Cz as sums of Gaussians with parameters (a, b) (table 1).
SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
COLOUR_EXPONENT, COLOUR_SPLIT, SPLIT_VALUE = 0.7, 0.4, 0.95  # q_c, p_c, p_t
FEATURE_WIDTH, FEATURE_EXPONENT = 0.082, 0.5  # w (degrees), q_f


def _xyz_from_rgb() -> np.ndarray:
    """Matrix (3, 3) from linear sRGB to XYZ, computed from the primaries and the white point D65 of IEC 61966-2-1."""
    x, y = np.array([[0.64, 0.30, 0.15], [0.33, 0.60, 0.06]])
    primaries = np.array([x / y, np.ones(3), (1 - x - y) / y])
    white = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])
    return primaries * np.linalg.solve(primaries, white)


# XYZ divided by the XYZ of white, so that RGB (1, 1, 1) maps to (1, 1, 1). The colour spaces below use only this form.
_XYZ_MATRIX = _xyz_from_rgb()
WHITE_XYZ_FROM_RGB = _XYZ_MATRIX / _XYZ_MATRIX.sum(axis=1, keepdims=True)
RGB_FROM_WHITE_XYZ = np.linalg.inv(WHITE_XYZ_FROM_RGB)


def flip(a: np.ndarray, b: np.ndarray, ppd: float = PIXELS_PER_DEGREE) -> float:
    """Mean of flip_map() in [0, 1]; lower is better, 0: equal images."""
    return float(np.mean(flip_map(a, b, ppd), dtype=np.float64))


def flip_map(a: np.ndarray, b: np.ndarray, ppd: float = PIXELS_PER_DEGREE) -> np.ndarray:
    """FLIP of each pixel, (H, W) float32 in [0, 1]; symmetric in a and b (equation 13).

    a, b: (H, W, 3) display sRGB in [0, 1]. ppd: pixels per degree of the viewer's visual angle. Raises SceneError.
    """
    a, b = image_pair(a, b)
    errors = np.empty(a.shape[:2], np.float32)

    def fill(outer: Window, inner: Window):
        errors[outer][inner] = _tile_map(a[outer], b[outer], ppd)[inner]

    over_tiles(fill, a.shape, max(_sensitivity_radius(ppd), _feature_radius(ppd)))
    return errors


def _tile_map(a: np.ndarray, b: np.ndarray, ppd: float) -> np.ndarray:
    """flip_map() of one tile, without checks."""
    a, b = _opponents(a), _opponents(b)
    colour = _colour_difference(_hunt_lab(_contrast_filtered(a, ppd)), _hunt_lab(_contrast_filtered(b, ppd)))
    feature = _feature_difference(a[0], b[0], ppd)
    return colour ** (1 - feature)


# --- colour spaces; from here on, images are (3, H, W) float32 ---


def _opponents(image: np.ndarray) -> np.ndarray:
    """The opponent colours YCxCz (3, H, W) of an image (H, W, 3), without scale and offset: (Y, X - Y, Y - Z) relative to white.

    The filters have sum 1 and the conversion back is the exact inverse, so 116 Y - 16, 500 Cx and 200 Cz would cancel.
    """
    image = np.moveaxis(image, -1, 0)
    low = image <= 0.04045
    curve = ((np.maximum(image, 0) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    linear = np.where(low, image / np.float32(12.92), curve)
    x, y, z = _mix(WHITE_XYZ_FROM_RGB, linear)
    return np.stack([y, x - y, y - z])


def _mix(matrix: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Multiplies the colour of each pixel by a matrix (3, 3)."""
    return np.einsum("ij,jhw->ihw", matrix.astype(np.float32), planes)  # optimised, it would call a BLAS whose threads get in the way of the tiles


def _hunt_lab(white_xyz: np.ndarray) -> np.ndarray:
    """CIELAB with a and b multiplied by L/100, the Hunt effect (section 4.1.2): chroma counts less in dark colours."""
    delta = 6 / 29
    x, y, z = np.where(white_xyz > delta**3, np.cbrt(white_xyz), white_xyz / np.float32(3 * delta**2) + np.float32(4 / 29))
    lightness = 116 * y - 16
    hunt = lightness / 100
    return np.stack([lightness, 500 * (x - y) * hunt, 200 * (y - z) * hunt])


# --- colour pipeline (section 4.1) ---


def _contrast_filtered(opponents: np.ndarray, ppd: float) -> np.ndarray:
    """Filters each channel with its contrast sensitivity and clamps to the sRGB gamut. Returns XYZ relative to white."""
    y, cx, cz = (_sensitivity_filter(plane, terms, ppd) for plane, terms in zip(opponents, SENSITIVITY, strict=True))
    rgb = _mix(RGB_FROM_WHITE_XYZ, np.stack([cx + y, y, y - cz]))
    return _mix(WHITE_XYZ_FROM_RGB, np.clip(rgb, 0, 1))


def _sensitivity_filter(plane: np.ndarray, terms: tuple[tuple[float, float], ...], ppd: float) -> np.ndarray:
    """Filters with Σ a √(π/b) exp(-π² (x² + y²) / b), x and y in degrees (equation 5), normalised to sum 1.

    One separable filter per term.
    """
    x = _tap_offsets(_sensitivity_radius(ppd)) / ppd
    gaussians = [np.exp(-((np.pi * x) ** 2) / b) for _, b in terms]
    weights = [a * np.sqrt(np.pi / b) * g.sum() ** 2 for (a, b), g in zip(terms, gaussians, strict=True)]
    parts = (filter_separable(plane, g / g.sum(), g / g.sum(), "edge") for g in gaussians)
    return np.sum([np.float32(w / sum(weights)) * part for w, part in zip(weights, parts, strict=True)], axis=0)


def _sensitivity_radius(ppd: float) -> int:
    """Radius of the filters of contrast sensitivity in pixels: three standard deviations of the widest one."""
    widest = max(b for channel in SENSITIVITY for _, b in channel)
    return math.ceil(3 * math.sqrt(widest / (2 * math.pi**2)) * ppd)


def _tap_offsets(radius: int) -> np.ndarray:
    """Pixel offsets -radius to radius, float64."""
    return np.arange(-radius, radius + 1, dtype=np.float64)


def _hyab(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """HyAB distance |ΔL| + ‖(Δa, Δb)‖ of each pixel."""
    d = p - q
    return np.abs(d[0]) + np.hypot(d[1], d[2])


def _colour_difference(lab_a: np.ndarray, lab_b: np.ndarray) -> np.ndarray:
    """Colour difference in [0, 1] (sections 4.1.2, 4.1.3): HyAB distance to the power q_c.

    It is mapped piecewise linearly: p_c of the largest difference becomes p_t.
    """
    green, blue = (_hunt_lab(WHITE_XYZ_FROM_RGB[:, [c]]) for c in (1, 2))
    largest = float(_hyab(green, blue)[0]) ** COLOUR_EXPONENT
    error = _hyab(lab_a, lab_b) ** np.float32(COLOUR_EXPONENT)
    split = COLOUR_SPLIT * largest
    low = error * np.float32(SPLIT_VALUE / split)
    high = SPLIT_VALUE + (error - np.float32(split)) * np.float32((1 - SPLIT_VALUE) / (largest - split))
    return np.where(error < split, low, high)


# --- feature pipeline (section 4.2) ---


def _feature_difference(y_a: np.ndarray, y_b: np.ndarray, ppd: float) -> np.ndarray:
    """Feature difference (H, W) in [0, 1]: the larger one of the edge and the point difference (equation 12)."""
    edges, points = (np.abs(fa - fb) for fa, fb in zip(_features(y_a, ppd), _features(y_b, ppd), strict=True))
    strongest = np.maximum(edges, points) / np.float32(np.sqrt(2))
    return np.minimum(strongest, 1) ** np.float32(FEATURE_EXPONENT)


def _features(y: np.ndarray, ppd: float) -> tuple[np.ndarray, np.ndarray]:
    """Strength of edges and of points in the luminance (H, W): norms of the first and of the second Gaussian derivatives."""
    sigma = 0.5 * FEATURE_WIDTH * ppd
    x = _tap_offsets(_feature_radius(ppd))
    gaussian = np.exp(-(x**2) / (2 * sigma**2))
    smooth = gaussian / gaussian.sum()
    derivatives = (_normalized_derivative(-x * gaussian), _normalized_derivative((x**2 / sigma**2 - 1) * gaussian))
    edge, point = (np.hypot(filter_separable(y, smooth, taps, "edge"), filter_separable(y, taps, smooth, "edge")) for taps in derivatives)
    return edge, point


def _feature_radius(ppd: float) -> int:
    """Radius of the filters of edges and points in pixels."""
    return math.ceil(3 * 0.5 * FEATURE_WIDTH * ppd)


def _normalized_derivative(taps: np.ndarray) -> np.ndarray:
    """Scales positive taps to sum 1 and negative ones to sum -1, so that a constant image gives exactly 0."""
    return np.where(taps > 0, taps / taps[taps > 0].sum(), taps / -taps[taps < 0].sum())

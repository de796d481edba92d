"""Values that several compressed formats store in few bits."""

from __future__ import annotations

import numpy as np

from ..scene.gaussians import SH_C0, Scene
from .memory_mapped import in_blocks

MIN_SCALE = np.float32(1e-30)  # for one of 0
LARGEST_SHARE = 0.01  # of the Gaussians that count no more than the smallest of them: sky would count alone
MIN_WEIGHT = 0.003
# share of the Gaussians beyond the limits of a format, at most: else a sentence says so
MAX_BEYOND = 0.01
BEYOND = 1e-7  # an opacity keeps so much from 0 and 1, where its logit would be infinite
COARSE = 2  # steps of a position in the scale of a small Gaussian, at least: else a sentence says so
SPARED = 0.25  # steps that an opacity of 8 bits keeps from 0 and 1, where its logit would be infinite


def to_uint8(values: np.ndarray) -> np.ndarray:
    """Values rounded to whole numbers of 0 to 255."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def unit_quats(quats: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4) of length 1; those of length 0 stay."""
    return quats / np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), np.float32(1e-30))


def opacities_of(logits: np.ndarray) -> np.ndarray:
    """Opacities, 0 to 1, of opacity logits."""
    return 1 / (1 + np.exp(-logits.clip(-80, 80)))


def logits_of_opacities(opacities: np.ndarray) -> np.ndarray:
    """Finite opacity logits, float64, of opacities from 0 to 1."""
    inside = np.clip(opacities.astype(np.float64), BEYOND, 1 - BEYOND)
    return np.log(inside / (1 - inside))


def logits_of(alphas: np.ndarray) -> np.ndarray:
    """Opacity logits, float32, of 8-bit opacities; 0 and 255 count as a quarter of a step inside."""
    share = np.clip(np.arange(256), SPARED, 255 - SPARED) / 255
    return np.log(share / (1 - share)).astype(np.float32)[alphas]


def alphas_of(logits: np.ndarray) -> np.ndarray:
    """The opacities in 8 bits, rounded, of opacity logits."""
    return np.rint(255 / (1 + np.exp(-np.clip(logits, -80, 80)))).astype(np.uint8)


def logs_of(scales: np.ndarray) -> np.ndarray:
    """Logarithms of scales, finite also of 0. Damaged files have negative ones, or no numbers."""
    with np.errstate(invalid="ignore"):
        return np.log(np.maximum(scales, MIN_SCALE))


def sh_of_colors(colors: np.ndarray) -> np.ndarray:
    """SH coefficients of degree 0 of base colours, 0 to 1."""
    with np.errstate(over="ignore"):  # ranges of a damaged file may be those of float32
        return (colors - np.float32(0.5)) / np.float32(SH_C0)


def colors_of_sh(sh: np.ndarray) -> np.ndarray:
    """Base colours of SH coefficients of degree 0."""
    return sh * np.float32(SH_C0) + np.float32(0.5)


def quats_of_three(three: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4), float32. three: (N, 3) the components other than the largest one, in order;
    largest: (N,) its position, 0 to 3."""
    quats = np.empty((len(three), 4), np.float32)
    rows = np.arange(len(three))
    places = np.arange(3)[None] + (np.arange(3)[None] >= largest[:, None])
    quats[rows[:, None], places] = three
    quats[rows, largest] = np.sqrt(np.maximum(0, 1 - np.square(three, dtype=np.float32).sum(axis=1)))
    return quats


def three_of_quats(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(three, largest) as quats_of_three() takes them, of quaternions (N, 4) of any length, with the sign
    that makes the largest one positive."""
    norms = np.sqrt(np.einsum("nk,nk->n", quats, quats))
    usable = norms > 0
    unit = (quats / np.where(usable, norms, 1)[:, None]).astype(np.float32, copy=False)
    unit[~usable] = 1, 0, 0, 0
    largest = np.abs(unit).argmax(axis=1)
    signs = np.copysign(np.float32(1), unit[np.arange(len(unit)), largest])
    three = np.empty((len(unit), 3), np.float32)
    for k in range(3):
        three[:, k] = signs * np.where(k < largest, unit[:, k], unit[:, k + 1])
    return three, largest


def picture_weights(scene: Scene, largest_share: float = LARGEST_SHARE) -> np.ndarray:
    """How much a squared error in the values of each Gaussian counts in pictures, (N,) float32 of mean 1: its
    squared opacity times the product of its two largest scales, which is in proportion to the sum of alpha^2
    over its pixels; at least MIN_WEIGHT. What hides it is not known here. largest_share: as LARGEST_SHARE."""
    if not scene.count:
        return np.ones(0, np.float32)
    weights = in_blocks(_alpha_areas, scene)
    weights = np.minimum(weights, np.quantile(weights, 1 - largest_share))
    return np.maximum(weights / weights.mean(), MIN_WEIGHT).astype(np.float32)


def _alpha_areas(scene: Scene) -> np.ndarray:
    """Squared opacity times the product of the two largest scales, (N,) float64."""
    logs = np.sort(np.clip(np.nan_to_num(scene.log_scales.astype(np.float64)), -80, 80), axis=1)
    return np.exp(logs[:, 1] + logs[:, 2]) / np.square(
        1 + np.exp(-np.clip(scene.opacity_logits.astype(np.float64), -40, 40))
    )


def widest_logs(scene: Scene) -> np.ndarray:
    """The largest log-scale of each Gaussian, (N,) float32; NaN if one of them is."""
    first, second, third = scene.log_scales.T
    return np.maximum(np.maximum(first, second), third)


def small_scale(scene: Scene) -> float:
    """The scale, of each the largest of three, of small Gaussians: 5 % have a smaller one; 1 without any."""
    logs = widest_logs(scene)
    logs = logs[np.isfinite(logs)]
    return float(np.exp(np.clip(np.quantile(logs, 0.05), -80, 80))) if len(logs) else 1.0


def far_away(scene: Scene) -> list[str]:
    """A sentence if the steps of float32, in which positions are stored, show in more than MAX_BEYOND of the
    Gaussians."""
    far = np.abs(np.nan_to_num(scene.means)).max(axis=1, initial=0)
    steps, scales = np.spacing(far), np.exp(np.clip(widest_logs(scene), -80, 80))
    count = int((steps > scales / COARSE).sum())
    if count <= MAX_BEYOND * scene.count:
        return []
    return [
        f"positions are stored in steps of up to {steps.max():.2g}, too coarse for {count:,} Gaussians,"
        f" because the scene lies {np.median(far):g} away: move it to the origin"
    ]


def clipped(scene: Scene, label: str, most: float, most_dc: float = np.inf) -> list[str]:
    """A sentence if more than MAX_BEYOND of the Gaussians have SH coefficients beyond ±most, or of degree 0
    beyond ±most_dc, which the format of this name stores as these."""

    def beyond(part: Scene) -> np.ndarray:
        flat = np.abs(part.sh).reshape(part.count, 3 * part.sh.shape[1])
        return (flat[:, :3] > most_dc).any(axis=1) | (flat[:, 3:] > most).any(axis=1)

    count = int(in_blocks(beyond, scene).sum())
    if count <= MAX_BEYOND * scene.count:
        return []
    return [
        f"{count:,} Gaussians have colours or spherical harmonics beyond the limits of {label}, so these are"
        " clipped: write another format"
    ]

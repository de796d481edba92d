"""Scenes that could break the arithmetic. Each row varies one quantity from harmless to extreme values and
makes a case for each value.

The scenes are small, and the cameras are at the origin and face +z, so that every pixel can be compared with
float64.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene

from .cases import Case
from .scenes import look_at

WIDTH, HEIGHT = 48, 32
GAUSSIANS = 60
BAD_VALUES = (
    np.nan,
    np.inf,
    -np.inf,
    0.0,
    -0.0,
    1e-45,
    -1e-45,
    1e-38,
    1e38,
    -1e38,
    3.4028235e38,
    -3.4028235e38,
)
# an extreme: the parameter that changes in every fourth Gaussian, a factor on its values, and what is added
EXTREMES: dict[str, tuple[str, float | np.ndarray, float | np.ndarray]] = {
    "nothing": ("means", 1, 0),
    "scale 0": ("log_scales", 1, np.array([-np.inf, 0, 0])),
    "scale ∞": ("log_scales", 1, np.array([0, np.inf, 0])),
    "scales 1e-20": ("log_scales", 0, -46),
    "needle 1e6": ("log_scales", 1, np.array([-14, 0, -14])),
    "quaternion 0": ("quats", 0, 0),
    "quaternion 1e15": ("quats", 1e15, 0),
    "flyaway 1e8": ("means", 1e8, 0),
    "opacity 0": ("opacity_logits", 0, -np.inf),
    "opacity 1": ("opacity_logits", 0, np.inf),
}
SIDES = ((1, 1), (1, 17), (17, 1), (15, 15), (16, 16), (17, 17), (31, 33), (257, 257))


@dataclass(frozen=True)
class StressCase:
    """A case, its masks and the weight of the spatial mask."""

    case: Case
    masks: np.ndarray  # (N,) uint8
    lambda_f: float = 1e-4


@dataclass(frozen=True)
class Row:
    """One varied quantity. make(value): the case for a value. logarithmic: whether the axis of its chart is.
    numeric: whether the values are numbers; if not, the chart places them side by side with labels."""

    name: str
    title: str
    quantity: str
    values: Sequence
    make: Callable[[Any], StressCase]
    logarithmic: bool = True
    numeric: bool = True


def extremes(case: Case) -> Row:
    """One and two extremes at once, in a given scene."""
    return Row(
        "extremes",
        "Pairs of extremes in every fourth Gaussian",
        "extremes",
        tuple(combinations(EXTREMES, 2)),
        partial(_extremes, case),
        False,
        False,
    )


def rows() -> tuple[Row, ...]:
    tens = [10.0**k for k in range(-28, 29, 4)]
    return (
        Row("quaternion-length", "Quaternions of any length", "length", tens, _quaternions),
        Row(
            "bad-values",
            "One bad value in each slot of a Gaussian",
            "value",
            BAD_VALUES,
            _bad_values,
            False,
            False,
        ),
        Row("needles", "Needles", "longest axis over the others", [10.0**k for k in range(7)], _needles),
        Row("log-scale", "Sizes", "log-scale", range(-30, 41, 5), _sizes, False),
        Row(
            "antialiased-size",
            "Sizes below a pixel, antialiased",
            "standard deviation",
            [10.0**k for k in range(-12, 0)],
            _antialiased,
        ),
        Row("opacity-logit", "Opacity", "logit", range(-40, 41, 5), _opacities, False),
        Row(
            "alpha-cut",
            "Opacity around 1/255",
            "opacity x 255 - 1",
            [10.0**-k for k in range(1, 8)],
            _around_the_cut,
        ),
        Row(
            "clamped-masks",
            "Opaque Gaussians, mixed masks",
            "share that exists",
            (0, 0.1, 0.25, 0.5, 0.75, 0.9, 1),
            _clamped_masks,
            False,
        ),
        Row(
            "one-ray",
            "Gaussians on one ray",
            "Gaussians",
            (0, 1, 10, 100, 1000, 10_000),
            _one_ray,
            False,
            False,
        ),
        Row(
            "faint-ray",
            "Gaussians on one ray, each just above the cut",
            "Gaussians",
            (1, 10, 100, 1000, 10_000),
            _faint_ray,
        ),
        Row(
            "depth",
            "Distance from the camera",
            "depth of the centre",
            (-1, 0.19999, 0.20001, 0.21, 1, 1e3, 1e6, 1e10, 1e20),
            _depths,
            False,
            False,
        ),
        Row("world-offset", "Far from the world's origin", "distance", [10.0**k for k in range(9)], _offset),
        Row("image-sides", "Image sides", "pixels", SIDES, _sides, False, False),
        Row(
            "screen-filling",
            "Gaussians that fill the screen",
            "Gaussians",
            (1, 10, 100, 300),
            _screen_filling,
        ),
        Row("copies", "Copies at one depth", "copies of each", (1, 2, 4, 16, 64), _copies),
        Row(
            "lambda-f",
            "Weight of the spatial mask",
            "lambda_f",
            (0.0, 1e-6, 1e-4, 1e-2, 1.0, 1e1, 1e2, 1e3),
            _lambda,
            False,
            False,
        ),
        Row("field-of-view", "Field of view", "degrees", (1, 10, 60, 90, 120, 150, 170), _field, False),
        extremes(Case("generated", _scene(), _camera())),
    )


def _camera(width: int = WIDTH, height: int = HEIGHT) -> Camera:
    return look_at(np.zeros(3), np.array([0, 0, 1.0]), width, height)


def _scene(count: int = GAUSSIANS, seed: int = 1, size: float = 0.2, sh: int = 4) -> Scene:
    """A scene like a trained one, 2 to 6 units in front of the camera."""
    rng = np.random.default_rng(seed)
    means = np.column_stack([rng.normal(0, 0.8, (count, 2)), rng.uniform(2, 6, count)])
    coefficients = rng.normal(0, 0.1, (count, sh, 3))
    coefficients[:, 0] = rng.normal(0.2, 0.8, (count, 3))
    arrays = (
        means,
        rng.normal(np.log(size), 0.5, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.normal(0.5, 1.5, count),
        coefficients,
    )
    return Scene.of(*arrays)


def _on_ray(count: int, logit: float, size: float = 0.2) -> Scene:
    """Gaussians behind each other on one ray, slightly off the axis, elongated and rotated, so that no
    gradient is 0 by symmetry."""
    rng = np.random.default_rng(2)
    depth = np.linspace(1, 5, count) if count > 1 else np.full(count, 2.0)
    means = np.column_stack([rng.normal(0, 0.05 * size, (count, 2)) * depth[:, None], depth])
    log_scales = np.log(size) + rng.normal(0, 0.3, (count, 3))
    arrays = (
        means,
        log_scales,
        rng.normal(size=(count, 4)),
        np.full(count, logit),
        rng.normal(0.2, 0.8, (count, 1, 3)),
    )
    return Scene.of(*arrays)


def _stress_case(
    name: str, scene: Scene, camera: Camera | None = None, keep: float = 0.7, lambda_f: float = 1e-4
) -> StressCase:
    masks = (np.random.default_rng(3).random(scene.count) < keep).astype(np.uint8)
    return StressCase(Case(name, scene, camera or _camera()), masks, lambda_f)


def _changed(scene: Scene, **arrays: np.ndarray) -> Scene:
    changed: dict[str, Any] = {
        name: np.ascontiguousarray(array, np.float32) for name, array in arrays.items()
    }
    return replace(scene, **changed)


def _quaternions(length: float) -> StressCase:
    scene = _scene()
    return _stress_case("quaternions", _changed(scene, quats=scene.quats.astype(np.float64) * length))


def _bad_values(value: float) -> StressCase:
    """Gaussian i has the bad value in parameter i; all others have good values."""
    scene = _scene()
    flat = {
        name: getattr(scene, name).reshape(scene.count, -1).copy()
        for name in ("means", "log_scales", "quats", "opacity_logits", "sh")
    }
    slots = [(array, column) for array in flat.values() for column in range(array.shape[1])]
    for i, (array, column) in enumerate(slots):
        array[i, column] = value
    return _stress_case(
        "bad values",
        replace(scene, **{name: array.reshape(getattr(scene, name).shape) for name, array in flat.items()}),
    )


def _extremes(case: Case, pair: tuple[str, str]) -> StressCase:
    scene = case.scene
    for name in pair:
        parameter, factor, added = EXTREMES[name]
        values = getattr(scene, parameter).astype(np.float64)
        values[::4] = (factor * values[::4] if factor else 0) + added
        scene = _changed(scene, **{parameter: values})
    return _stress_case(" and ".join(pair), scene, case.camera)


def _needles(ratio: float) -> StressCase:
    scene = _scene()
    log_scales = scene.log_scales.astype(np.float64) + np.log([1, 1 / ratio, 1 / ratio])
    return _stress_case("needles", _changed(scene, log_scales=log_scales))


def _sizes(log_scale: float) -> StressCase:
    scene = _scene()
    log_scales = scene.log_scales.copy()
    log_scales[::2] = log_scale
    return _stress_case("sizes", _changed(scene, log_scales=log_scales))


def _antialiased(size: float) -> StressCase:
    return _stress_case("antialiased", replace(_scene(size=size), antialiased=True))


def _opacities(logit: float) -> StressCase:
    scene = _scene()
    return _stress_case(
        "opacity",
        _changed(scene, opacity_logits=np.where(np.arange(scene.count) % 2, scene.opacity_logits, logit)),
    )


def _around_the_cut(margin: float) -> StressCase:
    """Opacities alternately above and below 1/255, by the relative margin."""
    scene = _scene()
    opacity = (1 + np.where(np.arange(scene.count) % 2, margin, -margin)) / 255
    return _stress_case("alpha cut", _changed(scene, opacity_logits=np.log(opacity / (1 - opacity))))


def _clamped_masks(keep: float) -> StressCase:
    return _stress_case(
        "clamped", _changed(_scene(size=0.5), opacity_logits=np.full(GAUSSIANS, 8.0)), keep=keep
    )


def _one_ray(count: int) -> StressCase:
    return _stress_case("one ray", _on_ray(count, 0.0), _camera(9, 9))


def _faint_ray(count: int) -> StressCase:
    return _stress_case(
        "faint ray", _on_ray(count, float(np.log(1.02 / (255 - 1.02))), size=2.0), _camera(5, 5)
    )


def _depths(depth: float) -> StressCase:
    """Every other Gaussian has its centre at this depth, and a size in proportion to it, or to the near plane
    if that is farther."""
    scene = _scene()
    means, log_scales, moved = scene.means.copy(), scene.log_scales.copy(), np.arange(scene.count) % 2 == 0
    means[moved] *= (depth / means[moved, 2])[:, None]
    log_scales[moved] += np.log(max(abs(depth), 0.2) / 4)
    return _stress_case("depth", _changed(scene, means=means, log_scales=log_scales))


def _offset(distance: float) -> StressCase:
    """The scene and the camera are moved by the distance; centres have the precision that float32 has
    there."""
    scene, camera = _scene(), _camera()
    shift = distance * np.array([1, -0.5, 1])
    viewmat = camera.viewmat.copy()
    viewmat[:3, 3] -= viewmat[:3, :3] @ shift
    return _stress_case(
        "offset", _changed(scene, means=scene.means + shift), replace(camera, viewmat=viewmat)
    )


def _sides(sides: tuple[int, int]) -> StressCase:
    return _stress_case("sides", _scene(size=0.4), _camera(*sides))


def _screen_filling(count: int) -> StressCase:
    return _stress_case(
        "screen-filling", _on_ray(count, float(np.log(0.02 / 0.98)), size=1e3), _camera(70, 50)
    )


def _copies(copies: int) -> StressCase:
    scene = _scene()
    means = scene.means.copy()
    means[:, 2] = 3
    return _stress_case("copies", _changed(scene, means=means).select(np.arange(scene.count).repeat(copies)))


def _lambda(weight: float) -> StressCase:
    return _stress_case("lambda_f", _scene(size=0.4), lambda_f=weight)


def _field(degrees: float) -> StressCase:
    camera = _camera()
    focal = WIDTH / (2 * np.tan(np.radians(degrees) / 2))
    return _stress_case(
        "field of view",
        _scene(),
        replace(camera, K=np.array([[focal, 0, WIDTH / 2], [0, focal, HEIGHT / 2], [0, 0, 1.0]])),
    )

"""Blender's camera numbers <-> intrinsics in pixels.

Blender fits a sensor of some millimetres to one side of the image; shift is in lengths of that side; pixels may be wider than
high (aspect). Both put pixel centres at k + 0.5, so a centred camera has cx = W/2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..camera import Camera

SENSOR = 36.0  # millimetres


@dataclass(frozen=True)
class Lens:
    """A perspective or orthographic camera as Blender describes it; the image size and pixel aspect are the scene's there."""

    width: int
    height: int
    lens: float  # focal length, millimetres
    shift: tuple[float, float] = (0.0, 0.0)
    aspect: tuple[float, float] = (1.0, 1.0)  # of a pixel, x and y
    sensor: tuple[float, float] = (SENSOR, SENSOR)  # millimetres
    fit: str = "AUTO"  # HORIZONTAL, VERTICAL; AUTO: the longer side, and always sensor[0]
    ortho_scale: float | None = None  # length that the fitted side shows: orthographic, whatever lens and sensor are


def intrinsics(lens: Lens) -> np.ndarray:
    """K (3, 3) float64, pixels; orthographic: as in Camera."""
    side, ratio, sensor = _fitted(lens)
    focal = lens.lens * side / sensor if lens.ortho_scale is None else side / lens.ortho_scale
    cx = lens.width / 2 - lens.shift[0] * side
    cy = lens.height / 2 + lens.shift[1] * side / ratio
    return np.array([[focal, 0, cx], [0, focal / ratio, cy], [0, 0, 1]])


def lens_of(camera: Camera) -> Lens:
    """The AUTO-fitted Lens whose intrinsics are a perspective camera's K, exactly but for skew, which Blender does not have."""
    (fx, _, cx), (_, fy, cy), _ = camera.K
    aspect = (1.0, 1.0) if abs(fx / fy - 1) < 1e-12 else (max(1.0, fy / fx), max(1.0, fx / fy))
    side, ratio, sensor = _fitted(Lens(camera.width, camera.height, 1.0, aspect=aspect))
    shift = (camera.width / 2 - cx) / side, (cy - camera.height / 2) * ratio / side
    return Lens(camera.width, camera.height, fx * sensor / side, shift, aspect)


def camera_of_projection(projection: np.ndarray, viewmat: np.ndarray, width: int, height: int) -> Camera:
    """The view through an OpenGL projection matrix (4, 4), perspective or orthographic, from the pose viewmat (4, 4), world to camera.

    What is seen though it lies behind the eye, in orthographic views, comes to lie before the camera: step_back further back.
    """
    P, viewmat = np.asarray(projection, np.float64), np.array(viewmat, np.float64)
    orthographic = P[3, 3] != 0
    x, y = P[:2, 3] if orthographic else -P[:2, 2]
    K = np.array([[P[0, 0] * width / 2, 0, (1 + x) * width / 2], [0, P[1, 1] * height / 2, (1 - y) * height / 2], [0, 0, 1]])
    viewmat[2, 3] += step_back(P)
    return Camera(viewmat, K, width, height, orthographic=bool(orthographic))


def step_back(projection: np.ndarray) -> float:
    """How far behind its eye an OpenGL projection matrix (4, 4) shows things: 0 where the near plane lies before it."""
    P = np.asarray(projection, np.float64)
    return max(0.0, -(P[2, 3] + P[3, 3]) / (P[2, 2] + P[3, 2]))


def depth_of_projection(projection: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Depths before camera_of_projection(projection, ...), float32, of an OpenGL depth buffer's values in [0, 1]; infinite at 1."""
    P, z = np.asarray(projection, np.float64), 2.0 * values - 1
    with np.errstate(divide="ignore"):
        return np.where(values < 1, (P[2, 3] - z * P[3, 3]) / (P[2, 2] - z * P[3, 2]) + step_back(P), np.inf).astype(np.float32)


def _fitted(lens: Lens) -> tuple[float, float, float]:
    """Length of the fitted side in pixel widths, height of a pixel over its width, millimetres on that side."""
    ratio = lens.aspect[1] / lens.aspect[0]
    horizontal = lens.fit == "HORIZONTAL" or (lens.fit == "AUTO" and lens.width >= ratio * lens.height)
    return lens.width if horizontal else ratio * lens.height, ratio, lens.sensor[lens.fit == "VERTICAL"]

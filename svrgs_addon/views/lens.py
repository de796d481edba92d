"""Converts cameras and viewports of Blender to intrinsics in pixels, and cameras back to Blender's settings.

Perspective and orthographic cameras and viewports are supported; panoramas are refused (operators). Blender
fits a sensor, in millimetres, to one side of the image; shift is a fraction of this side; a pixel may have
unequal sides (aspect). Pixel centres are at k + 0.5 in both, so a centred camera has cx = W/2.

An orthographic viewport also shows objects behind its eye. So its camera steps back to the near plane
(step_back).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.camera import Camera

SENSOR = 36.0  # millimetres


@dataclass(frozen=True)
class Lens:
    """A perspective or orthographic camera of Blender, with its scene's image size and pixel aspect."""

    width: int  # pixels
    height: int  # pixels
    lens: float  # focal length, millimetres
    shift: tuple[float, float] = (0.0, 0.0)  # in lengths of the fitted side
    aspect: tuple[float, float] = (1.0, 1.0)  # width and height of a pixel, in any unit
    sensor: tuple[float, float] = (SENSOR, SENSOR)  # width and height, millimetres
    fit: str = "AUTO"  # HORIZONTAL, VERTICAL; AUTO: the longer side of the image, with sensor[0] for either
    # length of the scene along the fitted side; not None: orthographic, lens and sensor are ignored
    ortho_scale: float | None = None


def intrinsics(lens: Lens) -> np.ndarray:
    """Intrinsics K (3, 3) float64 in pixels, or, orthographic, fx and fy in pixels per unit of length."""
    side, ratio, sensor = _fitted(lens)
    focal = lens.lens * side / sensor if lens.ortho_scale is None else side / lens.ortho_scale
    cx = lens.width / 2 - lens.shift[0] * side
    cy = lens.height / 2 + lens.shift[1] * side / ratio
    return np.array([[focal, 0, cx], [0, focal / ratio, cy], [0, 0, 1]])


def lens_of(camera: Camera) -> Lens:
    """The Lens, fit AUTO, of a perspective camera; exact, except that Blender has no skew."""
    (fx, _, cx), (_, fy, cy), _ = camera.K
    aspect = (1.0, 1.0) if abs(fx / fy - 1) < 1e-12 else (max(1.0, fy / fx), max(1.0, fx / fy))
    side, ratio, sensor = _fitted(Lens(camera.width, camera.height, 1.0, aspect=aspect))
    shift = (camera.width / 2 - cx) / side, (cy - camera.height / 2) * ratio / side
    return Lens(camera.width, camera.height, fx * sensor / side, shift, aspect)


def camera_of_projection(projection: np.ndarray, viewmat: np.ndarray, width: int, height: int) -> Camera:
    """The camera of an OpenGL projection matrix (4, 4), perspective or orthographic, and a pose.

    viewmat: (4, 4), world to camera, in the camera frame of COLMAP. width, height: image size in pixels. An
    orthographic camera is moved back by step_back(), so that everything that the view shows is in front of
    it.
    """
    P, viewmat = np.asarray(projection, np.float64), np.array(viewmat, np.float64)
    orthographic = P[3, 3] != 0
    x, y = P[:2, 3] if orthographic else -P[:2, 2]
    fx, cx = P[0, 0] * width / 2, (1 + x) * width / 2
    fy, cy = P[1, 1] * height / 2, (1 - y) * height / 2
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    viewmat[2, 3] += step_back(P)
    return Camera(viewmat, K, width, height, orthographic=bool(orthographic))


def step_back(projection: np.ndarray) -> float:
    """Distance of the near plane of an OpenGL projection (4, 4) behind the eye, units of length; or 0."""
    P = np.asarray(projection, np.float64)
    return max(0.0, -(P[2, 3] + P[3, 3]) / (P[2, 2] + P[3, 2]))


def depth_of_projection(projection: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Camera z of the values of an OpenGL depth buffer, float32, in units of length and the shape of
    `values`.

    values: 0..1; 1 is the background and becomes infinity. The camera is that of
    camera_of_projection(projection, ...).
    """
    P, z = np.asarray(projection, np.float64), 2.0 * values - 1
    with np.errstate(divide="ignore"):
        depth = (P[2, 3] - z * P[3, 3]) / (P[2, 2] - z * P[3, 2]) + step_back(P)
        return np.where(values < 1, depth, np.inf).astype(np.float32)


def _fitted(lens: Lens) -> tuple[float, float, float]:
    """Fitted side in pixel widths, height of a pixel over its width, sensor length of that side in mm."""
    ratio = lens.aspect[1] / lens.aspect[0]
    horizontal = lens.fit == "HORIZONTAL" or (lens.fit == "AUTO" and lens.width >= ratio * lens.height)
    return lens.width if horizontal else ratio * lens.height, ratio, lens.sensor[lens.fit == "VERTICAL"]

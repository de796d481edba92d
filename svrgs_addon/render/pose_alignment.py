"""Poses that are slightly off: a view is moved until the splat shows what its photograph shows.

Levenberg-Marquardt on the squared differences of a reduced picture. Motions are counted in pixels: a rotation
about an axis by 1 / fx, and a translation along it that moves what is at the view's depth by about a pixel.
Each channel of the picture is first brought to the brightness and contrast of the photograph, so that
exposure is not taken for a motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..native.rasterizer import RenderOptions
from ..scene.camera import Camera
from ..views.reduced_photos import reduced_view, reduction_to

SIDES, ROUNDS = (100, 300, 300), 4  # longer sides in pixels, about, and steps with each
STEP = 0.25  # pixels, of the differences
DAMPING = 1e-3  # at first
LESS, MORE = 0.1, 10.0  # its factor after a step that helped, and after one that did not
ENOUGH = 0.02  # pixels: a smaller step is the last
FARTHEST = 0.05  # of the longer side: no motion is larger
AHEAD = np.eye(6)[5]  # the part of a motion that goes forwards
POINTS = 10_000  # of which a depth and a distance are taken


@dataclass(frozen=True)
class Aligned:
    """A view where the splat shows what its photograph shows. motion: (6,) pixels, from the pose of `start`;
    unit: (6,) radians and world units of a pixel (Camera.displaced)."""

    start: Camera
    motion: np.ndarray
    unit: np.ndarray

    def camera(self, common: np.ndarray | float = 0.0) -> Camera:
        """The view, without a motion in pixels that others have, too."""
        return self.start.displaced((self.motion - common) * self.unit)


def aligned(
    scene, camera: Camera, image: np.ndarray, rasterizer, options: RenderOptions, sides=SIDES
) -> Aligned:
    """The view where the scene shows its photograph. scene: what the rasterizer renders. image: (H, W, 3) as
    Dataset.image() gives it. sides: see SIDES."""
    seen, still = in_view(scene.means, camera), np.zeros(6)
    if not len(seen):
        return Aligned(camera, still, still)
    unit, motion = pixel_motion(camera, seen), still
    for side in sides:
        small, photo = reduced_view(camera, image, side)
        weights = _weights(small)

        def render(motion: np.ndarray, small=small) -> np.ndarray:
            return rasterizer.forward(scene, small.displaced(motion * unit), options)["rgb"]

        motion = _minimised(render, photo, weights, motion, reduction_to(side, camera))
    far = FARTHEST * max(camera.width, camera.height)
    before, after = (_error(render(some), photo, weights) for some in (still, motion))
    if np.abs(motion).max() > far or after >= before:
        motion = still
    return Aligned(camera, motion, unit)


def beside(camera: Camera, other: Camera, means: np.ndarray) -> float:
    """By how many pixels the other view shows the centres (N, 3) elsewhere, the median."""
    points = in_view(means, camera)
    if not len(points):
        return 0.0
    shown, elsewhere = (one.pixels(one.local(points)) for one in (camera, other))
    return float(np.median(np.linalg.norm(elsewhere - shown, axis=1)))


def error_of(
    scene, camera: Camera, image: np.ndarray, rasterizer, options: RenderOptions, side: int
) -> float:
    """The mean squared difference that aligned() minimises, at this size and in the camera's pose."""
    small, photo = reduced_view(camera, image, side)
    return _error(rasterizer.forward(scene, small, options)["rgb"], photo, _weights(small))


def _weights(camera: Camera) -> np.ndarray:
    """(H W,) float32: the same for all pixels that count, 0 for the others, of sum 1."""
    valid = np.ones(camera.width * camera.height) if (found := camera.valid) is None else found.ravel()
    return (valid / max(1.0, valid.sum(dtype=np.float64))).astype(np.float32)


def _minimised(render, photo: np.ndarray, weights: np.ndarray, motion: np.ndarray, factor: int) -> np.ndarray:
    """The motion in pixels from which the picture is nearest to the photograph, from a motion near it."""
    picture, ahead, damping = render(motion), STEP * factor, DAMPING
    gains, residual = _matched(picture, photo, weights)
    columns = [(render(motion + ahead * axis) - picture) * (gains / ahead) for axis in np.eye(6)]
    jacobian = np.stack([column.ravel() for column in columns])  # near enough for all steps
    normal, error = (jacobian @ jacobian.T).astype(np.float64), _error(picture, photo, weights)
    for _ in range(ROUNDS):
        slope = (jacobian @ residual.ravel()).astype(np.float64)
        step = np.linalg.solve(normal + np.diag(damping * normal.diagonal() + 1e-12), slope)
        if np.abs(step).max() < ENOUGH * factor:
            break
        picture = render(motion + step)
        if (new := _error(picture, photo, weights)) < error:
            motion, error, damping = motion + step, new, damping * LESS
            residual = _matched(picture, photo, weights)[1]
        else:
            damping *= MORE
    return motion


def _error(picture: np.ndarray, photo: np.ndarray, weights: np.ndarray) -> float:
    squares = np.square(_matched(picture, photo, weights)[1]).reshape(-1, 3).sum(axis=1)
    return float(weights.astype(np.float64) @ squares) / 3


def _matched(picture: np.ndarray, photo: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The gain of each channel with which the picture is nearest to the photograph in the pixels that count,
    and what is left there: photo less picture, (H, W, 3)."""
    flat = picture.reshape(-1, 3), photo.reshape(-1, 3)
    centred, wanted = (one - weights @ one for one in flat)  # products are faster than means
    products = [weights @ (centred * one) for one in (wanted, centred)]
    gains = products[0] / np.maximum(products[1], 1e-12)
    return gains, ((wanted - gains * centred) * (weights > 0)[:, None]).reshape(picture.shape)


def in_view(means: np.ndarray, camera: Camera) -> np.ndarray:
    """(n, 3) float64, world: some of the centres (N, 3) that the camera sees."""
    points = means[:: max(1, len(means) // POINTS)].astype(np.float64)
    return points[camera.shows(camera.local(points))]


def pixel_motion(camera: Camera, points: np.ndarray) -> np.ndarray:
    """(6,) radians and world units: motions (Camera.displaced) by about a pixel of this view, which is in
    perspective, and in which points (n, 3), world, are seen."""
    depth = float(np.median(points @ camera.viewmat[2, :3] + camera.viewmat[2, 3]))
    return np.repeat([1.0, depth], 3) / camera.K[0, 0]

"""Poses of the photographs, refined while the splat is trained: gradients of the loss move each camera a
little.

A motion is counted in pixels of the photograph (render/pose_alignment.py), so that one rate fits every scene.
The refined poses are written beside the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..render.pose_alignment import AHEAD, in_view, pixel_motion
from ..scene.camera import Camera
from .photo_adam import PhotoAdam

# pixels a step, first and last, log-linear in between: larger ones carry the splat from held-out views
FIRST, LAST = 0.02, 0.002


@dataclass
class Poses(PhotoAdam):
    """The motions of V photographs with their Adam state: values (V, 6), pixels, from the poses at the start,
    starts (V, 4, 4); units (V, 6), radians and world units of a pixel (Camera.displaced). The mean
    motion forwards of all cameras is left out, so that the splat keeps its size."""

    values: np.ndarray
    units: np.ndarray
    starts: np.ndarray
    viewmats: np.ndarray  # of the cameras now

    @classmethod
    def of(cls, cameras: Sequence[Camera], means: np.ndarray) -> Poses:
        """means: of the Gaussians, (N, 3). A camera that sees none of them stays where it is."""
        units, seen = np.zeros((len(cameras), 6)), [in_view(means, camera) for camera in cameras]
        for number, (camera, points) in enumerate(zip(cameras, seen, strict=True)):
            if len(points):
                units[number] = pixel_motion(camera, points)
        starts, zeros = np.stack([camera.viewmat for camera in cameras]), np.zeros_like(units)
        steps = np.zeros(len(units), np.int64)
        return cls(zeros, zeros.copy(), steps, zeros.copy(), units, starts, starts.copy())

    def update(self, number: int, camera: Camera, grad: np.ndarray, rate: float) -> Camera:
        """A photograph's camera after an Adam step. grad: dL/d(motion), (6,), radians and world units."""
        unit = self.units[number]
        self.values[number] += self.change(number, grad * unit, rate)
        motion = (self.values[number] - AHEAD * self.values.mean(axis=0)) * unit
        moved = replace(camera, viewmat=self.starts[number]).displaced(motion)
        self.viewmats[number] = moved.viewmat
        return moved


def file_of(out: Path) -> Path:
    """Where the poses of a result are written, as cameras.json of 3DGS."""
    return out.with_name(f"{out.name}_refined_cameras.json")

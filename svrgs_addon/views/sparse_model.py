"""What a dataset holds beside its photographs: cameras, poses, sparse points, of COLMAP or a
transforms.json."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Intrinsics:
    """A camera of any COLMAP model. width, height: of the photograph, pixels; params: in COLMAP's order."""

    model: str  # PINHOLE, OPENCV, ...
    width: int
    height: int
    params: tuple[float, ...]

    def pinhole(self) -> np.ndarray | None:
        """K (3, 3) in pixels; None if the model has distortion or is no pinhole."""
        if self.model not in ("PINHOLE", "SIMPLE_PINHOLE"):
            return None
        fx, fy, cx, cy = self.params if self.model == "PINHOLE" else (self.params[0], *self.params)
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


@dataclass(frozen=True)
class View:
    """One registered photograph."""

    name: str  # image name, with '/' between folders
    viewmat: np.ndarray  # (4, 4) float64, world to camera
    camera: Intrinsics


@dataclass(frozen=True)
class Model:
    """A sparse model. views: by name. points: (P, 3) float32, world. point_colors: (P, 3) uint8, RGB."""

    views: list[View]
    points: np.ndarray
    point_colors: np.ndarray


@dataclass(frozen=True)
class Source:
    """Cameras and points, where they were read, and the folder of their photographs."""

    model: Model
    location: Path
    image_folder: Path | None  # None: the photographs were not asked for
    notes: tuple[str, ...]  # sentences that the user must see
    masks: dict[str, Path] = field(default_factory=dict)  # those that the dataset names, by photograph

"""Whether photographs lie beside what the splat shows, because their poses are off; and their alignment.

A view can always be moved so that it shows its photograph a little better, if the splat shows it badly. So
it is aligned on half of its pixels, a chequerboard of patches, and what that gains is measured on the others.
Where all views move forwards or backwards, the splat has another size, and that does not count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..native.rasterizer import Rasterizer
from ..render.metrics.evaluate import picture_options
from ..render.pose_alignment import AHEAD, SIDES, Aligned, aligned, beside, error_of
from ..scene.camera import Camera, evenly
from ..scene.gaussians import Scene
from ..system.errors import Cancelled
from ..views.dataset import Dataset
from .context import JobContext

VIEWS, COARSE = 8, (150,)  # views that are compared, at most, and the longer side of their pictures, about
PATCHES = 6  # of the chequerboard, per side
OFF = 0.6  # dB: poses are off if alignment gains more, in the median of these views


@dataclass(frozen=True)
class Offset:
    """pixels: how far the photographs lie beside what the splat shows, the median of those compared; gain:
    what alignment gains, dB; compared, of: how many were compared, of how many to train on."""

    pixels: float
    gain: float
    compared: int
    of: int

    @property
    def off(self) -> bool:
        return self.gain > OFF

    def sentence(self, refined: bool) -> str:
        """For the user, if poses are off. refined: whether they are refined, then."""
        found = (
            f"the photographs lie about {self.pixels:.1f} pixels beside what the splat shows ({self.compared}"
            f" of {self.of} compared; aligned, they are {self.gain:.1f} dB nearer)"
        )
        return (
            f"{found}, so poses are refined" if refined else f"{found}; --refine-poses on moves the cameras"
        )


def offset_of(scene: Scene, dataset: Dataset) -> Offset:
    """Raises FormatError, SceneError."""
    rasterizer, options = Rasterizer(), picture_options(scene, dataset.background)
    views = evenly(dataset.train_indices, VIEWS)
    halves = {index: _halves(dataset.cameras[index]) for index in views}

    def error(index: int, pose: Camera) -> float:
        camera = pose.masked(halves[index][1])
        return error_of(scene, camera, dataset.image(index), rasterizer, options, COARSE[-1])

    white = {index: dataset.cameras[index].masked(halves[index][0]) for index in views}
    moved = dict(_aligned(scene, dataset, white, COARSE))
    common, found = _common(moved), list[tuple[float, float]]()
    for index, one in moved.items():
        start, end = one.start.displaced(common * one.unit), one.camera()
        before, after = error(index, start), error(index, end)
        gain = 10 * math.log10(before / after) if before and after else 0.0
        found.append((beside(start, end, scene.means), gain))
    pixels, gain = np.median(found, axis=0)
    return Offset(float(pixels), float(gain), len(views), len(dataset.train_indices))


def _halves(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The pixels of the white patches of a chequerboard, and of the black ones, (H, W) uint8."""
    rows, columns = (np.arange(size) * PATCHES // size for size in (camera.height, camera.width))
    white = ((rows[:, None] + columns) % 2).astype(np.uint8)
    valid = np.ones_like(white) if (found := camera.valid) is None else found
    return white * valid, (1 - white) * valid


def with_aligned_poses(scene: Scene, dataset: Dataset, held_out: bool, job: JobContext) -> Dataset:
    """The dataset whose training views were moved to where the splat shows their photographs. held_out: the
    others too. job: is told the progress, and asked after each view whether it stops. Raises FormatError,
    SceneError, Cancelled."""
    cameras = list(dataset.cameras)
    views = range(len(cameras)) if held_out else dataset.train_indices
    moved = dict[int, Aligned]()
    for index, one in _aligned(scene, dataset, {index: cameras[index] for index in views}, SIDES):
        moved[index] = one
        job.part("aligning the photographs", len(moved) / len(views))
        if job.stop():
            raise Cancelled("stopped while the photographs were aligned; nothing was changed")
    common = _common({index: moved[index] for index in dataset.train_indices})
    for index, one in moved.items():
        cameras[index] = one.camera(common)
    return replace(dataset, cameras=cameras)


def _aligned(
    scene: Scene, dataset: Dataset, cameras: dict[int, Camera], sides: tuple[int, ...]
) -> Iterator[tuple[int, Aligned]]:
    """Each of the views, by its number, with its alignment."""
    rasterizer, options = Rasterizer(), picture_options(scene, dataset.background)
    for index, image in dataset.stream(cameras):
        yield index, aligned(scene, cameras[index], image, rasterizer, options, sides)


def _common(moved: dict[int, Aligned]) -> np.ndarray:
    """(6,) pixels: the motion forwards that all views have in common, the median."""
    return AHEAD * np.median([one.motion for one in moved.values()], axis=0)

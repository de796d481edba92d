"""A tiny dataset that fits together: photographs drawn from a scene, their COLMAP model, and a splat
"trained" on them.

The splat is that scene with every Gaussian doubled and a few that no view can show: there is something to
prune.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import scenes
from colmap_model import write_colmap
from svrgs_addon.files.images import write_image
from svrgs_addon.files.ply import write_ply
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene

WIDTH, HEIGHT, VIEWS = 64, 48, 12
SEEN, FAINT = 120, 10
COUNT = 2 * SEEN + FAINT  # Gaussians of the splat


@dataclass(frozen=True)
class Tiny:
    """Where the parts lie."""

    folder: Path  # dataset: images/, sparse/0/
    splat: Path  # two Gaussians for each of truth, and FAINT invisible ones; COUNT by default
    truth: Scene  # the photographs are its renders
    cameras: list[Camera]  # in name order


def write_tiny(folder: Path, seed: int = 0, seen: int = SEEN, cameras: list[Camera] | None = None) -> Tiny:
    """Writes folder/images, folder/sparse/0 and folder/scene.ply. Same arguments, same bytes. cameras:
    default views()."""
    truth = scenes.random_scene(seen, seed, 1, spread=0.4, scale=0.15, opacity=2.0)
    cameras = cameras or views()
    rasterizer = Rasterizer()
    for camera in cameras:
        write_image(folder / "images" / camera.name, rasterizer.forward(truth, camera)["rgb"])
    write_colmap(folder / "sparse" / "0", cameras, truth.means)
    write_ply(folder / "scene.ply", redundant(truth, seed))
    return Tiny(folder, folder / "scene.ply", truth, cameras)


def views(count: int = VIEWS, width: int = WIDTH, height: int = HEIGHT) -> list[Camera]:
    """A ring around the origin, at two heights."""
    angles = 2 * np.pi * np.arange(count) / count
    eyes = [(3 * np.sin(angle), -0.8 * (i % 2), -3 * np.cos(angle)) for i, angle in enumerate(angles)]
    return [replace(scenes.camera(width, height, eye=eye), name=f"{i:02}.png") for i, eye in enumerate(eyes)]


def redundant(scene: Scene, seed: int) -> Scene:
    """Every Gaussian twice, a little apart and fainter, and FAINT more below the visible opacity."""
    rng = np.random.default_rng([seed, 1])
    doubled = scene.select(np.r_[np.arange(scene.count).repeat(2), np.arange(FAINT)])
    means = doubled.means + rng.normal(0, 0.02, doubled.means.shape).astype(np.float32)
    logits = doubled.opacity_logits - np.float32(1)
    logits[-FAINT:] = -8
    return replace(doubled, means=means, opacity_logits=logits)

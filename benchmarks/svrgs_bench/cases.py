"""The cases that are measured: a scene and a view of it, generated or from files."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from svrgs_addon.files.registry import load_scene
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import SH_COEFFICIENTS, Scene
from svrgs_addon.system.errors import SceneError

from .scenes import facing_camera, orbit_camera, room

COUNTS, SH_DEGREES, SIZES = (100_000, 500_000), (0, 3), ((640, 360), (1280, 720))


@dataclass(frozen=True)
class Case:
    """A scene and a view of it."""

    name: str  # 'room', or the file's name
    scene: Scene
    camera: Camera

    @property
    def facts(self) -> dict:
        return {
            "scene": self.name,
            "count": self.scene.count,
            "sh_degree": SH_COEFFICIENTS.index(self.scene.sh.shape[1]),
            "width": self.camera.width,
            "height": self.camera.height,
        }


def room_case(
    count: int = COUNTS[0], sh_degree: int = 3, width: int = SIZES[0][0], height: int = SIZES[0][1]
) -> Case:
    """A generated room. The defaults are those on which knobs and skips are measured."""
    return Case("room", room(count, sh_degree), orbit_camera(width, height))


def chosen_cases(options: argparse.Namespace) -> Iterator[Case]:
    """Views of options.scene, or of generated rooms if no file is given. Raises SceneError, FormatError."""
    if options.scene is None and (options.cameras or options.data):
        raise SceneError("cameras are given without a scene: add --scene FILE")
    if options.scene is not None:
        return _given(options.scene, _first_view(options), options.quick)
    return _rooms(options.quick)


def _rooms(quick: bool) -> Iterator[Case]:
    for count in COUNTS[:1] if quick else COUNTS:
        for sh_degree in SH_DEGREES:
            scene = room(count, sh_degree)
            for size in SIZES[:1] if quick else SIZES:
                yield Case("room", scene, orbit_camera(*size))


def _given(path: Path, view: Camera | None, quick: bool) -> Iterator[Case]:
    scene = load_scene(path)
    sizes = SIZES[:1] if quick else SIZES
    for camera in [view] if view else [facing_camera(scene, *size) for size in sizes]:
        yield Case(path.name, scene, camera)


def _first_view(options: argparse.Namespace) -> Camera | None:
    if options.cameras:
        from svrgs_addon.views.cameras_json import load_cameras_json

        return load_cameras_json(options.cameras)[0]
    if options.data:
        from svrgs_addon.views.dataset import load_dataset

        return load_dataset(options.data, cameras_only=True).cameras[0]
    return None

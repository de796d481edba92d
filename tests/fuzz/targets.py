"""What a reader promises of any bytes: a valid scene, model or list of cameras, or one sentence; soon; in
bounded memory.

A target is a function of bytes that returns True where they were accepted and raises AssertionError where a
promise is broken.
"""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import tempfile
import time
import tracemalloc
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from svrgs_addon.files import streamed_sog
from svrgs_addon.files.registry import FORMATS
from svrgs_addon.files.repair import clamp_extremes, drop_nonfinite
from svrgs_addon.files.splat_format import SplatFormat
from svrgs_addon.finetune import checkpoint
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.system.errors import SplatError
from svrgs_addon.views.cameras_json import load_cameras_json
from svrgs_addon.views.colmap import pinhole_camera, read_model
from svrgs_addon.views.colmap_files import MODEL_FILES
from svrgs_addon.views.transforms_json import read_transforms
from svrgs_bench.scenes import room

SECONDS = 3.0  # of the processor: a busy core gives one second of work in two
MEGABYTES, TIMES_INPUT = 64, 4
DRAWN = 1000  # Gaussians: smaller scenes are also drawn


def splat(splat_format: SplatFormat, data: bytes) -> bool:
    """The whole file and its parts agree, and what is left after repair is finite."""
    with _file(data, splat_format.suffixes[0]) as path:
        accepted, scene = _held(lambda: splat_format.whole(path), len(data))
        parted, parts = _held(
            lambda: [part.select(slice(None)) for part in splat_format.read_parts(path)], len(data)
        )
        assert accepted == parted
        if accepted:
            assert sum(part.count for part in parts) == scene.count
            _check_scene(clamp_extremes(drop_nonfinite(scene)[0])[0], scene.count < DRAWN)
        return accepted


SPLATS = {found.name: functools.partial(splat, found) for found in FORMATS if found.suffixes}
ply = SPLATS["ply"]


def _check_scene(scene: Scene, small: bool):
    """Finite once repaired, and so is its picture."""
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        assert np.isfinite(getattr(scene, name)).all(), name
    if small:
        K = np.array([[20.0, 0, 8], [0, 20, 6], [0, 0, 1]])
        assert np.isfinite(Rasterizer().forward(scene, Camera(np.eye(4), K, 16, 12))["rgb"]).all()


def cameras_json(data: bytes) -> bool:
    with _file(data, ".json") as path:
        accepted, cameras = _held(lambda: load_cameras_json(path), len(data))
        for camera in cameras or ():
            assert np.isfinite(camera.viewmat).all() and np.isfinite(camera.K).all()
            assert camera.K[0, 0] > 0 < camera.K[1, 1]
        return accepted


def transforms_json(data: bytes) -> bool:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "transforms.json")
        path.write_bytes(data)
        accepted, found = _held(lambda: read_transforms(path), len(data))
        if accepted:
            _held(
                lambda: [
                    pinhole_camera(view, view.camera.width, view.camera.height) for view in found.model.views
                ],
                len(data),
            )
            assert found.image_folder.resolve().is_relative_to(Path(folder).resolve())
            assert all(
                ".." not in view.name.split("/") and np.isfinite(view.viewmat).all()
                for view in found.model.views
            )
        return accepted


class Colmap:
    """A model of which one file, named by the first byte, is replaced by the rest of the bytes."""

    def __init__(self, model: Path):
        self.model = model
        suffix = ".bin" if (model / "images.bin").exists() else ".txt"
        self.names = [f"{name}{suffix}" for name in MODEL_FILES]

    def __call__(self, data: bytes) -> bool:
        name = self.names[data[0] % 3] if data else self.names[0]
        with tempfile.TemporaryDirectory() as folder:
            for other in self.names:
                shutil.copyfile(self.model / other, Path(folder, other))
            Path(folder, name).write_bytes(data[1:])
            accepted, model = _held(lambda: read_model(Path(folder)), len(data))
            if accepted:
                _held(
                    lambda: [
                        pinhole_camera(view, view.camera.width, view.camera.height) for view in model.views
                    ],
                    len(data),
                )
        if accepted:
            assert np.isfinite(model.points).all()
            assert all(
                ".." not in view.name.split("/") and not view.name.startswith("/") for view in model.views
            )
        return accepted

    def seeds(self) -> list[bytes]:
        return [bytes([i]) + (self.model / name).read_bytes() for i, name in enumerate(self.names)]


class Checkpoint:
    """A checkpoint of which one file, named by the first byte, is replaced: read as it was, or not taken for
    one."""

    names = ("manifest.json", "arrays.npz")

    def __init__(self, folder: Path):
        self.folder = folder

    def __call__(self, data: bytes) -> bool:
        name = self.names[data[0] % 2] if data else self.names[0]
        with tempfile.TemporaryDirectory() as folder:
            for other in self.names:
                shutil.copyfile(self.folder / other, Path(folder, other))
            Path(folder, name).write_bytes(data[1:])
            whole = checkpoint.read_manifest(Path(folder)) is not None
        assert not whole or name == "manifest.json" or data[1:] == (self.folder / name).read_bytes()
        return whole

    def seeds(self) -> list[bytes]:
        return [bytes([i]) + (self.folder / name).read_bytes() for i, name in enumerate(self.names)]


class Streamed:
    """A streamed SOG whose lod-meta.json is replaced: its files are read, or not; none outside of its
    folder."""

    def __init__(self, folder: Path):
        self.path = folder / streamed_sog.INDEX
        streamed_sog.write_levels(self.path, [room(9, 1), room(5, 0)])

    def __call__(self, data: bytes) -> bool:
        self.path.write_bytes(data)
        accepted, parts = _held(lambda: list(streamed_sog.read_parts(self.path)), len(data))
        for part in parts or ():
            _check_scene(part, True)
        for file in streamed_sog.parts(self.path):
            assert file.resolve().is_relative_to(self.path.parent.resolve())
        return accepted

    def seeds(self) -> list[bytes]:
        one = self.path.read_bytes()
        return [one, one.replace(b'"filenames"', b'"environment": "1_0/meta.json", "filenames"')]


@contextlib.contextmanager
def _file(data: bytes, suffix: str):
    descriptor, path = tempfile.mkstemp(suffix)
    try:
        with open(descriptor, "wb") as file:
            file.write(data)
        yield Path(path)
    finally:
        os.unlink(path)


def _held(read: Callable, size: int):
    """(True, what was read) or (False, None); within memory where tracemalloc runs, which slows all down,
    else within time."""
    started = time.process_time()
    before = tracemalloc.get_traced_memory()[0]
    if tracemalloc.is_tracing():
        tracemalloc.reset_peak()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # they would reach the terminal
            outcome = True, read()
    except SplatError as error:
        assert str(error) and "\n" not in str(error), repr(str(error))
        outcome = False, None
    if size < 1_000_000 and not tracemalloc.is_tracing():
        seconds = time.process_time() - started
        assert seconds <= SECONDS, f"took {seconds:.1f} s"
    elif size < 1_000_000:
        taken = tracemalloc.get_traced_memory()[1] - before
        assert taken <= MEGABYTES * 2**20 + TIMES_INPUT * size, f"took {taken / 2**20:.0f} MiB"
    return outcome

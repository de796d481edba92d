"""A second program, gsply, reads what we write as gaussforge does, and we read what it writes."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from svrgs_addon.files import spz
from svrgs_addon.files.axes import turned_over
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.scene.gaussians import Scene
from test_formats import differences, like_trained

os.environ.setdefault("NUMBA_DISABLE_JIT", "1")  # for a few Gaussians, Python is faster than compiling first
gsply = pytest.importorskip("gsply")
NEAR = 0.004  # a step of the formats' colours: it rounds to another one where a value lies between two


def judged(path: Path) -> Scene:
    """The scene as gsply reads it. It leaves the axes of SPZ as they are."""
    data = gsply.read_spz(path) if path.suffix == ".spz" else gsply.plyread(path)
    scene = Scene.of(
        data.means,
        data.scales,
        data.quats,
        data.opacities,
        np.concatenate([data.sh0[:, None], data.shN], axis=1),
    )
    return turned_over(scene) if path.suffix == ".spz" else scene


def by_gsply(scene: Scene, path: Path, **words):
    scene = turned_over(scene) if path.suffix == ".spz" else scene
    unit = scene.quats / np.linalg.norm(scene.quats, axis=1, keepdims=True)
    data = gsply.GSData.from_arrays(
        scene.means,
        scene.log_scales,
        unit,
        scene.opacity_logits,
        scene.sh[:, 0].copy(),
        scene.sh[:, 1:].copy(),
    )
    if path.suffix == ".spz":
        gsply.write_spz(path, data, **words)
    else:
        gsply.plywrite(path, data, compressed=True)


@pytest.mark.parametrize("suffix, steps", [(".ply", 1e-6), (".compressed.ply", 0.02)])
def test_it_reads_our_ply_as_we_do(tmp_path, suffix, steps):
    write_scene(tmp_path / f"a{suffix}", like_trained(3))
    found = differences(read_scene(tmp_path / f"a{suffix}"), judged(tmp_path / f"a{suffix}"))
    assert found.pop("rest") <= steps and max(found.values()) < min(steps, NEAR), found


@pytest.mark.parametrize("version", (2, 3, 4))
def test_it_reads_every_version_of_our_spz_as_we_do(tmp_path, version):
    spz.write(tmp_path / "a.spz", like_trained(2), version)
    found = differences(read_scene(tmp_path / "a.spz"), judged(tmp_path / "a.spz"))
    assert max(found.values()) < 0.002, found


@pytest.mark.parametrize(
    "name, words", [("b.compressed.ply", {}), ("b.spz", {"version": 3}), ("b.spz", {"version": 4})]
)
def test_we_read_what_it_writes_as_it_does(tmp_path, name, words):
    by_gsply(like_trained(3), tmp_path / name, **words)
    found = differences(read_scene(tmp_path / name), judged(tmp_path / name))
    assert found.pop("rest") <= 0.02 and max(found.values()) < NEAR, found

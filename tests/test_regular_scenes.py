"""Scenes that no training makes, as other programs and people do: whatever is written can be read, in every
format, and is the same scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from svrgs_addon.files import spz, spz_container
from svrgs_addon.files.registry import FORMATS, describe, read_scene, write_scene
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.system.errors import SceneError
from test_formats import GAUSSFORGE, differences, judged

WRITTEN = sorted({one.suffixes[0] for one in FORMATS if one.write and one.suffixes})
SMALL, LARGE = 12, 64  # sides of grids: 1,728 and 262,144 Gaussians


def equal(means: np.ndarray, degree: int = 3) -> Scene:
    """Gaussians that differ in nothing but their place. means (N, 3)."""
    count, same = len(means), lambda *values: np.tile(np.float32(values), (len(means), 1))
    sh = np.zeros((count, (degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = 0.5
    return Scene(means.astype(np.float32), same(-3, -3, -3), same(1, 0, 0, 0), same(2)[:, 0], sh)


def grid(side: int) -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) / side


def scattered(count: int = 500, degree: int = 3) -> Scene:
    return equal(np.random.default_rng(0).normal(size=(count, 3)), degree)


def with_sh(value: float) -> Scene:
    scene = scattered()
    return replace(scene, sh=np.full_like(scene.sh, value))


SCENES = {
    "a regular grid": lambda: equal(grid(SMALL)),
    "a plane of equal Gaussians": lambda: equal(grid(SMALL) * [1, 1, 0]),
    "one Gaussian": lambda: equal(np.array([[0.3, -0.2, 5.0]])),
    "SH of zeros": lambda: with_sh(0.0),
    "SH of 1e30": lambda: with_sh(1e30),
    "opacities of 0 and 1": lambda: replace(
        scattered(), opacity_logits=np.resize(np.float32([-100, 100]), 500)
    ),
    "duplicates": lambda: equal(np.zeros((1_000, 3))),
    "coordinates of 1e6": lambda: equal(1e6 * np.random.default_rng(1).normal(size=(500, 3))),
    "scales of 1e-20 and 1e20": lambda: replace(
        scattered(), log_scales=np.resize(np.float32([-46, 46]), (500, 3))
    ),
}


@pytest.mark.parametrize("suffix", WRITTEN)
def test_a_scene_without_gaussians_is_refused_where_it_could_not_be_read(tmp_path, suffix):
    scene, path = equal(np.empty((0, 3))), tmp_path / f"scene{suffix}"
    if suffix == ".ply":
        write_scene(path, scene)
        assert read_scene(path).count == 0
    else:
        with pytest.raises(SceneError, match="there is no Gaussian to write"):
            write_scene(path, scene)
        assert not list(tmp_path.iterdir())


def test_a_file_that_cannot_be_read_again_does_not_replace_the_old_one(tmp_path, monkeypatch):
    path = tmp_path / "a.spz"
    write_scene(path, scattered())
    before = path.read_bytes()
    monkeypatch.setattr(spz, "packed", lambda *words: spz_container.packed(*words)[:-100])
    with pytest.raises(SceneError, match=r"a\.spz .*: it was written just now"):
        write_scene(path, scattered())
    assert path.read_bytes() == before
    assert {one.name for one in tmp_path.iterdir()} == {"a.spz", "a (new).spz"}, "no work is lost"


MANY = {
    "a large regular grid": lambda: equal(grid(LARGE)),
    "a large plane of equal Gaussians": lambda: equal(grid(LARGE) * [1, 1, 0]),
    "2 million duplicates": lambda: equal(np.zeros((2_000_000, 3)), degree=0),
}


def cases() -> Iterator[Any]:
    """(case, suffix). A stage of USD is read by a process of its own; some scenes are large."""
    for case in SCENES | MANY:
        for suffix in WRITTEN:
            slow = case in MANY or suffix == ".usd"
            yield pytest.param(case, suffix, marks=[pytest.mark.slow] if slow else [])


SECOND = 1e-3  # largest difference between what two programs read of one file


@pytest.mark.parametrize(("case", "suffix"), cases())
def test_what_is_written_can_be_read(tmp_path, case, suffix):
    scene = (SCENES | MANY)[case]()
    path = tmp_path / f"scene{suffix}"
    write_scene(path, scene)
    found = read_scene(path)
    assert found.count == scene.count == describe(path)["count"]
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        assert np.isfinite(getattr(found, name)).all(), name
    if scene.count:
        extent = np.ptp(scene.means, axis=0).max()
        near = np.sort(found.means, axis=0) - np.sort(scene.means, axis=0)  # in any order
        assert np.abs(near).max() <= 2e-3 * extent + 1e-5 * np.abs(scene.means).max() + 1e-4
    if suffix in GAUSSFORGE:
        other = judged(path.read_bytes(), suffix, tmp_path / "judged.ply")
        assert other.count == found.count
        found_apart = differences(found, other)
        assert found_apart.pop("means") <= SECOND + 1e-6 * np.abs(scene.means).max(initial=0)
        assert max(found_apart.values()) <= SECOND, found_apart

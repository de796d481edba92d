"""Scenes larger than memory: blocks on the disk give the scores and the files of the undivided scene, whatever the number of blocks and of parts."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from svrgs_addon.bench.scenes import orbit_camera, room
from svrgs_addon.errors import FormatError, SceneError
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.finetune.saliency import reduced, removal_errors
from svrgs_addon.large.blocks import Divided, divide
from svrgs_addon.large.pruning import best, measured, write_kept
from svrgs_addon.large.scoring import UNIT, score, seen, total
from svrgs_addon.metrics.evaluate import render_options
from svrgs_addon.native import Rasterizer

COUNT = 6_000


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("large") / "room.ply"
    write_scene(path, room(COUNT, 2))
    return path


@pytest.fixture(scope="module")
def cameras():
    """Within the scene: each sees a part of it."""
    return [orbit_camera(160, 120, turn) for turn in (0.0, 0.2, 0.45, 0.7, 0.9)]


def scored(source: Path, folder: Path, most: int, parts: int, cameras) -> tuple[Divided, np.ndarray]:
    divided = divide(source, folder, most)
    for part in range(parts):
        score(divided, cameras, part, parts)
    return divided, total(divided, cameras)


@pytest.fixture(scope="module")
def whole(source, cameras, tmp_path_factory):
    return scored(source, tmp_path_factory.mktemp("whole"), COUNT, 1, cameras)


@pytest.mark.parametrize("most, parts", [(COUNT // 4, 2), (COUNT // 16, 5)])
def test_scores_do_not_depend_on_blocks_and_parts_by_a_bit(source, cameras, whole, tmp_path, most, parts):
    divided, scores = scored(source, tmp_path, most, parts, cameras)
    assert len(whole[0].blocks) == 1 and len(divided.blocks) > parts and all(block.count <= most for block in divided.blocks)
    assert (scores == whole[1]).all()


def test_scores_are_the_removal_errors_of_the_scene_in_memory(source, cameras, whole):
    expected = removal_errors(read_scene(source), cameras, Rasterizer(), render_options(read_scene(source)))
    scores = whole[1] * UNIT
    assert (scores > 0).sum() > COUNT // 4
    assert np.abs(scores - expected).max() < 1e-7 * expected.max() and (best(scores, COUNT // 4) == best(expected, COUNT // 4)).all()


def test_every_gaussian_that_a_view_draws_is_read(source, cameras, tmp_path):
    divided, scene, rasterizer = divide(source, tmp_path, COUNT // 8), read_scene(source), Rasterizer()
    for camera in reduced(cameras):
        part, rows = seen(divided, camera)
        rasterizer.forward(scene, camera, render_options(scene), outputs=())
        assert set(rasterizer.visible()) <= set(rows.tolist()) and (np.diff(rows.astype(np.int64)) > 0).all()
        assert (part.means == scene.means[rows]).all() and len(rows) < COUNT


def test_every_gaussian_is_in_one_block_and_in_its_box(source, tmp_path):
    divided, scene = divide(source, tmp_path, 700), read_scene(source)
    rows = np.concatenate([block.rows for block in divided.blocks])
    assert sorted(rows.tolist()) == list(range(COUNT))
    for block in divided.blocks:
        assert (block.geometry[:, :3] == scene.means[block.rows]).all() and (block.sh(9) == scene.sh[block.rows]).all()
        assert (block.geometry[:, :3] >= block.low).all() and (block.geometry[:, :3] <= block.high).all()
        assert block.largest == scene.log_scales[block.rows].max()
    again = Divided.read(tmp_path)
    assert again.count == COUNT and again.digest == divided.digest and [one.count for one in again.blocks] == [one.count for one in divided.blocks]


def test_what_stays_is_written_in_the_order_of_the_file(source, whole, tmp_path, cameras):
    divided, scores = whole
    kept = best(scores, COUNT // 4)
    write_kept(source, kept, tmp_path / "small.ply")
    small, scene = read_scene(tmp_path / "small.ply"), read_scene(source)
    assert kept.sum() == COUNT // 4 and (small.means == scene.means[kept]).all() and (small.sh == scene.sh[kept]).all()
    better = measured(divided, kept, cameras)
    worse = measured(divided, best(np.random.default_rng(0).permutation(scores), COUNT // 4), cameras)
    assert better > worse + 3


def test_the_highest_scores_stay_and_of_equal_ones_the_first():
    scores = np.array([5, 1, 5, 7, 5, 0])
    assert np.flatnonzero(best(scores, 3)).tolist() == [0, 2, 3] and best(scores, 6).all() and best(scores, 0).sum() == 0


def test_points_in_one_place_are_divided_too(tmp_path):
    scene = room(100, 0)
    scene.means[:] = 1.0
    write_scene(tmp_path / "a.ply", scene)
    assert [block.count for block in divide(tmp_path / "a.ply", tmp_path / "b", 30).blocks] == [25, 25, 25, 25]


def test_missing_and_foreign_parts_are_not_added(source, cameras, tmp_path):
    divided = divide(source, tmp_path, COUNT)
    with pytest.raises(SceneError, match="missing"):
        total(divided, cameras)
    score(divided, cameras, 0, 2)
    with pytest.raises(SceneError, match="1 of 2"):
        total(divided, cameras)
    score(divided, cameras[:4], 1, 2)  # of other cameras
    with pytest.raises(SceneError, match="1 of 2"):
        total(divided, cameras)
    path = score(divided, cameras, 1, 2)
    assert total(divided, cameras).shape == (COUNT,)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(FormatError, match="again"):
        total(divided, cameras)


def test_a_divided_scene_that_is_damaged_is_one_sentence(source, cameras, tmp_path):
    divided = divide(source, tmp_path, COUNT // 2)
    (tmp_path / "1.geometry").write_bytes(b"short")
    with pytest.raises(FormatError, match=r"1\.geometry: cannot be read"):
        seen(Divided.read(tmp_path), cameras[0])
    contents = json.loads((tmp_path / "blocks.json").read_text())
    for change in ({"schema": 9}, {"blocks": 3}, {"count": "many"}):
        (tmp_path / "blocks.json").write_text(json.dumps(contents | change))
        with pytest.raises(FormatError, match="divide the scene again"):
            Divided.read(tmp_path)
    (tmp_path / "blocks.json").unlink()
    with pytest.raises(SceneError, match="divide the scene first"):
        Divided.read(tmp_path)
    assert divided.count == COUNT

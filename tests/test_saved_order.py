"""The files of an order: from them, any number of Gaussians is put together at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenes import ball
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.finetune.decimate.order import order_of, visibility_sums
from svrgs_addon.finetune.decimate.saved_order import MERGED, ORDER, read_order, write_order
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.pipeline import prune_scene
from svrgs_addon.scene.gaussians import PARAMETERS, Scene
from svrgs_addon.system.errors import SplatError
from svrgs_addon.views.rig.around import cameras_around

pytestmark = pytest.mark.usefixtures("small_pictures")


def sorted_rows(scene: Scene) -> np.ndarray:
    """The values of all Gaussians, one row each, in an order of their own."""
    rows = np.concatenate([getattr(scene, name).reshape(scene.count, -1) for name in PARAMETERS], axis=1)
    return rows[np.lexsort(rows.T)]


@pytest.fixture(scope="module")
def ordered():
    """A scene with some invisible Gaussians, the rows of the others, and the order of those."""
    scene = ball(600)
    scene.opacity_logits[::10] = -12
    rows = np.flatnonzero(np.arange(600) % 10)
    visible = scene.select(rows)
    sums, _ = visibility_sums(ViewedScene.of(visible, cameras_around(visible, 12, 128)), pictures=False)
    return scene, rows, order_of(visible, sums, 7)


@pytest.fixture
def saved(ordered, tmp_path):
    scene, rows, order = ordered
    write_order(tmp_path, order, rows, scene.count)
    return tmp_path


@pytest.mark.parametrize("count", [7, 8, 100, 333, 539, 540])
def test_it_gives_what_the_order_gives(ordered, saved, count):
    scene, _, order = ordered
    found = read_order(saved, scene)
    assert (found.least, found.most) == (7, 540)
    assert (sorted_rows(found.at(count)) == sorted_rows(order.at(count))).all()


def test_numbers_beyond_its_ends_give_the_ends(ordered, saved):
    found = read_order(saved, ordered[0])
    assert [found.at(count).count for count in (-5, 0, 600)] == [7, 7, 540] and found.clipped(0) == 7


def test_it_moves_as_the_scene_does(ordered, saved):
    matrix = np.eye(4)
    matrix[:3, 3] = 1, 2, 3
    found = read_order(saved, ordered[0])
    assert found.moved(matrix).at(50).means == pytest.approx(
        found.at(50).means + np.array([1, 2, 3], np.float32), abs=1e-5
    )


@pytest.mark.parametrize("case", ["absent", "cut", "shape", "row", "twice", "born", "gap", "merged"])
def test_damaged_files_get_one_sentence(ordered, saved, case):
    table = np.load(saved / ORDER)
    if case == "absent":
        (saved / ORDER).unlink()
    elif case == "cut":
        (saved / ORDER).write_bytes((saved / ORDER).read_bytes()[:-50])
    elif case == "merged":
        made = read_ply(saved / MERGED)
        write_ply(saved / MERGED, made.select(np.arange(made.count - 1)))
    else:
        changed = dict(
            shape=table[:, :2], row=table + [[10_000, 0, 0]], twice=np.concatenate([table[:1], table[:-1]])
        )
        changed |= {"born": np.where([[0, 1, 0]], table + 50, table), "gap": table[1:]}
        np.save(saved / ORDER, changed[case].astype(np.int32))
    with pytest.raises(SplatError) as raised:
        read_order(saved, ordered[0])
    assert str(saved) in str(raised.value) and "\n" not in str(raised.value)


def test_a_quick_job_writes_it_down_to_a_hundredth(tmp_path):
    write_ply(tmp_path / "ball.ply", ball())
    options = PruneOptions(scene=tmp_path / "ball.ply", out=tmp_path / "small.ply", target=0.5, quick=True)
    plain = prune_scene(options)
    first = (tmp_path / "small.ply").read_bytes()
    assert prune_scene(options, lambda job: replace(job, order=tmp_path))["psnr"] == plain["psnr"]
    assert (tmp_path / "small.ply").read_bytes() == first
    found = read_order(tmp_path, read_ply(tmp_path / "ball.ply"))
    assert (found.least, found.most) == (20, 2_000)

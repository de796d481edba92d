"""Without photographs, quality is measured in views apart from those that decided, and never in pictures that
show almost nothing."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import scenes
from plans import prune_settings
from svrgs_addon.finetune import run
from svrgs_addon.finetune.quality import NOT_APART
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.belonging import percent, seen_of
from svrgs_addon.prune.blocks.allowed_drop import AllowedDrop
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.likeness import Likeness, PhotographLikeness, assumed_drop
from svrgs_addon.prune.recipes import fine_tuned
from svrgs_addon.render.metrics.measures import SHOWN, almost_empty
from svrgs_addon.scene.camera import Camera, apart, halfway
from svrgs_addon.views.cameras_json import write_cameras_json
from svrgs_addon.views.rendered import RenderedDataset
from tiny_dataset import views, write_tiny

WAYS = {
    "quick": "prune {scene} --data {data} --holdout 0 --quick --target 0.5 --out {out} --json",
    "own pictures": (
        "prune {scene} --seen-from {cameras} --seen-from-only --target 0.5 --recovery 10 --out {out} --json"
    ),
    "by blocks": "large prune {scene} --data {data} --holdout 0 --target 0.5 --out {out} --json",
}


def away(camera: Camera, number: int) -> Camera:
    """The view turned round."""
    return replace(camera, viewmat=np.diag([-1.0, 1, -1, 1]) @ camera.viewmat, name=f"away_{number}.png")


def test_a_view_halfway_stands_and_looks_between_its_neighbours(tiny):
    between = halfway(tiny.cameras)
    assert len(between) == len(tiny.cameras) - 1
    for a, b, middle in zip(tiny.cameras, tiny.cameras[1:], between, strict=False):
        assert middle.position == pytest.approx((a.position + b.position) / 2)
        axes = [camera.viewmat[:3, :3] for camera in (a, middle, b)]
        assert axes[1] @ axes[1].T == pytest.approx(np.eye(3), abs=1e-12) and np.linalg.det(axes[1]) > 0
        turns = [np.trace(axes[1] @ other.T) for other in (axes[0], axes[2])]
        assert turns[0] == pytest.approx(turns[1])
    assert halfway([tiny.cameras[0], away(tiny.cameras[0], 0)]) == [] == halfway(tiny.cameras[:1])


def test_a_picture_is_almost_empty_if_few_pixels_differ_from_its_background():
    picture = np.full((100, 100, 3), 0.5, np.float32)
    assert almost_empty(picture, (0.5, 0.5, 0.5)) and not almost_empty(picture, (0.5, 0.5, 0.51))
    picture[0, : round(1e4 * SHOWN) - 1, 1] = 0.6
    assert almost_empty(picture, (0.5, 0.5, 0.5))
    picture[1, 0] = 0
    assert not almost_empty(picture, (0.5, 0.5, 0.5))


def test_many_views_of_a_large_place_that_each_show_little_see_all_of_it():
    """Houses in a row, and one view of each."""
    houses = 80
    house = scenes.random_scene(20, 0, 0, spread=0.3, scale=0.05, opacity=2.0)
    street = house.select(np.tile(np.arange(20), houses))
    along = np.repeat(np.arange(houses, dtype=np.float32), 20)[:, None] * np.float32([100, 0, 0])
    street = replace(street, means=street.means + along)
    cameras, matrix = [], np.eye(4)
    for k in range(houses):
        matrix[0, 3] = -100 * k
        cameras.append(scenes.camera(64, 48, eye=(0, 0, -3)).moved(matrix))
    assert seen_of(street, cameras[:40]).share < 0.55 < 0.9 < seen_of(street, cameras).share
    assert seen_of(street, cameras).views == houses


@pytest.mark.parametrize("way", WAYS)
def test_no_view_that_decided_measures(svrgs, tiny, tmp_path, monkeypatch, way):
    """Where none is held out, views halfway between them measure, and not those of them that decide how much
    of the fine-tuning is used."""
    names: list[str] = []
    measured, evaluate = Likeness.measured, fine_tuned.evaluate

    def of_likeness(self, scene):
        names.extend(camera.name for camera in self.views)
        assert not {camera.key for camera in self.views} & {camera.key for camera in self.deciding.views}
        return measured(self, scene)

    def of_dataset(scene, dataset, indices, *more):
        names.extend(dataset.cameras[i].name for i in indices)
        return evaluate(scene, dataset, indices, *more)

    monkeypatch.setattr(Likeness, "measured", of_likeness)
    monkeypatch.setattr(fine_tuned, "evaluate", of_dataset)
    write_cameras_json(tmp_path / "cameras.json", tiny.cameras[:6])
    places = dict(
        scene=shutil.copy(tiny.splat, tmp_path), data=tiny.folder, cameras=tmp_path / "cameras.json"
    )
    result = svrgs(*WAYS[way].format(**places, out=tmp_path / "o.ply").split()).json
    assert names and all(name.startswith("between_") for name in names), names
    assert 15 < result["psnr"] < 60 and result["seen"] > 0.5 and result["seen_views"] > 4
    assert any(f"{result['seen_views']} views see" in note for note in result["notes"])


@pytest.mark.parametrize("way", ["prune", "large prune"])
def test_with_photographs_no_view_that_holds_an_allowed_drop_measures(
    svrgs, tiny, tmp_path, monkeypatch, way
):
    decided, measured = set[int](), set[int]()

    def record(where, name: str, indices: set[int], of_arguments):
        original = getattr(where, name)

        def recording(*arguments):
            indices.update(of_arguments(*arguments))
            return original(*arguments)

        monkeypatch.setattr(where, name, recording)

    record(run, "quality_views", decided, run.quality_views)
    record(fine_tuned, "evaluate", measured, lambda scene, dataset, indices, *_: indices)
    for name in ("floor_on_photographs", "fewest_above"):
        record(AllowedDrop, name, decided, lambda drop, *_: drop.likeness._indices)
    record(PhotographLikeness, "measured", measured, lambda likeness, *_: likeness._indices)
    words = ["--data", tiny.folder, "--holdout", 2, "--method", "removal", "--max-drop", 1]
    words += ["--iterations", 20, "--recovery", 20, "--out", tmp_path / "o.ply", "--json"]
    result = svrgs(*way.split(), tiny.splat, *words).json
    assert decided and measured and not decided & measured
    assert result["drop"] == pytest.approx(result["before"]["psnr"] - result["psnr"], abs=1e-3)


def test_a_drop_that_one_view_decides_and_measures_is_told(svrgs, tiny, tmp_path):
    words = ["--data", tiny.folder, "--holdout", 12, "--method", "removal", "--max-drop", 1]
    words += ["--iterations", 20, "--recovery", 0, "--out", tmp_path / "o.ply", "--json"]
    assert NOT_APART in svrgs("prune", tiny.splat, *words).json["notes"]


def test_by_blocks_a_dataset_without_a_view_to_measure_in_is_pruned_all_the_same(svrgs, tmp_path):
    tiny = write_tiny(tmp_path / "few", cameras=views(12)[:1])
    words = ["--holdout", 0, "--target", 0.5, "--out", tmp_path / "a.ply", "--json", "--force"]
    said = svrgs("large", "prune", tiny.splat, "--data", tiny.folder, *words)
    result = json.loads(said.out)
    assert result["psnr"] is None and "the quality is not measured" in "".join(result["notes"])


def test_without_a_view_to_measure_in_no_loss_is_allowed(svrgs, tiny, tmp_path):
    write_cameras_json(tmp_path / "one.json", tiny.cameras[:1])
    words = ["--seen-from", tmp_path / "one.json", "--seen-from-only", "--max-drop", 1, "--force"]
    shutil.copy(tiny.splat, tmp_path / "scene.ply")
    said = svrgs(f"prune {tmp_path}/scene.ply", *words, f"--iterations 4 --recovery 4 --out {tmp_path}/a.ply")
    assert said.status == 2 and "measured in views that are held out" in said.err


@pytest.mark.parametrize("shown", [1, 0])
def test_views_that_show_nothing_do_not_count(svrgs, tiny, tmp_path, shown):
    """Every second view is held out: of these some or all look away."""
    held_out = [c if k < shown else away(c, k) for k, c in enumerate(tiny.cameras[:4])]
    cameras = [camera for pair in zip(held_out, tiny.cameras[4:8], strict=True) for camera in pair]
    cameras = [replace(camera, name=f"{k}.png") for k, camera in enumerate(cameras)]  # in this order
    write_cameras_json(tmp_path / "cameras.json", cameras)
    words = ["--seen-from", tmp_path / "cameras.json", "--seen-from-only", "--holdout", 2]
    splat = shutil.copy(tiny.splat, tmp_path)  # apart from its photographs
    done = svrgs(
        "prune", splat, *words, "--target", 0.5, "--recovery", 10, "--out", tmp_path / "o.ply", "--json"
    )
    result = done.json
    if shown:
        assert 15 < result["psnr"] < 60
        assert "3 of the 4 views that measure show almost nothing, so they do not count" in result["notes"]
    else:
        assert result["psnr"] is result["ssim"] is result["flip"] is None
        assert any("the quality is not measured" in note for note in result["notes"])


def test_compare_measures_in_no_view_that_shows_nothing(svrgs, tiny, tmp_path):
    cameras = [tiny.cameras[0], away(tiny.cameras[0], 1)]
    for number in (2, 1):
        write_cameras_json(tmp_path / "cameras.json", cameras[-number:])
        words = ["--cameras", tmp_path / "cameras.json", "--out", tmp_path / "report", "--json"]
        done = svrgs("compare", tiny.splat, tiny.splat, *words)
        if number == 2:
            assert any("1 of the 2 views" in note for note in done.json["notes"])
        else:
            assert done.status == 2 and "none of its Gaussians is near a camera" in done.err


def test_shares_are_never_rounded_to_all_or_nothing():
    assert [percent(share) for share in (0, 1e-4, 0.5, 0.999, 1)] == ["0%", "1%", "50%", "99%", "100%"]


@pytest.mark.parametrize(("count", "decide"), [(0, 0), (1, 0), (5, 2), (16, 6)])
def test_views_that_decide_and_views_that_measure_are_apart(count, decide):
    deciding, measuring = apart(range(count), 6)
    assert len(deciding) == decide and sorted([*deciding, *measuring]) == list(range(count))


def test_views_that_show_almost_nothing_compare_nothing():
    view = scenes.camera(64, 48)
    turned = replace(view, viewmat=np.diag([-1.0, 1, -1, 1]) @ view.viewmat)
    (kept,) = Likeness(scenes.random_scene(300), [turned, view], Rasterizer).views
    assert kept is view


def test_a_loss_is_counted_from_the_photographs_or_from_the_splats_own_pictures(tiny, data):
    scene = scenes.random_scene(9)
    own = RenderedDataset.of(scene, tiny.cameras, [])
    for measure, before, after, lost, of_own in (
        ("psnr", 30.0, 29.0, 1.0, assumed_drop(29.0)),
        ("flip", 0.25, 0.5, 0.25, 0.5),
    ):
        plan = prune_settings("removal", 4, 4, max_loss=1.0, measure=measure)
        job = fine_tuned.FineTuned(
            tiny.splat, plan, JobContext(tiny.splat.with_name("o.ply")), lambda _: data
        )
        job.before = {measure: before}
        for job.dataset, expected in ((data, lost), (own, of_own)):
            assert job.lost({measure: after}) == pytest.approx(expected)

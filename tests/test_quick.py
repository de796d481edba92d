"""`svrgs prune --quick`: fewer Gaussians within seconds, without photographs."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import replace

import numpy as np
import pytest

from scenes import ball
from svrgs_addon.files import level_files, registry
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.files.registry import read_scene
from svrgs_addon.files.streamed_sog import read_level
from svrgs_addon.finetune.decimate.order import order_of, visibility_sums
from svrgs_addon.finetune.refit import USUAL, interpolated
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.prune import pipeline
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.recipes import quick
from svrgs_addon.prune.recipes.quick import Quick
from svrgs_addon.render.metrics.measures import psnr
from svrgs_addon.scene.affine import scaled
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.system.errors import Cancelled, SceneError
from svrgs_addon.views.rig.around import cameras_around, middle_and_radius

pytestmark = pytest.mark.usefixtures("small_pictures")


@pytest.fixture
def splat(tmp_path):
    path = tmp_path / "ball.ply"
    write_ply(path, ball())
    return path


def run(path, **more) -> dict:
    options = {"target": 0.25, "out": path.with_name("small.ply"), "quick": True, "scene": path} | more
    return pipeline.run(Quick(PruneOptions(**options), JobContext(options["out"], scene=path)))


@pytest.fixture(scope="module")
def ordered():
    scene = ball()
    viewed = ViewedScene.of(scene, cameras_around(scene, 12, 128))
    sums, pictures = visibility_sums(viewed)
    return scene, order_of(scene, sums, 50), pictures, viewed


def test_more_than_there_are_keeps_all_that_can_be_seen(splat):
    scene = read_ply(splat)
    scene.opacity_logits[:7] = -20
    write_ply(splat, scene)
    result = run(splat, target=None, target_count=9_999)
    assert result["count"] == scene.count - 7
    assert "7 Gaussians are invisible, so they are left out" in result["notes"]
    assert "9,999 Gaussians are asked for, and the scene has" in "".join(result["notes"])
    assert not any("merged first" in note for note in result["notes"])
    assert not any("left out" in note for note in run(splat)["notes"])


def test_an_order_gives_every_number(ordered):
    scene, order, *_ = ordered
    assert order.least == 50
    for count in (50, 51, 333, 1_000, scene.count - 1, scene.count):
        found = order.at(count)
        assert found.count == count
        assert all(
            np.isfinite(getattr(found, name)).all()
            for name in ("means", "log_scales", "quats", "opacity_logits", "sh")
        )


def test_pictures_that_nobody_wants_are_not_rendered(ordered):
    _, _, pictures, viewed = ordered
    with_pictures, without = visibility_sums(viewed), visibility_sums(viewed, pictures=False)
    assert len(pictures) == 12 and without[1] == [] and (with_pictures[0] == without[0]).all()


def test_the_whole_scene_is_the_original(ordered):
    scene, order, *_ = ordered
    assert all(
        (getattr(order.at(scene.count), name) == getattr(scene, name)).all()
        for name in ("means", "log_scales", "quats", "opacity_logits", "sh")
    )


def test_merging_keeps_the_pictures_better_than_removing_the_faintest(ordered):
    scene, order, pictures, viewed = ordered
    chosen = np.random.default_rng(0).permutation(scene.count)[:500]

    def quality(small: Scene) -> float:
        rendered = replace(viewed, scene=small).rendered(outputs=("rgb",))
        images = (found["rgb"].clip(0, 1) for _, found in rendered)
        return float(
            np.mean(
                [psnr(image, picture.clip(0, 1)) for image, picture in zip(images, pictures, strict=True)]
            )
        )

    assert quality(order.at(500)) > quality(scene.select(chosen)) + 6
    assert quality(order.at(1_000)) > quality(order.at(500)) > quality(order.at(100))


def test_the_command_writes_a_smaller_splat(svrgs, splat):
    result = svrgs(
        "prune", splat, "--quick", "--target", 0.25, "--out", splat.with_name("out.ply"), "--json"
    ).json
    assert read_ply(splat.with_name("out.ply")).count == result["count"] == 500
    assert result["psnr"] > 28 and result["before"]["count"] == 2_000 and result["method"] == "quick"
    assert result["bytes"] == splat.with_name("out.ply").stat().st_size


def test_the_same_run_gives_the_same_bytes(splat, default_threads):
    run(splat, out=splat.with_name("a.ply"))
    run(splat, out=splat.with_name("b.ply"), threads=1)
    assert splat.with_name("a.ply").read_bytes() == splat.with_name("b.ply").read_bytes()


@pytest.mark.parametrize("case", ("far", "tiny", "huge", "two clusters"))
def test_scenes_of_every_place_and_size(tmp_path, case):
    scene = {
        "far": lambda: ball(middle=(1e6, 1e6, -1e6), radius=50.0),
        "tiny": lambda: ball(radius=1e-3),
        "huge": lambda: ball(radius=1e5),
        "two clusters": lambda: _joined(ball(1_000), ball(1_000, middle=(500, 0, 0))),
    }[case]()
    write_ply(tmp_path / "s.ply", scene)
    result = run(tmp_path / "s.ply")
    found = read_ply(tmp_path / "small.ply")
    assert found.count == result["count"] == 500 and result["psnr"] > 20
    _, radius = middle_and_radius(scene)
    _, after = middle_and_radius(found)
    assert after == pytest.approx(radius, rel=0.3)


def _joined(a: Scene, b: Scene) -> Scene:
    return Scene.of(
        *(
            np.concatenate([getattr(a, name), getattr(b, name)])
            for name in ("means", "log_scales", "quats", "opacity_logits", "sh")
        )
    )


def test_one_gaussian(tmp_path):
    write_ply(tmp_path / "s.ply", ball(1))
    assert run(tmp_path / "s.ply", target=None, target_count=5)["count"] == 1


def test_what_cannot_be_seen_is_refused(tmp_path):
    scene = ball(50)
    write_ply(tmp_path / "s.ply", dataclasses.replace(scene, opacity_logits=np.full(50, -20, np.float32)))
    with pytest.raises(SceneError, match="opacity below 1/255"):
        run(tmp_path / "s.ply")


@pytest.mark.slow
def test_a_scene_with_a_sky_around_it_is_seen_from_inside(tmp_path):
    """A ball in a sky: from outside the ball is hidden, and would be removed first."""
    write_ply(tmp_path / "s.ply", _joined(ball(4_000), ball(6_000, radius=60.0)))
    result = run(tmp_path / "s.ply")
    found = read_ply(tmp_path / "small.ply")
    near = np.linalg.norm(found.means, axis=1) < 10
    assert found.count == 2_500 and 100 < near.sum() < 2_100, "neither the ball nor the sky is lost"
    assert "from places inside" in result["notes"][0] and result["psnr"] > 20


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"max_drop": 0.5, "target": None, "lambda_f": 1e-3}, "--lambda-f"),
        ({"target": None}, "--quick needs --target, --target-count, --target-size, an allowed"),
        ({"image_memory": 1.0}, "--image-memory"),
        ({"time": 5.0}, "--time"),
        ({"method": "svr"}, "--method"),
    ],
)
def test_options_that_it_does_not_have_are_refused(splat, more, words):
    with pytest.raises(SceneError, match=words):
        run(splat, **more)
    assert not splat.with_name("small.ply").exists()


@pytest.mark.slow
def test_several_splats_in_one_command(svrgs, splat, tmp_path):
    write_ply(tmp_path / "second.ply", ball(1_000, seed=1))
    done = svrgs(
        "prune", splat, tmp_path / "second.ply", "--quick", "--target", 0.5, "--out", tmp_path / "out"
    )
    assert done.status == 0, done.out + done.err
    assert [json.loads(line)["count"] for line in done.out.splitlines()] == [1_000, 500]


def test_a_stop_leaves_nothing_and_says_so(splat):
    options = PruneOptions(scene=splat, out=splat.with_name("small.ply"), target=0.25, quick=True)
    asked = iter([False, False, True])
    with pytest.raises(Cancelled, match="no checkpoint"):
        pipeline.prune_scene(options, lambda job: replace(job, stop=lambda: next(asked)))
    assert sorted(path.name for path in splat.parent.iterdir()) == ["ball.ply"]


def test_lost_columns_are_named(tmp_path):
    scene = ball(300)
    columns = {"nx": np.zeros(300, np.float32), "label": np.arange(300, dtype=np.float32)}
    write_ply(tmp_path / "s.ply", dataclasses.replace(scene, attributes=columns))
    assert run(tmp_path / "s.ply")["notes"][-1] == "these columns of the file were left out: label"


@pytest.mark.parametrize("target", [0.2, 0.9])
def test_steps_that_do_harm_are_taken_back(splat, monkeypatch, target):
    """The steps of this test paint all Gaussians grey."""

    before = []
    monkeypatch.setattr(
        quick,
        "refit",
        lambda scene, *_: before.append(scene) or dataclasses.replace(scene, sh=np.zeros_like(scene.sh)),
    )
    run(splat, target=target)
    assert (read_ply(splat.with_name("small.ply")).sh == before[0].sh).all()


def test_scenes_are_interpolated():
    first, second = ball(50), ball(50, seed=1)
    for share in (0.0, 0.25, 1.0):
        found = interpolated(first, second, share)
        for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
            assert getattr(found, name) == pytest.approx(
                (1 - share) * getattr(first, name) + share * getattr(second, name), abs=1e-6
            )


def test_a_full_disk_costs_the_order_and_not_the_result(splat, monkeypatch, tmp_path):
    def full(*_):
        raise SceneError("the disk is full")

    monkeypatch.setattr("svrgs_addon.prune.recipes.quick.write_order", full)
    out = splat.with_name("small.ply")
    options = PruneOptions(scene=splat, out=out, target=0.5, quick=True)
    result = pipeline.prune_scene(options, lambda job: replace(job, order=tmp_path))
    assert read_ply(out).count == result["count"] == 1_000 and "the disk is full" in result["notes"][-1]


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_a_file_is_rounded_by_the_views_that_decide(tmp_path, monkeypatch, size):
    scene, given = scaled(ball(), size), []
    write_ply(tmp_path / "ball.ply", scene)
    written = registry.write_scene
    monkeypatch.setattr(
        level_files,
        "write_scene",
        lambda *words, **choices: given.append(choices) or written(*words, **choices),
    )
    run(tmp_path / "ball.ply", out=tmp_path / "small.spz", levels=(0.5,))
    one, level = (choices["seen"] for choices in given)
    middle, radius = middle_and_radius(scene)
    distances = np.linalg.norm(one.positions - middle, axis=1) / radius
    assert len(distances) == 32 and 1 < distances.min() and distances.max() < 10
    assert one.weights.shape[1] == 2 * level.weights.shape[1]


def test_a_file_within_an_allowed_loss_is_the_one_that_was_decided(tmp_path, monkeypatch):
    """Its views would have to be rendered for each count that is tried."""
    write_ply(tmp_path / "a.ply", ball())
    given, write = [], registry.write_scene
    monkeypatch.setattr(
        level_files, "write_scene", lambda *a, **choices: given.append(choices) or write(*a, **choices)
    )
    run(tmp_path / "a.ply", target=None, max_drop=1.0, out=tmp_path / "a.spz")
    assert given and all(choices.get("seen") is None for choices in given)


def test_the_input_is_never_replaced(splat):
    with pytest.raises(SceneError, match="never overwritten"):
        run(splat, out=splat)


def test_an_allowed_drop_decides_how_many_stay(splat):
    """A splat with 30 dB on its photographs may lose so much there. The steps win a part back."""
    results = [run(splat, target=None, max_drop=drop) for drop in (0.05, 0.5, 3.0)]
    counts = [result["count"] for result in results]
    assert 2_000 > counts[0] > counts[1] > counts[2] >= 100
    for result, drop in zip(results, (0.05, 0.5, 3.0), strict=True):
        assert 0 < result["drop"] < 1.3 * drop
    assert run(splat)["drop"] is None


@pytest.mark.slow
def test_the_smallest_file_within_a_drop_is_chosen_by_count_and_steps_together(splat, tmp_path, monkeypatch):
    """Coarser steps of SH that hardly show make the file smaller than more pruning does."""
    scene, chance = ball(), np.random.default_rng(0)
    write_ply(
        splat,
        dataclasses.replace(
            scene,
            sh=np.concatenate(
                [scene.sh[:, :1], 0.02 * chance.standard_normal((2_000, 15, 3), np.float32)], axis=1
            ),
        ),
    )
    out = tmp_path / "a.spz"
    together = run(splat, out=out, target=None, max_drop=0.5)
    assert any("--quantise" in note for note in together["notes"]) and together["bytes"] == out.stat().st_size
    assert together["drop"] < 0.5
    monkeypatch.setattr(quick, "FACTORS", (1.0,))
    alone = run(splat, out=out, target=None, max_drop=0.5)
    assert together["bytes"] < alone["bytes"] and together["count"] >= alone["count"]
    assert not any("--quantise" in note for note in alone["notes"])


@pytest.mark.parametrize("suffix", (".ply", ".sog"))
def test_levels_of_detail_are_pruned_and_measured_each_on_its_own(splat, tmp_path, suffix):
    out = tmp_path / f"out{suffix}"
    result = run(splat, out=out, target=None, levels=(0.5, 0.25))
    assert result["count"] == 2000 and [level["count"] for level in result["levels"]] == [1000, 500]
    assert result["psnr"] > result["levels"][0]["psnr"] > result["levels"][1]["psnr"] > 20
    for level, name in zip(result["levels"], (f"out_50{suffix}", f"out_25{suffix}"), strict=True):
        assert level["out"] == str(tmp_path / name) and level["bytes"] == (tmp_path / name).stat().st_size
        assert read_scene(tmp_path / name).count == level["count"]


def test_levels_of_detail_go_into_one_streamed_sog(splat, tmp_path):
    out = tmp_path / "town" / "lod-meta.json"
    result = run(splat, out=out, target=None, levels=(0.5, 0.25))
    assert [sum(part.count for part in read_level(out, level)) for level in range(3)] == [2000, 1000, 500]
    assert result["bytes"] > result["levels"][0]["bytes"] > result["levels"][1]["bytes"] > 0
    assert {level["out"] for level in result["levels"]} == {str(out)}
    alone = run(splat, out=tmp_path / "half.sog", target=0.5)
    assert abs(alone["psnr"] - result["levels"][0]["psnr"]) < 0.5


def test_an_allowed_drop_counts_what_the_format_loses(splat, tmp_path):
    exact = run(splat, out=tmp_path / "a.ply", target=None, max_drop=0.3)
    packed = run(splat, out=tmp_path / "a.compressed.ply", target=None, max_drop=0.3)
    assert packed["drop"] <= 0.3 and exact["drop"] <= 0.3 and packed["count"] >= exact["count"]
    with pytest.raises(SceneError, match="the format alone loses .* not less than --max-drop allows"):
        run(splat, out=tmp_path / "a.splat", target=None, max_drop=0.01)
    assert not (tmp_path / "a.splat").exists()


@pytest.mark.parametrize("suffix, told", [(".ply", False), (".spz", True)])
def test_a_format_that_loses_more_than_pruning_is_told(tmp_path, suffix, told):
    scene = ball()
    # an SPZ holds values from -1 to 1
    scene.sh[:, 1:] = np.random.default_rng(0).normal(0, 2, scene.sh[:, 1:].shape)
    write_ply(tmp_path / "noise.ply", scene)
    notes = run(tmp_path / "noise.ply", target=0.9, out=tmp_path / f"o{suffix}")["notes"]
    assert any("the format of the output loses more than pruning" in note for note in notes) == told


def test_a_whole_scene_with_fewer_bands_is_tuned(splat):
    """What the bands showed is taken up by the others."""
    result, whole = run(splat, target=1.0, sh_degree=0), read_ply(splat)
    small = read_ply(result["out"] if "out" in result else splat.with_name("small.ply"))
    assert small.count == whole.count and small.sh_degree == 0 and (small.means != whole.means).any()


def test_few_gaussians_take_more_steps_and_all_of_them_fewer():
    assert [quick._steps(share) for share in (1.0, USUAL, USUAL / 2.25, 1e-6)] == [42, 60, 90, 120]

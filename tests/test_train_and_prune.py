"""Jobs that train and prune: what goes in and out, the same bytes for any threads, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import tiny_dataset
import whole_jobs
from plans import prune_settings, train_settings
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.files.registry import invisible, load_scene
from svrgs_addon.finetune import scores
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.recipes import fine_tuned
from svrgs_addon.system.errors import SceneError
from tiny_jobs import SETTINGS, TRAINING, prune


def test_the_command_line_reaches_the_skips(tiny, svrgs, tmp_path):
    words = f"train --data {tiny.folder} --iterations 30 --sh-degree 0 --quiet --json --out"
    outs = []
    for k, more in enumerate([(), ("--coarse-until", 0), ("--coarse-until", 15), ("--views-by-loss",)]):
        assert svrgs(words, tmp_path / f"{k}.ply", *more).status == 0
        outs.append((tmp_path / f"{k}.ply").read_bytes())
    assert outs[0] == outs[1] and len(set(outs)) == 3


def test_a_job_leaves_its_dataset_as_it_was(data, tmp_path):
    points, colors = data.points.copy(), data.point_colors.copy()
    whole_jobs.train(data, TRAINING, JobContext(tmp_path / "o.ply"), 1)
    assert (data.points == points).all() and (data.point_colors == colors).all()


def test_a_pruned_file_keeps_the_order_of_its_source(tiny, data, tmp_path):
    """Though rows were in another order while the job worked; further columns still belong to their
    Gaussians."""
    source = read_ply(tiny.splat)
    labels = np.arange(source.count, dtype=np.float32)
    write_ply(tmp_path / "labelled.ply", replace(source, attributes={"label": labels}, property_order=()))
    prune(replace(tiny, splat=tmp_path / "labelled.ply"), data, tmp_path / "o.ply")
    left = read_ply(tmp_path / "o.ply")
    rows = left.attributes["label"].astype(int)
    assert 5 < left.count < source.count and (np.diff(rows) > 0).all()
    moved = np.linalg.norm(left.means - source.means[rows], axis=1)
    assert moved.max() < 0.05 < np.median(np.linalg.norm(source.means - source.means.mean(axis=0), axis=1))


@pytest.mark.parametrize(
    ("method", "min_contribution", "target"),
    [
        ("removal", 0.0, 0),
        ("removal", 0.2, 0),
        ("removal", 0.9, 150),
        ("removal", 0.9, 230),
        ("contribution", 0.1, 40),
    ],
)
def test_the_first_cut_is_that_of_one_look_after_the_other(tiny, data, method, min_contribution, target):
    """Faint ones are no part of what is looked at, though all of a scene is drawn once: not even in place of
    those that no view shows."""
    scene = load_scene(tiny.splat)
    scene = scene.select(np.arange(scene.count)[::-1])  # the faint ones first
    scene.means[100:120, 1] += 1e4  # out of every view
    settings = prune_settings(
        method, 0 if method == "contribution" else 10, 0, target=target, min_contribution=min_contribution
    )
    views = [data.cameras[i] for i in data.train_indices]
    left = scene.select(~invisible(scene))
    for limit, count in (
        (min_contribution, target),
        (np.inf, target if method == "contribution" else left.count),
    ):
        score, peaks, _ = scores.contribution(ViewedScene.of(left, views))
        left = left.select((peaks >= limit) | scores.top(peaks if np.isfinite(limit) else score, count))
    cut = fine_tuned.first_scene(scene, data, settings)
    assert 0 < cut.count < scene.count
    np.testing.assert_array_equal(cut.means, left.means)


# --- determinism


def test_threads_do_not_change_the_output(tiny, svrgs, tmp_path):
    words = (f"prune {tiny.splat} --data {tiny.folder} --iterations 60 --recovery 20 --target 0.5", "--quiet")
    for threads in (1, 2):
        assert svrgs(*words, "--threads", threads, "--out", tmp_path / f"{threads}.ply").status == 0
    assert svrgs(*words, "--threads", 1, "--seed", 1, "--out", tmp_path / "seed.ply").status == 0
    one, two, seed = ((tmp_path / f"{name}.ply").read_bytes() for name in (1, 2, "seed"))
    assert one == two != seed


@pytest.mark.slow
def test_threads_do_not_change_training(tiny, svrgs, tmp_path):
    words = (
        f"train --data {tiny.folder} --iterations 620 --densify-until 650 --sh-degree 1 --quiet",
        "--json",
    )
    counts = [
        svrgs(*words, "--threads", threads, "--out", tmp_path / f"{threads}.ply").json["count"]
        for threads in (1, 2)
    ]
    assert counts[0] == counts[1] != tiny_dataset.SEEN, "densification should have happened"
    assert (tmp_path / "1.ply").read_bytes() == (tmp_path / "2.ply").read_bytes()


# --- what is refused, nothing written


def test_a_target_may_be_as_small_as_is_asked_for(tiny, data, tmp_path):
    scene = read_ply(tiny.splat)
    write_ply(tmp_path / "big.ply", scene.select(np.repeat(np.arange(scene.count), 10)))
    for method in ("svr", "removal", "opacity"):
        prune(
            replace(tiny, splat=tmp_path / "big.ply"),
            data,
            tmp_path / "o.ply",
            prune_settings(method, 30, 2, target=2),
            force=True,
        )
        assert read_ply(tmp_path / "o.ply").count == 2


def test_a_target_needs_iterations_to_prune_in(data, tmp_path):
    for method in ("maskgs", "opacity", "saliency"):
        with pytest.raises(
            SceneError, match=f"method '{method}' cannot reach a target without iterations in which it prunes"
        ):
            whole_jobs.train(data, train_settings(method, 0, 5, target=20), JobContext(tmp_path / "o.ply"))


def test_lambda_is_told_where_it_decided(tiny, data, tmp_path):
    def told(**settings):
        options = JobContext(tmp_path / "o.ply")
        return whole_jobs.prune(
            tiny.splat,
            data,
            prune_settings(settings.pop("method"), 20, 0, lambda_f=1e-5, **settings),
            options,
        )["lambda_f"]

    assert told(method="removal") == told(method="svr", target=100) == told(method="saliency") == 1e-5
    assert told(method="removal", target=100) is told(method="saliency", max_loss=3.0) is None


def test_a_scene_that_would_lose_everything(tiny, data, tmp_path):
    settings = replace(SETTINGS, mask_init=-20.0)
    with pytest.raises(SceneError, match="pruning would leave 0 of 240 Gaussians"):
        prune(tiny, data, tmp_path / "o.ply", settings)
    assert not list(tmp_path.iterdir())

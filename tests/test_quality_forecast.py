"""The quality that an estimate foresees: its law, what it measures on views, and how near it is to a run on
the tiny scene."""

from __future__ import annotations

import numpy as np
import pytest

from pictures import photographed
from plans import prune_settings
from scenes import random_scene
from svrgs_addon.files.ply import read_ply
from svrgs_addon.finetune import scores
from svrgs_addon.finetune.methods import METHODS
from svrgs_addon.finetune.quality import psnr_after, psnr_removed
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.jobs.estimate import estimate
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune import quality_forecast
from svrgs_addon.prune.expected_count import Expected, Seen
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.pipeline import prune_scene
from svrgs_addon.prune.quality_forecast import LEAST_STEPS, forecast, spread
from svrgs_addon.render.metrics.evaluate import mean_quality, render_options

SHARES = (1.0, 0.7, 0.5, 0.3, 0.2, 0.1, 0.05)
PLAN = prune_settings("removal", 900, 1500)


@pytest.fixture(autouse=True)
def all_test_views(monkeypatch):
    """However busy the machine is."""
    monkeypatch.setattr(quality_forecast, "SECONDS", 600.0)


@pytest.fixture(scope="module")
def trained(tiny, tmp_path_factory):
    """The splat of the tiny scene, trained to its end."""
    out = tmp_path_factory.mktemp("trained") / "trained.ply"
    prune_scene(
        PruneOptions(scene=tiny.splat, data=tiny.folder, method="3dgs", recovery=1500, quiet=True, out=out)
    )
    return out


@pytest.fixture(scope="module")
def scene(trained):
    return read_ply(trained)


@pytest.fixture(scope="module")
def ranking(scene, data) -> np.ndarray:
    return scores.contribution(ViewedScene.of(scene, data.cameras))[1]


def foreseen(scene, data, ranking, share: float, plan=PLAN):
    return forecast(scene, data, plan, ranking, round(share * scene.count))


@pytest.mark.slow
def test_the_fewer_stay_the_lower_it_is(scene, data, ranking):
    found = [foreseen(scene, data, ranking, share) for share in SHARES]
    for values in ([one.after for one in found], [one.removed for one in found]):
        assert values == sorted(values, reverse=True) and values[-1] < values[0] - 0.5
    assert all(one.removed <= one.after <= one.before + 1e-9 for one in found)


def test_where_nothing_is_removed_it_is_the_psnr_of_now(scene, data, ranking):
    found = foreseen(scene, data, ranking, 1.0)
    now = mean_quality(scene, data, data.test_indices, Rasterizer(), render_options(scene))
    assert found.before == found.removed == pytest.approx(now, abs=1e-6)
    assert found.after == pytest.approx(now, abs=1e-6)


def test_a_removal_without_steps_wins_nothing_back():
    assert psnr_after(30, 20, 0, 12) == pytest.approx(20)
    errors = [10 ** (-psnr_after(30, 20, steps, 12) / 10) - 1e-3 for steps in (0, 12, 36)]
    assert errors == pytest.approx([9e-3, 9e-3 / 2, 9e-3 / 4]), "half of the added error after 12 steps"
    assert psnr_after(30, 20, 800, 12) < psnr_after(30, 20, 8000, 12) < 30


def test_the_law_backwards_gives_the_removal_that_loses_so_much():
    for steps, after in ((0, 29.0), (800, 29.5), (8000, 27.0)):
        assert psnr_after(30, psnr_removed(30, after, steps, 10), steps, 10) == pytest.approx(after)


def test_a_removal_that_makes_the_views_better_promises_nothing():
    assert psnr_after(30, 31, 8000, 12) == pytest.approx(30)


@pytest.mark.parametrize(
    "plan",
    [
        prune_settings("opacity", 900, 1500, target=50),  # ranks by another score
        prune_settings("gns", 900, 1500),
        prune_settings("removal", 900, 1500, max_loss=0.5),  # the drop is the quality
        prune_settings("svr", 0, 1500),  # nothing is pruned
        prune_settings("removal", 300, LEAST_STEPS - 301),  # nothing so short was measured
    ],
)
def test_what_was_not_measured_is_not_foreseen(scene, data, ranking, plan):
    found = foreseen(scene, data, ranking, 0.5, plan)
    assert found.before == foreseen(scene, data, ranking, 0.5).before and found.removed is None
    assert found.after is None


@pytest.mark.parametrize("quick", [False, True])
def test_no_more_gaussians_are_foreseen_than_there_are(tiny, tmp_path, quick):
    given = {"scene": tiny.splat, "data": tiny.folder, "out": tmp_path / "a.ply", "quick": quick}
    found = estimate(PruneOptions(**given, target_count=9_999))
    assert found["kept"] <= found["count"] and found["bytes_after"] <= found["bytes_before"]
    assert (found["psnr_before"] is None) == quick, "a quick job has no photographs"


def test_every_fitted_number_belongs_to_a_method_that_prunes():
    assert all(method.prunes for method in METHODS.values() if method.halved)


def test_the_first_views_are_spread_over_all():
    views = list(range(100, 140))
    order = spread(views)
    assert sorted(order) == views
    for count in (3, 8, 20):
        gaps = np.diff(sorted([99, *order[:count], 140]))
        assert gaps.max() <= 2.7 * 40 / count, (count, gaps)


def test_a_busy_machine_renders_at_least_two_views(scene, data, monkeypatch):
    monkeypatch.setattr(quality_forecast, "SECONDS", -1.0)
    rendered = []
    monkeypatch.setattr(
        type(data),
        "image",
        lambda self, index, image=type(data).image: rendered.append(index) or image(self, index),
    )
    quality_forecast._mean_psnrs(scene, data, [None])
    assert (
        len(rendered) == len(set(rendered)) == quality_forecast.MIN_FORECAST_VIEWS <= len(data.test_indices)
    )


def foreseen_and_reached(trained, tiny, folder, **goal) -> tuple[dict, dict]:
    steps = {"method": "removal", "iterations": 300, "recovery": 500}
    options = PruneOptions(scene=trained, data=tiny.folder, out=folder / "o.ply", quiet=True, **steps, **goal)
    return estimate(options), prune_scene(options)


def test_it_is_near_what_a_short_run_reaches(trained, tiny, tmp_path):
    """Seen: 40.9 dB now, 40.9 dB foreseen, 44.2 dB reached: it is never foreseen to become better."""
    found, reached = foreseen_and_reached(trained, tiny, tmp_path, target=0.5)
    assert found["kept"] == reached["count"]
    assert found["psnr_before"] == pytest.approx(reached["before"]["psnr"], abs=1e-6)
    assert found["psnr_removed"] < found["psnr_before"] - 2
    assert found["psnr_after"] == pytest.approx(reached["psnr"], abs=4)
    assert abs(found["psnr_after"] - reached["psnr"]) < reached["psnr"] - found["psnr_removed"]


@pytest.mark.slow
def test_an_allowed_drop_keeps_no_more_than_foreseen(trained, tiny, tmp_path):
    kept = []
    for drop in (0.3, 3.0):
        found, reached = foreseen_and_reached(trained, tiny, tmp_path, max_drop=drop)
        assert found["at_most"] and reached["count"] <= found["kept"] < found["count"]
        kept.append(found["kept"])
    assert kept[1] < kept[0] / 1.5


def test_at_least_one_gaussian_is_expected_to_stay():
    scene = random_scene(9)
    expected = Expected(prune_settings("svr", 9, 9, min_contribution=0.1), scene, photographed(scene))
    expected.seen = Seen(np.zeros(9), np.zeros(9, np.float32), np.zeros(9, int), 3)
    assert expected.kept == 1

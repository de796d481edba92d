"""SH bands are left out by what the views show of them: by the command line, by every way to prune, and for
formats that hold none."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from scenes import ball, random_scene
from svrgs_addon.files import sh_rounding
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.files.sh_rounding import ELSEWHERE, SeenFrom, without_bands
from svrgs_addon.finetune.decimate.order import order_of, visibility_sums
from svrgs_addon.finetune.decimate.saved_order import read_order, write_order
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.pipeline import prune_scene
from svrgs_addon.prune.seen import FEWEST_VIEWS, fewer_bands
from svrgs_addon.render.metrics.evaluate import picture_options, render_options
from svrgs_addon.scene.gaussians import SH_COEFFICIENTS
from svrgs_addon.system.errors import Cancelled, FormatError, SceneError
from svrgs_bench.scenes import orbit_camera
from tiny_dataset import views as cameras_of
from tiny_dataset import write_tiny

CAMERAS = [orbit_camera(120, 90, turn) for turn in range(0, 90, 5)]  # a quarter of a turn


def psnr(scene, other, cameras) -> float:
    r, options = Rasterizer(), picture_options(scene)
    off = [r.forward(scene, one, options)["rgb"] - r.forward(other, one, options)["rgb"] for one in cameras]
    return float(-10 * np.log10(np.mean(np.square(off))))


@pytest.mark.parametrize("degree", (0, 1, 2))
def test_those_that_stay_are_the_least_squares_solution_in_the_directions_that_are_seen(degree, monkeypatch):
    """Against float64, in several parts; a Gaussian that no view shows is only cut."""
    monkeypatch.setattr(sh_rounding, "PART", 7)
    from reference.rasterize import sh_basis

    torch = pytest.importorskip("torch")
    scene, rng, keep = random_scene(20), np.random.default_rng(1), SH_COEFFICIENTS[degree]
    positions = rng.normal(size=(9, 3)).astype(np.float32)
    weights = rng.uniform(0, 9, (9, 20)).astype(np.float16)
    weights[:, 4] = 0
    found = without_bands(scene, degree, SeenFrom(positions, weights))
    for n in range(20):
        directions = (scene.means[n] - positions).astype(np.float64)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        Y = sh_basis(torch.tensor(directions), 3).numpy()
        share = weights[:, n].astype(np.float64) / max(1e-30, weights[:, n].astype(np.float64).sum())
        rows = np.concatenate([Y * np.sqrt(share)[:, None], np.eye(16) * np.sqrt(ELSEWHERE / (4 * np.pi))])
        best = np.linalg.lstsq(rows[:, :keep], rows @ scene.sh[n].astype(np.float64), rcond=None)[0]
        np.testing.assert_allclose(found.sh[n], best, atol=2e-5)
    np.testing.assert_allclose(found.sh[4], scene.sh[4, :keep], atol=1e-6)


@pytest.mark.parametrize("degree", (0, 1, 2))
def test_views_between_those_that_decide_lose_less_than_by_a_cut(degree):
    scene = random_scene(400)
    cut, fewer = fewer_bands(scene, degree, ()), fewer_bands(scene, degree, CAMERAS[::2])
    assert cut.sh_degree == fewer.sh_degree == degree
    np.testing.assert_array_equal(cut.sh, scene.sh[:, : SH_COEFFICIENTS[degree]])
    assert psnr(scene, fewer, CAMERAS[1::2]) > psnr(scene, cut, CAMERAS[1::2]) + 1


def test_too_few_views_say_nothing_and_a_scene_of_this_degree_stays_as_it_is():
    scene = random_scene(50, sh_degree=2)
    few = fewer_bands(scene, 1, CAMERAS[: FEWEST_VIEWS - 1])
    np.testing.assert_array_equal(few.sh, scene.sh[:, :4])
    assert fewer_bands(scene, 2, CAMERAS) is scene


def options(tiny, out, **more) -> PruneOptions:
    given = {"scene": tiny.splat, "data": tiny.folder, "out": out, "target": 0.5, "quiet": True}
    return PruneOptions(**given | {"iterations": 4, "recovery": 20} | more)


@pytest.mark.parametrize("more", ({}, {"quick": True}, {"method": "merge"}, {"data": None}))
def test_every_way_prunes_to_a_degree_and_measures_against_all_bands(tiny, tmp_path, small_rig, more):
    way = {"iterations": 3_000, "recovery": 5_000} if "quick" in more else {}
    whole = prune_scene(options(tiny, tmp_path / "a.ply", **more | way))
    fewer = prune_scene(options(tiny, tmp_path / "b.ply", sh_degree=0, **more | way))
    assert (read_scene(tmp_path / "a.ply").sh_degree, read_scene(tmp_path / "b.ply").sh_degree) == (1, 0)
    assert fewer["before"].get("psnr") == whole["before"].get("psnr") and fewer["count"] == whole["count"]
    assert fewer["psnr"] < whole["psnr"] and fewer["bytes"] < whole["bytes"]


@pytest.mark.parametrize("more", ({}, {"quick": True, "iterations": 3_000, "recovery": 5_000}))
def test_that_views_are_too_few_to_fit_them_is_said(tmp_path, more):
    tiny = write_tiny(tmp_path / "tiny", cameras=cameras_of(8))
    result = prune_scene(options(tiny, tmp_path / "a.ply", sh_degree=0, **more))
    assert any("views are too few to tell what spherical harmonics" in note for note in result["notes"])
    assert not any("too few" in note for note in prune_scene(options(tiny, tmp_path / "b.ply"))["notes"])


def test_a_quick_job_that_leaves_out_bands_alone_takes_its_steps(tiny, tmp_path, small_pictures):
    given = {"scene": tiny.splat, "data": tiny.folder, "quick": True, "quiet": True, "target": 1.0}
    result = prune_scene(PruneOptions(out=tmp_path / "a.ply", sh_degree=0, **given))
    write_scene(tmp_path / "cut.ply", fewer_bands(read_scene(tiny.splat), 0, ()))
    source = read_scene(tiny.splat)
    found, cut = read_scene(tmp_path / "a.ply"), read_scene(tmp_path / "cut.ply")
    assert result["count"] == found.count and found.sh_degree == 0
    assert psnr(source, found, tiny.cameras) > psnr(source, cut, tiny.cameras) + 1


def test_a_format_without_sh_is_pruned_for_and_said(tiny, tmp_path):
    """As with --sh-degree 0: the steps see what the file holds."""
    result = prune_scene(options(tiny, tmp_path / "a.splat"))
    prune_scene(options(tiny, tmp_path / "b.splat", sh_degree=0))
    assert (tmp_path / "a.splat").read_bytes() == (tmp_path / "b.splat").read_bytes()
    assert "the format .splat holds spherical harmonics up to degree 0" in " ".join(result["notes"])
    prune_scene(options(tiny, tmp_path / "c.ply"))
    write_scene(tmp_path / "c.splat", read_scene(tmp_path / "c.ply"))
    source = read_scene(tiny.splat)
    assert psnr(source, read_scene(tmp_path / "a.splat"), tiny.cameras) > 1 + psnr(
        source, read_scene(tmp_path / "c.splat"), tiny.cameras
    )


@pytest.mark.parametrize("suffix", (".ply", ".spz"))
def test_a_quick_job_says_that_the_bands_alone_lose_more_than_is_allowed(
    tiny, tmp_path, small_pictures, suffix
):
    given = {"scene": tiny.splat, "data": tiny.folder, "quick": True, "quiet": True, "max_drop": 0.001}
    with pytest.raises(SceneError, match="SH of degree 0 alone lose .* dB, not less than --max-drop allows"):
        prune_scene(PruneOptions(out=tmp_path / f"a{suffix}", sh_degree=0, **given))
    assert not (tmp_path / f"a{suffix}").exists()


def test_a_checkpoint_of_another_degree_is_refused(tiny, tmp_path):
    with pytest.raises(Cancelled):
        prune_scene(options(tiny, tmp_path / "a.ply", sh_degree=0), partial(replace, stop=lambda: True))
    with pytest.raises(FormatError, match="other settings"):
        prune_scene(options(tiny, tmp_path / "a.ply", resume=True))
    assert prune_scene(options(tiny, tmp_path / "a.ply", sh_degree=0, resume=True))["count"]


def test_the_order_of_a_result_with_fewer_bands_shows_no_more_of_them(tmp_path):
    scene, rasterizer = ball(400), Rasterizer()
    scene = replace(scene, sh=random_scene(400).sh)
    sums, _ = visibility_sums(ViewedScene(scene, CAMERAS, rasterizer, render_options(scene)))
    write_order(tmp_path, order_of(fewer_bands(scene, 1, CAMERAS), sums, 50), np.arange(400), 400)
    assert read_order(tmp_path, scene).at(300).sh_degree == 1


@pytest.mark.parametrize("suffix", (".ply", ".spz", ".splat"))
def test_convert_leaves_out_bands_by_the_views_of_a_dataset(tiny, tmp_path, svrgs, caplog, suffix):
    degree = [] if suffix == ".splat" else ["--sh-degree", 0]
    found = svrgs("convert", tiny.splat, tmp_path / f"a{suffix}", *degree, "--data", tiny.folder)
    assert found.status == 0
    assert ("higher ones are left out" in caplog.text) == (suffix == ".splat")
    svrgs("convert", tiny.splat, tmp_path / f"b{suffix}", *degree)
    source, seen, cut = map(read_scene, (tiny.splat, tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"))
    assert seen.sh_degree == cut.sh_degree == 0
    assert psnr(source, seen, tiny.cameras) > psnr(source, cut, tiny.cameras) + 1

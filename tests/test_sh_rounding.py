"""Spherical harmonics rounded by the error in the directions from which Gaussians are seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenes import random_scene
from svrgs_addon.files import sog_writer
from svrgs_addon.files.palette import palette, refined
from svrgs_addon.files.registry import load_scene, read_back, write_scene
from svrgs_addon.files.sh_rounding import ELSEWHERE, SeenFrom, basis, higher_factors, rounded
from svrgs_addon.files.spz import SEEN
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune import file_size
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.pipeline import prune_scene
from svrgs_addon.prune.seen import FEWEST_VIEWS, MOST_VIEWS, seen_from
from svrgs_addon.render.metrics.evaluate import picture_options
from svrgs_bench.scenes import orbit_camera

STEP = 0.1
COEFFICIENTS = (4, 9, 16)


def grid(_: int, values: np.ndarray) -> np.ndarray:
    return np.rint(values / STEP) * STEP


def narrow(count: int, coefficients: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """SH, and second moments of directions within a narrow cone."""
    rng = np.random.default_rng(seed)
    sh = rng.normal(0, 0.3, (count, coefficients, 3)).astype(np.float32)
    positions = np.array([[0, 0, -5], [0.5, 0, -5], [0, 0.7, -5]], np.float32)
    seen = SeenFrom(positions, np.ones((3, count), np.float16))
    return sh, seen.moments(np.zeros((count, 3), np.float32), coefficients)


def error(sh: np.ndarray, found: np.ndarray, moments: np.ndarray) -> float:
    off = (found - sh).astype(np.float64)
    return float(np.einsum("nkc,nkl,nlc->", off, moments.astype(np.float64), off))


@pytest.mark.parametrize("coefficients", COEFFICIENTS)
def test_the_basis_is_that_of_the_reference(coefficients):
    from reference.rasterize import sh_basis

    offsets = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    torch = pytest.importorskip("torch")
    unit = torch.tensor(offsets / np.linalg.norm(offsets, axis=1, keepdims=True), dtype=torch.float64)
    expected = sh_basis(unit, round(coefficients**0.5) - 1).numpy()
    np.testing.assert_allclose(basis(offsets, coefficients), expected, atol=1e-6)


def test_moments_are_the_weighted_mean_over_the_views_and_a_share_of_all_directions():
    rng = np.random.default_rng(1)
    means, positions = (rng.normal(size=(n, 3)).astype(np.float32) for n in (5, 4))
    weights = rng.uniform(0, 9, (4, 5)).astype(np.float16)
    weights[:, 3] = 0
    found = SeenFrom(positions, weights).moments(means, 16)
    for n in range(5):
        expected = np.eye(16) * ELSEWHERE / (4 * np.pi)
        for position, weight in zip(positions, weights[:, n].astype(float), strict=True):
            Y = basis((means[n] - position)[None], 16)[0].astype(float)
            expected += weight / max(1e-30, weights[:, n].astype(float).sum()) * np.outer(Y, Y)
        np.testing.assert_allclose(found[n], expected, atol=1e-5)


@pytest.mark.parametrize("coefficients", COEFFICIENTS)
def test_what_is_free_takes_up_the_error_as_well_as_it_can(coefficients):
    """The first coefficients, stored as they are, are the least squares solution for those of the others."""
    sh, moments = narrow(40, coefficients)
    fine = 2
    found = rounded(sh, moments, lambda k, values: values if k < fine else grid(k, values))
    off = (found - sh)[:, fine:].astype(np.float64)
    A = moments.astype(np.float64)
    best = -np.linalg.solve(A[:, :fine, :fine], A[:, :fine, fine:] @ off)
    np.testing.assert_allclose((found - sh)[:, :fine], best, atol=1e-5)
    np.testing.assert_array_equal(found[:, fine:], grid(0, found[:, fine:]))


def test_less_error_is_seen_than_by_rounding_each_alone():
    sh, moments = narrow(500, 16)
    assert error(sh, rounded(sh, moments, grid), moments) < 0.5 * error(sh, grid(0, sh), moments)


def test_gaussians_that_are_not_seen_are_rounded_as_usual():
    sh = narrow(30, 16)[0]
    seen = SeenFrom(np.zeros((1, 3), np.float32), np.zeros((1, 30), np.float16))
    moments = seen.moments(np.ones((30, 3), np.float32), 16)
    np.testing.assert_array_equal(rounded(sh, moments, grid), grid(0, sh))


def psnr(scene, other, cameras) -> float:
    r, options = Rasterizer(), picture_options(scene)
    off = [r.forward(scene, one, options)["rgb"] - r.forward(other, one, options)["rgb"] for one in cameras]
    return float(-10 * np.log10(np.mean(np.square(off))))


CAMERAS = [orbit_camera(120, 90, turn) for turn in range(0, 90, 5)]


def written(folder, suffix: str, scene, **choices) -> tuple[float, int]:
    """PSNR against the scene, in views between those that are known, and the size of a file."""
    path = folder / f"scene{suffix}"
    write_scene(path, scene, **choices)
    return psnr(scene, load_scene(path), CAMERAS[1::2]), path.stat().st_size


@pytest.mark.parametrize("suffix", [".spz", ".spz.glb"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_an_spz_loses_less_with_the_same_steps_and_is_smaller_with_its_own(suffix, degree, tmp_path):
    scene = random_scene(3_000, 5, degree)
    seen = seen_from(scene, CAMERAS[::2], tmp_path / f"a{suffix}")
    plain, size = written(tmp_path, suffix, scene)
    assert written(tmp_path, suffix, scene, quantise=1 / SEEN, seen=seen)[0] > plain + 0.3
    found, smaller = written(tmp_path, suffix, scene, seen=seen)
    assert found > plain - 1 and smaller < 0.97 * size


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_sog_loses_less_with_a_palette_of_the_least_error_that_is_seen(degree, tmp_path, monkeypatch):
    monkeypatch.setattr(sog_writer, "SHARES_SEEN", sog_writer.SHARES)
    monkeypatch.setattr(sog_writer, "SMALL_SEEN_ERROR", 0)  # as many entries
    scene = random_scene(3_000, 5, degree)
    plain, size = written(tmp_path, ".sog", scene)
    found, other = written(tmp_path, ".sog", scene, seen=seen_from(scene, CAMERAS[::2], tmp_path / "a.sog"))
    assert found > plain + 2 and other < 1.02 * size


@pytest.mark.parametrize("coefficients", COEFFICIENTS)
def test_a_palette_with_a_metric_for_each_row_has_less_error(coefficients):
    sh, moments = narrow(2_000, coefficients)
    factors, rows = higher_factors(moments), sh[:, 1:]
    entries, labels = palette(rows.reshape(len(rows), -1), np.ones(len(rows), np.float32), 100, 0)
    entries = entries.reshape(-1, *rows.shape[1:])
    found, its = refined(rows, entries, labels, lambda part: factors[part])

    def wrong(entries: np.ndarray, labels: np.ndarray) -> float:
        return float(np.square(factors @ (rows - entries[labels])).sum())

    assert found.shape == entries.shape and its.min() >= 0 and its.max() < len(found)
    assert wrong(found, its) < 0.9 * wrong(entries, labels)
    # |F e|^2 is the whole error, with the best first coefficient
    off = (rows - found[its]).astype(np.float64)
    first = -np.einsum("nk,nkc->nc", moments[:, 0, 1:], off) / moments[:, :1, 0]
    whole = np.concatenate([first[:, None], off], axis=1)
    left = np.einsum("nkc,nkl,nlc->", whole, moments.astype(np.float64), whole)
    assert left == pytest.approx(wrong(found, its), rel=1e-3)


def test_a_palette_whose_rows_hardly_count_stays_finite():
    sh, moments = narrow(300, 16)
    factors = higher_factors(moments) * np.geomspace(1e-19, 1, 300, dtype=np.float32)[:, None, None]
    factors[:50] = 0
    rows = sh[:, 1:]
    entries, labels = rows[:40], np.arange(300) % 40
    found, its = refined(rows, entries, labels, lambda part: factors[part])
    assert np.isfinite(found).all() and its.max() < 40


def test_a_sog_with_views_has_more_entries_where_less_error_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.setattr(sog_writer, "MIN_ENTRIES", 16)
    scene = random_scene(3_000, 5, 2)
    seen = seen_from(scene, CAMERAS, tmp_path / "a.sog")
    found = [written(tmp_path, ".sog", scene, quantise=factor, seen=seen) for factor in (8, 5, 1)]
    assert found[0][0] < found[1][0] < found[2][0] and found[0][1] < found[1][1] < found[2][1]


def test_a_sog_of_extreme_scales_is_written_with_views(tmp_path):
    scene = random_scene(500, 5, 3)
    scene.log_scales[:50], scene.log_scales[50:100] = 80, -80
    scene.opacity_logits[100:200], scene.sh[200:220] = -30, 1e6
    write_scene(
        tmp_path / "a.sog", scene, seen=SeenFrom(np.zeros((9, 3), np.float32), np.ones((9, 500), "f2"))
    )
    assert np.isfinite(load_scene(tmp_path / "a.sog").sh).all()


def test_a_sog_keeps_the_palette_that_a_scene_comes_out_of_with_views_too(tmp_path):
    scene = random_scene(3_000, 5, 2)
    scene.sh[:, 1:] = scene.sh[np.arange(3_000) % 200, 1:]
    found, _ = written(tmp_path, ".sog", scene, seen=seen_from(scene, CAMERAS, tmp_path / "a.sog"))
    stored = load_scene(tmp_path / "scene.sog").sh[:, 1:]
    assert len(np.unique(stored.reshape(3_000, -1), axis=0)) == 200 and found > 40


def test_views_that_are_not_known_are_not_given_up(tmp_path):
    scene, away = random_scene(3_000, 5), [orbit_camera(120, 90, turn) for turn in range(180, 270, 30)]
    found = []
    for choices in ({}, {"quantise": 1 / SEEN, "seen": seen_from(scene, CAMERAS, tmp_path / "a.spz")}):
        write_scene(tmp_path / "a.spz", scene, **choices)
        found.append(psnr(scene, load_scene(tmp_path / "a.spz"), away))
    assert found[1] > found[0] - 2


def test_formats_that_do_not_round_by_views_and_scenes_without_them_ask_for_none(tmp_path):
    scene, cameras = random_scene(50), [orbit_camera(60, 40, turn) for turn in range(100)]
    assert seen_from(scene, cameras, tmp_path / "a.ply") is None
    assert seen_from(replace(scene, sh=scene.sh[:, :1].copy()), cameras, tmp_path / "a.spz") is None
    assert seen_from(scene, cameras[: FEWEST_VIEWS - 1], tmp_path / "a.spz") is None
    seen = seen_from(scene, cameras, tmp_path / "a.spz")
    assert seen.weights.shape == (MOST_VIEWS, 50) and seen.positions.shape == (MOST_VIEWS, 3)


def test_a_streamed_sog_of_one_level_rounds_by_views_too(tmp_path):
    scene = random_scene(2_000, 3)
    cameras = [orbit_camera(120, 90, turn) for turn in range(0, 90, 10)]
    found = []
    for name, seen in (("plain", None), ("seen", seen_from(scene, cameras, tmp_path / "lod-meta.json"))):
        path = tmp_path / name / "lod-meta.json"
        path.parent.mkdir()
        write_scene(path, scene, seen=seen)
        found.append(psnr(scene, read_back(path, scene), cameras))
    assert found[1] > found[0] + 0.5


def test_a_job_writes_its_result_rounded_by_the_views_that_it_trained_on(tmp_path, monkeypatch, small_rig):
    write_scene(tmp_path / "a.ply", random_scene(300, 2))
    given, write = {}, file_size.write_scene

    def spy(path, scene, **choices):
        given[path.name] = choices.get("seen")
        write(path, scene, **choices)

    monkeypatch.setattr(file_size, "write_scene", spy)
    for name in ("b.spz", "b.ply"):
        options = {"scene": tmp_path / "a.ply", "out": tmp_path / name, "target": 0.5, "quiet": True}
        prune_scene(PruneOptions(**options, iterations=4, recovery=4))
    assert given["b.ply"] is None and given["b.spz"].weights.shape[1] == 150
    assert (given["b.spz"].weights > 0).any(axis=0).mean() > 0.5

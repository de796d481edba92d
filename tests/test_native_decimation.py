"""Decimation: what views see of each Gaussian, and the order of removals and merges."""

from __future__ import annotations

import numpy as np
import pytest

from native_helpers import FLOAT_LEVELS
from svrgs_addon.native import library
from svrgs_addon.native.decimation import REMOVED, decimate
from svrgs_addon.native.rasterizer import VISIBILITY, Rasterizer, RenderOptions
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.system.errors import Cancelled, NativeError

COUNT = 600


def cloud(count: int = COUNT, seed: int = 0, coefficients: int = 4) -> Scene:
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(count, 3)) * [1, 1, 0.5]
    scales = rng.uniform(-4, -2.5, size=(count, 3))
    return Scene.of(
        means,
        scales,
        rng.normal(size=(count, 4)),
        rng.normal(size=count) + 1,
        0.3 * rng.normal(size=(count, coefficients, 3)),
    )


def cameras() -> list[Camera]:
    views = []
    for k in range(4):
        c, s = np.cos(k * np.pi / 2), np.sin(k * np.pi / 2)
        viewmat = np.array([[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 4], [0, 0, 0, 1.0]])
        views.append(Camera(viewmat, np.array([[80.0, 0, 48], [0, 80, 40], [0, 0, 1]]), 96, 80))
    return views


def visibility_of(scene: Scene, level: str | None = None) -> np.ndarray:
    rasterizer, sums = Rasterizer(level), np.zeros((scene.count, len(VISIBILITY)))
    arrays = scene if rasterizer.dtype == np.float32 else _as_double(scene)
    for camera in cameras():
        rasterizer.forward(arrays, camera, RenderOptions(), outputs=())
        rasterizer.add_visibility(sums)
    return sums


def _as_double(scene: Scene):
    class Doubles:
        pass

    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        setattr(Doubles, name, getattr(scene, name).astype(np.float64))
    return Doubles


def ordered(scene: Scene, least: int, **more):
    return decimate(scene, visibility_of(scene), np.median(scene.means, axis=0), 0.05, least, **more)


def test_visibility_holds_the_scores_and_the_removal_error():
    scene, rasterizer = cloud(), Rasterizer("float64")
    arrays, n = _as_double(scene), scene.count
    sums, peaks, pixels = np.zeros(n), np.zeros(n, np.float32), np.zeros(n, np.int64)
    transmittance, error = np.zeros(n), np.zeros(n)
    views = np.zeros(n)
    for camera in cameras():
        before = pixels.copy()
        rasterizer.forward(arrays, camera, RenderOptions(), outputs=())
        rasterizer.add_scores(sums, peaks, pixels, transmittance)
        rasterizer.add_removal(error, np.zeros((camera.height, camera.width, 3)))
        views += pixels > before
    found = dict(zip(VISIBILITY, visibility_of(scene, "float64").T, strict=True))
    for name, expected in (
        ("weights", sums),
        ("transmittance", transmittance),
        ("pixels", pixels),
        ("squares", error),
        ("views", views),
    ):
        np.testing.assert_allclose(found[name], expected, rtol=1e-9, atol=1e-12, err_msg=name)
    assert ((found["density"] > 0) == (views > 0)).all()


@pytest.mark.parametrize("level", FLOAT_LEVELS)
def test_visibility_agrees_with_float64(level):
    scene = cloud()
    exact, found = visibility_of(scene, "float64"), visibility_of(scene, level)
    scale = np.abs(exact).max(axis=0)
    assert (np.abs(found - exact) / scale).max() < 1e-4


def test_an_order_leaves_each_row_in_one_place():
    scene, least = cloud(), 40
    order = ordered(scene, least)
    assert len(order.a) == COUNT - least
    merges = order.b != REMOVED
    gone = np.concatenate([order.a, order.b[merges]]).astype(np.int64)
    assert len(np.unique(gone)) == len(gone), "a row is used twice"
    born = COUNT + np.cumsum(merges) - 1  # the result of the operation, where it is a merge
    # a row is used before it is there
    assert (order.a < born + ~merges).all() and (order.b[merges] < born[merges]).all()
    assert len(order.results["means"]) == merges.sum()
    for name, array in order.results.items():
        assert np.isfinite(array).all(), name


def test_the_bits_do_not_depend_on_the_number_of_threads():
    scene, found = cloud(3_000), []
    for threads in (1, 2, 5):
        library.set_threads(threads)
        found.append(ordered(scene, 200))
    library.set_threads(0)
    for other in found[1:]:
        assert (found[0].a == other.a).all() and (found[0].b == other.b).all()
        assert (found[0].costs == other.costs).all()
        assert all((found[0].results[name] == other.results[name]).all() for name in other.results)


def _pair(distance: float, second: float = 0.4) -> Scene:
    """Two isotropic Gaussians of scale 0.1 and one opacity, whose colours are 0.4 and `second` above grey."""
    sh = np.zeros((2, 1, 3))
    sh[:, 0] = np.array([[0.4], [second]]) / 0.28209479177387814
    return Scene.of(
        [[0, 0, 0], [distance, 0, 0]], np.full((2, 3), np.log(0.1)), [[1, 0, 0, 0]] * 2, np.zeros(2), sh
    )


def _seen(scene: Scene, colour: np.ndarray) -> np.ndarray:
    """Visibility of Gaussians that are seen without occlusion by one view with 100 x 100 pixels per unit of
    area, blur included."""
    area, density = 2 * np.pi * (0.1**2 + 0.2 / 1e4), 1e4
    opacity = 1 / (1 + np.exp(-scene.opacity_logits.astype(np.float64)))
    weights = opacity * area * density
    return np.column_stack(
        [
            weights,
            np.ones(2),
            np.ones(2),
            np.full(2, 1e9),
            *(weights[:, None] * colour).T,
            np.ones(2),
            np.full(2, density),
        ]
    )


@pytest.mark.parametrize("distance", (0.02, 0.1, 0.3))
@pytest.mark.parametrize("level", [*FLOAT_LEVELS, "float64"])
def test_the_cost_of_a_merge_is_the_change_of_the_pictures(distance, level):
    """Against the same integral by quadrature, with the merged Gaussian that the order returns."""
    scene = _pair(distance, 0.1)
    colour = np.array([[0.4] * 3, [0.1] * 3])
    order = decimate(scene, _seen(scene, colour), np.zeros(3), 0.01, 1, level)
    assert order.b[0] != REMOVED
    merged, blur = {name: array[0].astype(np.float64) for name, array in order.results.items()}, 0.2 * 1e-4
    x, y = np.meshgrid(*[np.linspace(-1.5, 1.8, 1_101)] * 2, indexing="ij")
    cell = (x[1, 0] - x[0, 0]) ** 2
    rotation = _rotation(merged["quats"])
    cov = rotation @ np.diag(np.exp(2 * merged["log_scales"])) @ rotation.T
    opacity = 1 / (1 + np.exp(-merged["opacity_logits"]))
    total = 0.0
    for axes in ([1, 2], [0, 2], [0, 1]):
        picture = lambda mean, c, o, axes=axes: (
            o * _gaussian(x - mean[axes[0]], y - mean[axes[1]], c[np.ix_(axes, axes)] + blur * np.eye(2))
        )
        a, b = (picture(scene.means[k].astype(np.float64), 0.01 * np.eye(3), 0.5) for k in range(2))
        change = 0.4 * a + 0.1 * b - colour.mean() * picture(merged["means"], cov, opacity)
        total += 3 * (change**2).sum() * cell / 3
    assert order.costs[0] == pytest.approx(0.1 * total * 1e4, rel=2e-3)  # 0.1: kMergeFactor


def _gaussian(x, y, cov):
    inverse = np.linalg.inv(cov)
    return np.exp(-0.5 * (inverse[0, 0] * x * x + 2 * inverse[0, 1] * x * y + inverse[1, 1] * y * y))


def _rotation(quat):
    w, x, y, z = quat / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_equal_gaussians_merge_into_one_like_them():
    scene = _pair(0.0)
    order = decimate(scene, _seen(scene, np.full((2, 3), 0.4)), np.zeros(3), 0.01, 1)
    np.testing.assert_allclose(order.results["log_scales"][0], np.log(0.1), atol=1e-4)
    # twice 0.5, clamped
    assert 1 / (1 + np.exp(-order.results["opacity_logits"][0])) == pytest.approx(0.99, abs=1e-3)
    np.testing.assert_allclose(order.results["sh"][0], scene.sh[0], rtol=1e-6)


def test_gaussians_that_no_view_sees_go_first():
    scene = cloud()
    seen = visibility_of(scene)
    seen[: COUNT // 2] = 0
    unseen = np.flatnonzero(seen[:, 0] == 0)
    assert COUNT // 2 <= len(unseen) < COUNT
    order = decimate(scene, seen, np.zeros(3), 0.05, COUNT - len(unseen))
    assert (order.b == REMOVED).all() and set(order.a.tolist()) == set(unseen.tolist())
    assert (order.costs == 0).all()


def test_extreme_values_end_in_finite_results():
    scene, rng = cloud(), np.random.default_rng(1)
    scene.means[:5], scene.means[5:9] = np.nan, 1e30
    scene.log_scales[10:14] = [[80, -80, 0], [-1e9, 1e9, 3], [-50, -50, -50], [np.inf, 0, 0]]
    scene.quats[20:23] = 0
    scene.opacity_logits[30:33] = [np.inf, -np.inf, np.nan]
    scene.sh[40:42] = np.nan
    scene.means[50:90] = scene.means[50]
    seen = np.abs(rng.normal(size=(COUNT, 9))) * 100
    order = decimate(scene, seen, np.zeros(3), 0.05, 1)
    assert len(order.a) == COUNT - 1
    for name in ("means", "log_scales", "quats", "opacity_logits"):
        assert np.isfinite(order.results[name]).all(), name


def test_wrong_arguments_are_refused():
    scene = cloud(20)
    seen = visibility_of(scene)
    for least in (0, 21, -1):
        with pytest.raises(NativeError):
            decimate(scene, seen, np.zeros(3), 0.05, least)
    for unit in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(NativeError):
            decimate(scene, seen, np.zeros(3), unit, 5)
    with pytest.raises(NativeError):
        decimate(scene, seen, np.full(3, np.nan), 0.05, 5)
    with pytest.raises(TypeError):
        decimate(scene, seen.astype(np.float32), np.zeros(3), 0.05, 5)
    with pytest.raises(Cancelled):
        decimate(scene, seen, np.zeros(3), 0.05, 5, cancel=np.ones(1, np.int32))


def test_one_gaussian_and_nothing_to_do():
    scene = cloud(1)
    assert len(decimate(scene, visibility_of(scene), np.zeros(3), 0.05, 1).a) == 0

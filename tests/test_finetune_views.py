"""Which photographs a run looks at and how large: epochs, views by loss, reduced photographs early on."""

from dataclasses import replace

import numpy as np
import pytest

import scenes
from pictures import EYES, HEIGHT, WIDTH, photographed
from plans import plan_of
from svrgs_addon.finetune import checkpoint, densify
from svrgs_addon.finetune.engine import NativeEngine, Step
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Phase, Rates
from svrgs_addon.finetune.view_order import LEFT_OUT, ViewOrder
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.render.metrics import psnr
from svrgs_addon.views.reduced_photos import as_real, fitting_reduction

F32 = np.dtype(np.float32)


def views(seed: int, start: int, count: int, n: int = 5) -> list[int]:
    """The views shown from iteration `start` on; the first of them planned anew, as after a resume."""
    order, shown = ViewOrder(list(range(10, 10 + n)), seed), []
    for iteration in range(start + count):
        view = order.rest()[0]
        order.shown(view, 1.0)
        shown += [view] * (iteration >= start)
    return shown


def epochs(losses, count: int, n: int = 16) -> list[set[int]]:
    """The views shown in each of `count` epochs by loss; losses(epoch, view) is what showing one reports."""
    order, shown = ViewOrder(list(range(n)), 3, by_loss=True), []
    for epoch in range(count):
        rest = order.rest()
        for view in rest:
            order.shown(view, losses(epoch, view))
        shown.append(set(rest))
    return shown


# --- order


def test_every_epoch_is_a_permutation_of_its_own():
    epochs = np.array(views(seed=0, start=0, count=40 * 5)).reshape(40, 5)
    assert (np.sort(epochs, axis=1) == np.arange(10, 15)).all()
    assert len({tuple(epoch) for epoch in epochs}) > 20
    assert views(0, 0, 50) == views(0, 0, 50) != views(1, 0, 50)


def test_what_is_left_of_an_epoch_is_what_will_be_shown():
    order = ViewOrder([4, 7, 9, 11, 20], 2)
    planned = order.rest()
    for k, view in enumerate(planned):
        assert order.rest() == planned[k:]
        order.shown(view, 0.5)
    assert order.epoch == 1 and sorted(order.rest()) == [4, 7, 9, 11, 20]


def test_one_view_is_shown_again_and_again():
    assert views(0, 3, 4, n=1) == [10] * 4


def test_by_loss_the_easier_half_is_shown_every_other_time():
    """Losses that do not change: the lowest quarter and the one above it take turns, the harder half is
    always there."""
    shown = epochs(lambda epoch, view: 1.0 + view, 6)
    everything, half = set(range(16)), set(range(8, 16))
    assert shown == [
        everything,
        half | {4, 5, 6, 7},
        half | {0, 1, 2, 3},
        half | {4, 5, 6, 7},
        half | {0, 1, 2, 3},
        half | {4, 5, 6, 7},
    ]


def test_by_loss_no_view_is_left_out_twice_in_a_row():
    noise = np.random.default_rng(0).random((60, 19))
    shown = epochs(lambda epoch, view: noise[epoch, view], 60, n=19)
    assert all(before | after == set(range(19)) for before, after in zip(shown, shown[1:], strict=False))
    assert {len(epoch) for epoch in shown[1:]} == {19 - int(19 * LEFT_OUT)}
    assert len({frozenset(epoch) for epoch in shown}) > 20


def test_losses_are_smoothed_by_view():
    order = ViewOrder([3], 0)
    for loss in (4.0, 2.0, 1.0):
        order.shown(3, loss)
    assert order.losses.tolist() == [2.0]  # 4, then 3, then 2


# --- reduced photographs


@pytest.mark.parametrize("factor", [2, 4])
@pytest.mark.parametrize("size", [(64, 48), (67, 49)])
def test_a_reduced_camera_sees_every_point_at_that_share_of_its_pixel(factor, size):
    camera = scenes.camera(*size, eye=(0.4, -0.3, -3.0))
    small = camera.reduced(factor)
    assert (small.width, small.height) == (size[0] // factor, size[1] // factor)
    assert (small.viewmat == camera.viewmat).all() and small.name == camera.name
    for point in np.random.default_rng(1).normal(size=(20, 3)):
        full, reduced = ((c.K @ (c.viewmat[:3, :3] @ point + c.viewmat[:3, 3])) for c in (camera, small))
        np.testing.assert_array_equal(reduced[:2] / reduced[2], full[:2] / full[2] / factor)


def test_photographs_become_real_numbers_from_0_to_1():
    bytes_ = np.array([[[0, 128, 255]]], np.uint8)
    for dtype in (F32, np.dtype(np.float64)):
        image = as_real(bytes_, dtype)
        assert image.dtype == dtype and image[0, 0] == pytest.approx([0, 128 / 255, 1], rel=1e-6)
        assert as_real(image.astype(np.float32), dtype).dtype == dtype


@pytest.mark.parametrize("factor", [2, 4])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_a_reduced_photograph_is_made_of_the_means_of_its_blocks(factor, dtype):
    """Rows and columns beyond the last whole block are left out, as the reduced camera leaves them out."""
    photo = (
        np.random.default_rng(2).integers(0, 256, (4 * factor + 1, 6 * factor + factor - 1, 3)).astype(dtype)
    )
    photo = photo if dtype == np.uint8 else photo / np.float32(255)
    photo.flags.writeable = False
    full, small = as_real(photo, F32), as_real(photo, F32, factor)
    assert small.shape == (4, 6, 3) and small.dtype == np.float32 and small.flags.c_contiguous
    for y, x in ((0, 0), (3, 5), (1, 4)):
        block = full[y * factor : (y + 1) * factor, x * factor : (x + 1) * factor]
        np.testing.assert_allclose(small[y, x], block.mean(axis=(0, 1)), rtol=1e-6)
    whole = full[: 4 * factor, : 6 * factor]
    assert small.mean(dtype=np.float64) == pytest.approx(whole.mean(dtype=np.float64), rel=1e-6)


@pytest.mark.parametrize(
    ("factor", "size", "used"), [(1, (5, 5), 1), (4, (640, 64), 4), (4, (640, 63), 2), (2, (31, 900), 1)]
)
def test_small_photographs_are_reduced_less(factor, size, used):
    assert fitting_reduction(factor, *size) == used


def test_a_reduced_render_is_the_reduced_picture():
    """Nearly: a Gaussian's low-pass of 0.3 pixels is wider in reduced ones. Worst seen: 32.6 dB."""
    scene = scenes.random_scene(150, 2, 1, scale=0.2)
    dataset, rasterizer = photographed(scene), Rasterizer()
    for camera, picture in zip(dataset.cameras, dataset.pictures, strict=True):
        render = rasterizer.forward(scene, camera.reduced(2))["rgb"].clip(0, 1)
        assert psnr(render, as_real(picture, F32, 2)) > 30


def test_reduced_views_pull_as_full_ones_do():
    """Densification's statistic means the same at either size: seen: 1.3 % apart in the mean, correlation
    0.998."""
    truth, off = scenes.random_scene(400, 2, 1, scale=0.3), scenes.random_scene(400, 9, 1, scale=0.3)
    dataset, engine, means = photographed(truth), NativeEngine(), []
    for factor in (1, 2):
        model, statistics = Model.of(off), densify.Statistics(400)
        for camera, picture in zip(dataset.cameras, dataset.pictures, strict=True):
            view = camera.reduced(factor)
            step = Step(
                view, as_real(picture, F32, factor), 1, {}, RenderOptions(), update=False, want_means2d=True
            )
            result = engine.step(model, step)
            statistics.add(result.visible, result.means2d, view.width, view.height)
        means.append(statistics.mean())
    full, half = means
    seen = (full > 0) & (half > 0)
    assert half[seen].mean() == pytest.approx(full[seen].mean(), rel=0.1)
    assert np.corrcoef(full[seen], half[seen])[0, 1] > 0.98


class Watcher(NativeEngine):
    """Notes the camera and photograph of each step."""

    def __init__(self):
        super().__init__()
        self.seen = []

    def step(self, model, step):
        assert step.target.shape == (step.camera.height, step.camera.width, 3)
        self.seen.append((step.camera.width, step.camera.height))
        return super().step(model, step)


def run_of(*phases: Phase, engine=None, **changes) -> Run:
    scene = scenes.random_scene(150, 2, 1, scale=0.2)
    return Run(
        Model.of(scene), photographed(scene), plan_of("3dgs", phases, **changes), engine or NativeEngine()
    )


def advance(run: Run, until: int) -> Run:
    while run.iteration < until:
        run.advance()
    run.close()
    return run


@pytest.mark.parametrize(("factor", "sides"), [(2, [2] * 8 + [1] * 4), (4, [4] * 4 + [2] * 4 + [1] * 4)])
def test_steps_look_at_reduced_photographs_until_told_otherwise(factor, sides, monkeypatch):
    monkeypatch.setattr("svrgs_addon.views.reduced_photos.MIN_SIDE", 1)
    phases = Phase("train", 12, Rates(), coarse_until=8, coarse_factor=factor), Phase("recover", 3, Rates())
    run = advance(run_of(*phases, engine=Watcher()), 15)
    assert run.engine.seen == [(WIDTH // side, HEIGHT // side) for side in sides + [1] * 3]


COARSE = Phase(
    "train",
    40,
    Rates(),
    densify.Densify(start=5, until=31, every=10, gradient=2e-5, small=0.1),
    coarse_until=20,
)


def state(run: Run) -> dict[str, bytes]:
    parts = {"value": run.model.values, "moments": run.model.moments}
    arrays = {f"{part} {name}": array for part, found in parts.items() for name, array in found.items()}
    return {
        name: array.tobytes()
        for name, array in {**arrays, "losses": run.views.losses, "left out": run.views.left_out}.items()
    }


@pytest.mark.parametrize("stop", [3, len(EYES), 13, 20, 21, 38])
def test_a_run_goes_on_from_its_checkpoint_bit_for_bit(tmp_path, stop):
    """With reduced photographs and views by loss, wherever in an epoch it was stopped."""
    whole = advance(run_of(COARSE, views_by_loss=True), 40)
    checkpoint.save(advance(run_of(COARSE, views_by_loss=True), stop), tmp_path, "a run")
    resumed = run_of(COARSE, views_by_loss=True)
    assert checkpoint.restore(resumed, tmp_path, "a run") and resumed.iteration == stop
    assert state(advance(resumed, 40)) == state(whole)
    assert whole.views.epoch > 40 // len(EYES), "epochs should have been shorter than all views"


def test_neither_changes_a_run_that_did_not_ask():
    plain = advance(run_of(replace(COARSE, coarse_until=0)), 40)
    factor = advance(run_of(replace(COARSE, coarse_until=0, coarse_factor=4)), 40)
    assert state(plain) == state(factor)
    assert (
        state(advance(run_of(COARSE), 40))
        != state(plain)
        != state(advance(run_of(replace(COARSE, coarse_until=0), views_by_loss=True), 40))
    )

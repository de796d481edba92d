"""Rows along a Morton curve: near Gaussians lie together, and nothing but the speed of a run depends on
it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import scenes
from pictures import photographed
from plans import plan_of
from svrgs_addon.finetune import checkpoint
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Densify, Phase, Rates, recovery_phase
from svrgs_addon.scene.gaussians import PARAMETERS
from svrgs_addon.scene.morton_order import BITS, morton_codes, morton_order, spread_bits


def cloud(n: int = 5_000, outliers: int = 0) -> np.ndarray:
    """Means (n, 3) in no order; so many of them a million times as far out as the rest."""
    rng = np.random.default_rng(3)
    means = rng.normal(0, 1, (n, 3)).astype(np.float32) * (3, 1, 2) + 50
    means[rng.permutation(n)[:outliers]] *= 1e6
    return means.astype(np.float32)


def mean_step(means: np.ndarray) -> float:
    """Mean distance from row to row."""
    return float(np.linalg.norm(np.diff(means.astype(np.float64), axis=0), axis=1).mean())


# --- the order

SCENES = {
    "cloud": cloud(),
    "outliers": cloud(outliers=50),
    "float64": cloud().astype(np.float64),
    "one place": np.full((40, 3), 7.5, np.float32),
    "one place but for one": np.r_[np.full((40, 3), 7.5), [[1e30, -3, 2]]].astype(np.float32),
    "a plane": cloud() * np.float32([1, 0, 1]),
    "huge": cloud(300) * np.float32(1e36),
    "tiny": cloud(300) * np.float32(1e-38),
    "not finite": np.r_[
        cloud(300), [[np.nan] * 3, [np.inf, 0, 0], [0, -np.inf, 0], [np.nan, 1, np.inf]]
    ].astype(np.float32),
    "nothing finite": np.full((5, 3), np.nan, np.float32),
    "one": np.ones((1, 3), np.float32),
    "none": np.empty((0, 3), np.float32),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("means", SCENES.values(), ids=SCENES)
def test_the_order_is_a_permutation(means):
    order = morton_order(means)
    assert order.dtype == np.int64 and np.array_equal(np.sort(order), np.arange(len(means)))
    codes = morton_codes(means)
    assert (codes >= 0).all() and (np.diff(codes[order]) >= 0).all()


@pytest.mark.parametrize("outliers", [0, 50, 1_000])
def test_neighbours_in_the_order_are_near_in_space(outliers):
    """Seen: a row is 0.14 times as far from the next as in no order, with any number of outliers."""
    means = cloud(outliers=outliers)
    middle = np.abs(means - 50).max(axis=1) < 1e3
    ordered = means[morton_order(means)]
    ordered = ordered[np.abs(ordered - 50).max(axis=1) < 1e3]
    assert mean_step(ordered) < 0.2 * mean_step(means[middle])


def test_few_gaussians_share_a_cell():
    assert len(set(morton_codes(cloud(outliers=50)))) > 4_900


@pytest.mark.parametrize("axis", range(3))
def test_on_a_line_the_order_is_that_of_the_line(axis):
    means = np.zeros((1_000, 3), np.float32)
    means[:, axis] = np.random.default_rng(0).permutation(1_000)
    assert (means[morton_order(means), axis] == np.arange(1_000)).all()


def test_means_beyond_all_reason_lie_at_the_sides_without_a_warning():
    means = np.r_[cloud(100), np.float32([[3e38, -3e38, 0]])].astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        codes = morton_codes(means)
    highest = spread_bits(np.array([2**BITS - 1]))[0]
    # x at the high side, y at the low one
    assert codes[-1] & highest == highest and not codes[-1] & (highest << 1)
    assert sorted(morton_order(means)) == list(range(101))


def test_what_lies_in_one_place_keeps_its_order():
    means = np.repeat(cloud(100), 5, axis=0)
    order = morton_order(means).reshape(100, 5)
    assert (np.diff(order, axis=1) == 1).all()


def test_bits_are_spread_to_every_third_place():
    cells = np.array([0, 1, 2, 3, 2**BITS - 1, 0x155555, 0x0F0F0F], np.int64)
    expected = [int("".join(f"00{bit}" for bit in f"{cell:b}"), 2) for cell in cells.tolist()]
    assert spread_bits(cells).tolist() == expected


# --- in a run

GROWING = Phase(
    "train",
    45,
    Rates(),
    Densify(start=5, until=36, every=10, reset_every=25, gradient=2e-5, small=0.1),
    active=True,
    prune_every=10,
)


class Noting(Run):
    """Notes when rows were put in order, and whether they are then."""

    def _into_order(self):
        super()._into_order()
        assert self.plan.spatial_order == bool((np.diff(morton_codes(self.model.means)) >= 0).all())
        self.ordered = [*getattr(self, "ordered", []), self.iteration]


def run_of(*phases: Phase, **changes) -> Run:
    """Of 150 Gaussians that do not fit their photographs."""
    truth = scenes.random_scene(150, 2, 1, scale=0.2)
    start = replace(truth, sh=truth.sh * np.float32(0.5))
    return Noting(
        Model.of(start),
        photographed(truth),
        plan_of("svr", phases, mask_init=1.0, lambda_f=1e-3, **changes),
        NativeEngine(),
    )


def advance(run: Run, until: int) -> Run:
    while run.iteration < until:
        run.advance()
    run.close()
    return run


def state(run: Run) -> dict[str, bytes]:
    parts = {"value": run.model.values, "moments": run.model.moments, "": {"origin": run.model.origin}}
    return {
        f"{part} {name}": array.tobytes() for part, found in parts.items() for name, array in found.items()
    }


def test_rows_are_ordered_at_the_start_and_where_the_scene_grew():
    """At the last densification too, however little it added."""
    assert advance(run_of(GROWING), 45).ordered == [0, 10, 20, 30]


def test_a_little_growth_can_wait(monkeypatch):
    monkeypatch.setattr("svrgs_addon.finetune.run.REORDER_SHARE", 1e9)
    run = advance(run_of(GROWING), 45)
    assert run.ordered == [0, 30] and run.unordered == 0


@pytest.mark.parametrize("stop", [1, 9, 10, 15, 29, 30, 44])
@pytest.mark.parametrize("share", [0.0, 0.4])
def test_a_run_goes_on_from_its_checkpoint_bit_for_bit_across_reorderings(tmp_path, monkeypatch, stop, share):
    monkeypatch.setattr("svrgs_addon.finetune.run.REORDER_SHARE", share)
    whole = advance(run_of(GROWING), 45)
    checkpoint.save(advance(run_of(GROWING), stop), tmp_path, "a run")
    resumed = run_of(GROWING)
    assert checkpoint.restore(resumed, tmp_path, "a run")
    advance(resumed, 45)
    assert state(resumed) == state(whole)
    assert getattr(resumed, "ordered", []) == [iteration for iteration in whole.ordered if iteration > stop]


def test_the_order_changes_nothing_but_the_speed():
    """Without masks, which are drawn by row: the same Gaussians in the same order at the end."""
    ends = []
    for ordered in (True, False):
        run = advance(run_of(recovery_phase(30), spatial_order=ordered), 30)
        assert ordered != np.array_equal(run.model.origin, np.arange(150))
        ends.append(run.model.into_scene())
    for name in PARAMETERS:
        np.testing.assert_array_equal(getattr(ends[0], name), getattr(ends[1], name))


def test_every_array_of_a_run_is_ordered_alike():
    """Row by row, one array says of each Gaussian what the others do: those of a run without an order, found
    again by origin."""
    plain, ordered = (advance(run_of(recovery_phase(12), spatial_order=on), 12).model for on in (False, True))
    for part in ("values", "moments"):
        for name, array in getattr(ordered, part).items():
            np.testing.assert_array_equal(
                array, getattr(plain, part)[name][ordered.origin], err_msg=f"{part} {name}"
            )

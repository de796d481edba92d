"""The two engines against each other, step by step, and one step of both against the float64 reference."""

import importlib
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from native_helpers import some_moments
from reference import loss as reference_loss
from svrgs_addon.finetune import masks, torch_engine
from svrgs_addon.finetune.engine import BETAS, NativeEngine, Step
from svrgs_addon.finetune.model import MASK, Model
from svrgs_addon.finetune.moments import unpacked
from svrgs_addon.finetune.settings import Rates
from svrgs_addon.finetune.torch_engine import TorchEngine
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.scene.gaussians import PARAMETERS
from svrgs_addon.system.errors import SceneError

F32, F64 = np.dtype(np.float32), np.dtype(np.float64)
COUNT, STEPS, EXTENT = 80, 12, 4.0
LEVEL = {F32: "scalar", F64: "float64"}
VIEWS = [
    scenes.camera(48, 32),
    scenes.camera(40, 36, eye=(2.0, -2.5, -1.5), roll=25),
    scenes.camera(33, 21, eye=(-3.0, 1.0, -2.0)),
]
CASES = {  # spatial mask, lambda_f, lambda_m
    "plain": ("none", 0.0, 0.0),
    "svr": ("svr", 1e-2, 0.0),
    "self": ("self", 1e-2, 0.0),
    "a": ("a", 1e-2, 0.0),
    "b": ("b", 1e-2, 0.0),
    "maskgs": ("none", 0.0, 0.1),
    "both": ("svr", 1e-2, 0.1),
    "masks_alone": ("none", 0.0, 0.0),  # masks learn from the image only
}
# Differences are relative to the largest value of each array: in float64 after STEPS independent steps, in
# float32 after single steps from the same state.
PARAMETER_BOUND = {F64: 1e-13, F32: 4e-6}  # worst seen 1.5e-14; 7.9e-7 over all SIMD levels
CENTRE_BOUND = {F64: 1e-12, F32: 1e-4}  # worst seen 2.3e-13; 1.8e-5
FIRST_BOUND = {F64: 1e-12, F32: 2**-11}  # in 20 bits, the last of which may be rounded either way
FIRST_SH_BOUND = {F64: 1e-12, F32: 2**-7}  # in 16 bits
SECOND_BOUND = {F64: 1e-12, F32: 2**-4}  # in 12 bits
LOSS_BOUND = {F64: 1e-13, F32: 2e-5}  # worst seen 1.3e-14; 3.8e-6


def engines(dtype: np.dtype) -> tuple[NativeEngine, TorchEngine]:
    return NativeEngine(LEVEL[dtype]), TorchEngine(LEVEL[dtype])


def world(
    dtype: np.dtype, degree: int = 3, with_masks: bool = True, seed: int = 3
) -> tuple[Model, list[np.ndarray]]:
    """A model near the one whose renders are the photographs; no view sees all of it."""
    truth = Model.of(scenes.random_scene(COUNT, seed, degree, spread=1.6, scale=0.25), dtype)
    rasterizer = Rasterizer(LEVEL[dtype])
    photographs = [rasterizer.forward(truth, view, RenderOptions(degree))["rgb"] for view in VIEWS]
    rng = np.random.default_rng(seed + 1)
    model = Model(
        {name: (v + rng.normal(0, 0.05, v.shape)).astype(dtype) for name, v in truth.values.items()}
    )
    if with_masks:
        model.add_masks(0.0)
        model.values[MASK][:] = rng.normal(1.0, 1.0, COUNT)
    return model, photographs


def twin(model: Model) -> Model:
    """The same model in memory of its own."""
    parts = (
        {name: array.copy() for name, array in arrays.items()} for arrays in (model.values, model.moments)
    )
    return Model(*parts, origin=model.origin.copy())


def make_step(model: Model, photographs: list, number: int, case: str = "svr", **changes) -> Step:
    kind, lambda_f, lambda_m = CASES[case]
    view = number % len(VIEWS)
    drawn, slope = masks.draw(model, 0, number) if model.learns_masks else (None, None)
    options = changes.pop("options", RenderOptions(mask_kind=kind))
    target = np.ascontiguousarray(photographs[view][changes.get("window") or ...])
    step = Step(VIEWS[view], target, number, Rates().at(number, EXTENT), options, masks=drawn, slope=slope)
    return replace(step, lambda_f=lambda_f, lambda_m=lambda_m, want_means2d=True, **changes)


def difference(a: np.ndarray, b: np.ndarray) -> float:
    """Largest absolute difference, relative to the largest value of `a`."""
    assert a.shape == b.shape and a.dtype == b.dtype
    return float(np.abs(a - b).max(initial=0) / max(np.abs(a).max(initial=0), 1e-30))


def arrays(model: Model) -> dict[str, np.ndarray]:
    """Values, first and second moments, by name."""
    moments = {name: unpacked(array, model.values[name].shape) for name, array in model.moments.items()}
    first, second = ({name: pair[k] for name, pair in moments.items()} for k in range(2))
    parts = {"values": model.values, "first": first, "second": second}
    return {f"{part} {name}": array for part, found in parts.items() for name, array in found.items()}


def same(model: Model, other: Model) -> bool:
    """Every array equal bit for bit."""
    a, b = arrays(model), arrays(other)
    return a.keys() == b.keys() and all(a[name].tobytes() == b[name].tobytes() for name in a)


def assert_models_agree(native: Model, torch_: Model):
    for name, array in arrays(native).items():
        bound = {
            "values": PARAMETER_BOUND,
            "first": FIRST_BOUND,
            "second": SECOND_BOUND,
            "first sh": FIRST_SH_BOUND,
        }
        bound = bound.get(name) or bound[name.split()[0]]
        assert difference(array, arrays(torch_)[name]) <= bound[native.dtype], name


def assert_results_agree(native, torch_, dtype: np.dtype):
    np.testing.assert_array_equal(native.visible, torch_.visible)
    for term in ("l1", "ssim", "mask_loss"):
        assert getattr(torch_, term) == pytest.approx(getattr(native, term), rel=LOSS_BOUND[dtype]), term
    assert difference(native.means2d, torch_.means2d) <= CENTRE_BOUND[dtype]
    assert native.nonfinite == torch_.nonfinite == 0


def run_both(dtype: np.dtype, case: str, degree: int, *, resynchronise: bool, **changes):
    """STEPS steps of both engines, checked after each; resynchronise: every step starts from the native
    model."""
    model, photographs = world(dtype, degree, with_masks=case != "plain")
    other, (native, torch_) = twin(model), engines(dtype)
    before = twin(model)
    for number in range(1, STEPS + 1):
        step = make_step(model, photographs, number, case, **changes)
        results = native.step(model, step), torch_.step(other, step)
        assert 0 < len(results[0].visible) < COUNT
        assert_results_agree(*results, dtype)
        assert_models_agree(model, other)
        if resynchronise:
            other = twin(model)
    assert all(difference(before.values[name], value) > 1e-5 for name, value in model.values.items())


# --- the same steps


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("case", CASES)
def test_the_engines_walk_together_in_float64(case, degree):
    run_both(F64, case, degree, resynchronise=False)


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("case", CASES)
def test_each_step_is_the_same_in_float32(case, degree):
    run_both(F32, case, degree, resynchronise=True)


OPTIONS = {
    "visible_only": RenderOptions(mask_kind="svr", full=False),
    "antialiased": RenderOptions(mask_kind="b", antialiased=True),
    "background": RenderOptions(mask_kind="a", eps_a=1e-2, background=(0.2, 0.5, 0.9)),
    "low_degree": RenderOptions(sh_degree=1, mask_kind="self"),
}


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_render_options_reach_both_engines(options):
    run_both(F64, "svr", 3, resynchronise=False, options=options, l1_weight=1.0, ssim_weight=0.5)


def test_a_window_of_the_view_is_the_same_in_both_engines():
    run_both(F64, "svr", 3, resynchronise=False, window=(slice(3, 30), slice(9, 41)))


@pytest.mark.parametrize("case", ["svr", "both", "masks_alone"])
def test_frozen_gaussians_are_the_same_in_both_engines(case):
    """Also with an update of all rows of the masks, as lambda_m has it."""
    model, photographs = world(F64)
    other, before, (native, torch_) = twin(model), twin(model), engines(F64)
    frozen = np.arange(COUNT) % 3 == 0
    for number in range(1, STEPS + 1):
        step = replace(make_step(model, photographs, number, case, frozen=frozen), want_means2d=False)
        results = native.step(model, step), torch_.step(other, step)
        np.testing.assert_array_equal(results[0].visible, results[1].visible)
        assert not frozen[results[0].visible].any()
        assert_models_agree(model, other)
    for name, array in arrays(model).items():
        assert (array[frozen] == arrays(before)[name][frozen]).all(), name
        assert (array[~frozen] != arrays(before)[name][~frozen]).any(), name


def test_what_is_outside_of_the_window_has_no_part_in_the_image_loss():
    model, photographs = world(F64, with_masks=False)
    step = make_step(model, photographs, 1, "plain", window=(slice(0, 20), slice(0, 24)))
    shown = NativeEngine("float64").rasterizer.forward(model, step.camera, step.options)["rgb"]
    before = twin(model)
    result = NativeEngine("float64").step(model, step)
    assert result.l1 == pytest.approx(np.abs(shown[:20, :24] - step.target).sum() / shown.size, rel=1e-12)
    assert 0 < result.l1 < 1 - result.ssim < 1
    moved = (before.values["means"] != model.values["means"]).any(axis=1)
    assert 0 < moved.sum() < len(result.visible), "those that are only seen outside of it stay"


def test_each_kind_of_mask_gradient_gives_another_step():
    """Otherwise the agreement of the engines would say nothing about it."""
    ends = []
    for case in CASES:
        if case == "plain":
            continue
        model, photographs = world(F64)
        TorchEngine("float64").step(model, make_step(model, photographs, 1, case))
        ends.append(model.moments[MASK].tobytes())
    assert len(set(ends)) == len(ends)


@pytest.mark.parametrize("dtype", [F64, F32])
def test_the_engines_agree_across_pruning_and_growth(dtype):
    model, photographs = world(dtype)
    other, (native, torch_) = twin(model), engines(dtype)
    rng = np.random.default_rng(0)
    for number in range(1, STEPS + 1):
        step = make_step(model, photographs, number)
        assert_results_agree(native.step(model, step), torch_.step(other, step), dtype)
        assert_models_agree(model, other)
        if number % 4 == 0:
            kept, born = rng.permutation(model.count) >= 10, rng.integers(0, model.count - 10, 7)
            for m in (model, other):
                m.keep(kept)
                m.append({name: value[born] for name, value in m.values.items()})
        if dtype == F32:
            other = twin(model)
    assert model.count == COUNT - 3 * 3 and (model.origin == -1).any()


# --- what a step must leave alone


@pytest.mark.parametrize("engine", engines(F64), ids=["native", "torch"])
@pytest.mark.parametrize("case", ["svr", "both"])
def test_gaussians_out_of_view_do_not_move(engine, case):
    """Their moments neither. Only the global mask loss reaches them, and their masks alone."""
    model, photographs = world(F64)
    rng = np.random.default_rng(1)
    for name, value in model.values.items():  # moments that a dense Adam would act upon
        model.moments[name] = some_moments(value.shape, rng, F64, 1.0, 1)
    before = twin(model)
    result = engine.step(model, make_step(model, photographs, 5, case))
    unseen = np.setdiff1d(np.arange(COUNT), result.visible)
    assert len(unseen) > 5
    for name, now in arrays(model).items():
        was = arrays(before)[name]
        assert (
            (now[result.visible] != was[result.visible]).reshape(len(result.visible), -1).any(axis=1).all()
        ), name
        if case == "both" and name.endswith(MASK):
            assert (now[unseen] != was[unseen]).all()
        else:
            assert now[unseen].tobytes() == was[unseen].tobytes(), name


@pytest.mark.parametrize("dtype", [F64, F32])
def test_without_update_only_the_losses_and_centre_gradients_are_told(dtype):
    model, photographs = world(dtype)
    other = twin(model)
    step = make_step(model, photographs, 1, update=False)
    native, torch_ = engines(dtype)
    results = native.step(model, step), torch_.step(other, step)
    assert_results_agree(*results, dtype)
    assert np.abs(results[0].means2d).max() > 1e-6
    untouched, _ = world(dtype)
    assert same(model, untouched) and same(other, untouched)


@pytest.mark.parametrize("engine", engines(F32), ids=["native", "torch"])
def test_centre_gradients_are_not_told_where_nobody_asked(engine):
    model, photographs = world(F32)
    step = replace(make_step(model, photographs, 1), want_means2d=False)
    assert engine.step(model, step).means2d is None


@pytest.mark.parametrize("engine", engines(F32), ids=["native", "torch"])
def test_a_step_writes_into_the_arrays_of_the_model(engine):
    model, photographs = world(F32)
    owned = [id(array) for array in (*model.values.values(), *model.moments.values())]
    photographs[1].flags.writeable = False  # as photographs are
    engine.step(model, make_step(model, photographs, 1))
    assert [id(array) for array in (*model.values.values(), *model.moments.values())] == owned
    assert all(moments.any() for moments in model.moments.values())


def test_a_gradient_that_is_not_finite_stops_only_its_gaussians():
    """A bad pixel: the rows it reaches are counted and left alone by both engines, the others move alike."""
    model, photographs = world(F64)
    photographs[1][2, 3] = np.nan
    before, other = twin(model), twin(model)
    step = make_step(model, photographs, 1)
    native, torch_ = engines(F64)
    results = native.step(model, step), torch_.step(other, step)
    assert results[0].nonfinite == results[1].nonfinite > 0
    assert_models_agree(model, other)
    assert all(np.isfinite(array).all() for array in arrays(model).values())
    moved = (model.means != before.means).any(axis=1)
    assert 0 < moved.sum() < len(results[0].visible)


def poisoned(engine):
    """The engine, with one bad value in each of four rows of its gradients; `engine.bad` says which."""
    backward = engine.rasterizer.backward

    def with_bad_values(*arguments):
        grads = backward(*arguments)
        a, b, c, d = engine.bad = np.flatnonzero(grads["quats"].any(axis=1))[2:6]
        grads["means"][a, 1], grads["sh"][b, 5, 2], grads["sh"][c, 0, 0] = np.nan, np.inf, -np.inf
        grads["masks"][d] = np.nan
        return grads

    def update_with_bad_values(image_grads, tensors, rates, *, slope, frozen, wanted, **adam):
        assert frozen is None
        grads = with_bad_values(image_grads, (*tensors, *wanted))
        ids = engine.rasterizer.visible()
        if "masks" in tensors:
            grads["masks"] = grads["masks"] * slope[ids]
        return grads, sum(
            engine.rasterizer.adam(*tensors[name], grads[name], ids, lr=rates[name], **adam)
            for name in tensors
        )

    engine.rasterizer.backward, engine.rasterizer.backward_update = with_bad_values, update_with_bad_values
    return engine


@pytest.mark.parametrize("case", ["svr", "both"])
def test_a_bad_value_stops_its_row_of_its_array(case):
    model, photographs = world(F64)
    before, other = twin(model), twin(model)
    step = make_step(model, photographs, 1, case)
    native, torch_ = map(poisoned, engines(F64))
    results = native.step(model, step), torch_.step(other, step)
    assert results[0].nonfinite == results[1].nonfinite == 4
    assert_models_agree(model, other)
    rows = results[0].visible[native.bad]
    for name, still in {"means": [0], "quats": [], "sh": [1, 2], MASK: [3]}.items():
        unmoved = (model.values[name][rows] == before.values[name][rows]).reshape(4, -1).all(axis=1)
        assert np.flatnonzero(unmoved).tolist() == still, name


# --- the oracle's own terms


def test_the_torch_ssim_is_that_of_the_reference():
    rng = np.random.default_rng(2)
    x, y = (torch.tensor(rng.random((14, 9, 3))) for _ in range(2))
    assert torch_engine.ssim(x, y).item() == pytest.approx(reference_loss.ssim(x, y).item(), rel=1e-12)


def reference_gradients(model: Model, step: Step) -> dict[str, torch.Tensor]:
    """dL/d(every value) by autograd through the dense reference rasterizer and loss alone."""
    leaves = {name: torch.tensor(value, requires_grad=True) for name, value in model.values.items()}
    drawn = torch.tensor(step.masks, dtype=torch.float64)
    sampled = drawn + torch.tensor(step.slope) * (leaves[MASK] - leaves[MASK].detach())
    kind = step.options.mask_kind
    gradient = {"mask_kind": "svr", "mask_gradient": "self"} if kind == "self" else {"mask_kind": kind}
    render = scenes.reference_render({n: leaves[n] for n in PARAMETERS}, sampled, step.camera, **gradient)
    still = {n: leaves[n].detach() for n in PARAMETERS}  # the gradient of F reaches masks only
    F = scenes.reference_render(still, sampled, step.camera, **gradient).F
    loss = reference_loss.photometric_loss(render.rgb, torch.tensor(step.target))
    loss = loss + step.lambda_f * reference_loss.mask_loss(F) + step.lambda_m * sampled.mean() ** 2
    return dict(zip(leaves, torch.autograd.grad(loss, list(leaves.values())), strict=True))


@pytest.mark.parametrize("kind", ["svr", "self", "a", "b"])
@pytest.mark.parametrize("engine", engines(F64), ids=["native", "torch"])
def test_the_gradient_of_a_step_is_that_of_the_reference(engine, kind):
    """Read from the first moment after one step. Worst seen, relative to the largest: 7e-15."""
    model, photographs = world(F64)
    options = RenderOptions(mask_kind=kind)
    step = make_step(model, photographs, 1, "both", options=options)
    expected = reference_gradients(model, step)
    engine.step(model, step)
    for name in model.values:
        assert (
            difference(
                expected[name].numpy() * (1 - BETAS[0]),
                unpacked(model.moments[name], model.values[name].shape)[0],
            )
            < 1e-13
        ), name


def test_without_torch_the_engine_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "svrgs_addon.finetune.torch_engine")
    with pytest.raises(SceneError, match="needs PyTorch"):
        importlib.import_module("svrgs_addon.finetune.torch_engine")

"""The arrays of a run: one index map for all of them, and their way from points and to a scene."""

import math
from dataclasses import replace

import numpy as np
import pytest

import scenes
from short_runs import bits
from svrgs_addon.finetune.model import MASK, Model, scene_from_points
from svrgs_addon.scene.gaussians import PARAMETERS, SH_C0, Scene
from svrgs_addon.system.errors import SceneError


def numbered(n: int, with_masks: bool = True) -> Model:
    """Every array, moments too, says in each of its values which row it belongs to: 1, 2, ... n."""
    model = Model.of(scenes.random_scene(n, sh_degree=1))
    if with_masks:
        model.add_masks(0.0)
    for scale, arrays in ((1, model.values), (100, model.moments)):
        for array in arrays.values():
            array[:] = (scale * np.arange(1, n + 1)).reshape(-1, *[1] * (array.ndim - 1))
    return model


def scene_now(model: Model) -> Scene:
    """What the model would become, without ending it."""
    return Model(dict(model.values), origin=model.origin, metadata=model.metadata).into_scene()


@pytest.mark.parametrize("kept", [[1, 2, 4, 5, 7, 8, 10, 11], [0, 5, 11], list(range(12))])
@pytest.mark.parametrize("block", [1, 3, 100])
def test_rows_move_together(kept, block, monkeypatch):
    monkeypatch.setattr("svrgs_addon.finetune.model.BLOCK_ROWS", block)
    model = numbered(12)
    index = np.isin(np.arange(12), kept)
    model.keep(index)
    model.append({name: value[1:3] * 0 - 7 for name, value in model.values.items()})
    rows = np.arange(12)[index]
    assert model.count == len(rows) + 2 and model.origin.tolist() == [*rows, -1, -1]
    for scale, arrays, new in ((1, model.values, -7), (100, model.moments, 0)):
        for name, array in arrays.items():
            flat = array.reshape(len(array), -1)
            expected = np.concatenate([scale * (rows + 1.0), [new, new]])
            assert array.dtype == (np.float32 if scale == 1 else np.uint32) and array.flags.c_contiguous, name
            assert (flat == expected[:, None]).all(), name


def test_rows_change_places_together():
    model, order = numbered(12), np.random.default_rng(0).permutation(12)
    model.reorder(order)
    assert model.origin.tolist() == order.tolist()
    for scale, arrays in ((1, model.values), (100, model.moments)):
        assert arrays.keys() == {*PARAMETERS, MASK}
        for name, array in arrays.items():
            assert array.dtype == (np.float32 if scale == 1 else np.uint32) and array.flags.c_contiguous, name
            assert (array.reshape(12, -1) == scale * (order[:, None] + 1.0)).all(), name


def test_a_model_becomes_a_scene_in_the_order_of_its_source():
    """Whatever happened to its rows in between; Gaussians that were added come last, as they lie."""
    source = replace(scenes.random_scene(9), attributes={"label": np.arange(9, dtype=np.float32)})
    model, rng = Model.of(source), np.random.default_rng(1)
    model.reorder(rng.permutation(9))
    model.keep(~np.isin(model.origin, [0, 4]))
    scene, left = scene_now(model), [1, 2, 3, 5, 6, 7, 8]
    assert scene.attributes["label"].tolist() == left
    assert all((getattr(scene, name) == getattr(source, name)[left]).all() for name in PARAMETERS)
    model.append(
        {
            name: value[:2] * 0 + value.dtype.type([-1, -2]).reshape(2, *[1] * (value.ndim - 1))
            for name, value in model.values.items()
        }
    )
    model.reorder(np.r_[3:9, 1, 0, 2])
    scene = model.into_scene()
    for name in PARAMETERS:
        assert (getattr(scene, name)[:7] == getattr(source, name)[left]).all(), name
        assert [row.flat[0] for row in np.atleast_2d(getattr(scene, name)[7:].reshape(2, -1))] == [-1, -2], (
            name
        )


def test_a_model_in_the_order_of_its_source_becomes_a_scene_without_copies():
    model = Model.of(scenes.random_scene(9))
    arrays = dict(model.values)
    scene = model.into_scene()
    assert all(np.shares_memory(getattr(scene, name), value) for name, value in arrays.items())


def test_a_model_that_became_a_scene_holds_no_arrays():
    model = Model.of(scenes.random_scene(9))
    model.reorder(np.arange(9)[::-1].copy())
    assert model.into_scene().count == model.count == 9
    assert not model.values and not model.moments


def test_a_model_becomes_a_scene_with_the_columns_that_still_fit():
    more = {"attributes": {"label": np.arange(9, dtype=np.float32)}, "property_order": ("label", "x")}
    source = replace(scenes.random_scene(9), **more, antialiased=True)
    model = Model.of(source)
    model.keep(np.isin(np.arange(9), [2, 5, 8]))
    scene = scene_now(model)
    assert scene.attributes["label"].tolist() == [2, 5, 8] and scene.antialiased
    assert all((getattr(scene, name) == getattr(source, name)[[2, 5, 8]]).all() for name in PARAMETERS)
    model.append({name: value[:1] for name, value in model.values.items()})
    scene = model.into_scene()
    assert scene.attributes == {} and scene.property_order == () and scene.count == 4


def test_masks_come_and_go_without_touching_the_rest():
    model = numbered(4, with_masks=False)
    before = bits(model)
    model.add_masks(9.0)
    assert (model.mask_logits == 9).all() and not model.moments[MASK].any()
    model.remove_extras()
    assert bits(model) == before and not model.learns_masks
    with pytest.raises(AttributeError):
        _ = model.mask_logits


def test_points_become_gaussians_as_large_as_their_neighbourhood():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3], [50, 0, 0]], float)
    colors = np.array([[255, 0, 128]] * 5, np.uint8)
    scene = scene_from_points(points, colors, sh_degree=2)
    assert np.exp(scene.log_scales[0]) == pytest.approx([math.sqrt((1 + 4 + 9) / 3)] * 3, rel=1e-5)
    assert scene.sh.shape == (5, 9, 3) and (scene.sh[:, 1:] == 0).all()
    np.testing.assert_allclose(0.5 + SH_C0 * scene.sh[:, 0], colors / 255, atol=1e-6)
    assert 1 / (1 + np.exp(-scene.opacity_logits)) == pytest.approx([0.1] * 5, rel=1e-5)
    with pytest.raises(SceneError, match="too few"):
        scene_from_points(points[:3], colors[:3])

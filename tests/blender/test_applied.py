"""After Apply, and what is hidden: original and pruned splat are ordinary splats; the outliner's eye shows
the truth."""

from __future__ import annotations

import bpy
import pytest
from extension import part
from job_helpers import COUNT, SHORT, drawn, follow, set_up


def hidden(obj, layer=None) -> bool:
    """As the outliner's eye shows it and as a render sees it, which must agree. The monitor icon is not
    used."""
    assert obj.hide_get(view_layer=layer) == obj.hide_render and not obj.hide_viewport
    return obj.hide_render


def prune(obj, watch, results) -> bpy.types.Object:
    """A job of the splat from its start to its result."""
    former = results.pruned_of(obj)
    bpy.context.view_layer.objects.active = obj
    assert "svrgs.job_start" in drawn("prune")
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: results.pruned_of(obj) not in (None, former))
    return results.pruned_of(obj)


def apply(result):
    bpy.context.view_layer.objects.active = result
    bpy.ops.svrgs.apply()


def test_after_apply_both_can_be_pruned_again(pruned, watch):
    original, result = pruned
    bpy.ops.svrgs.apply()
    for obj, said in (
        (result, "Pruned from 'scene', 250 Gaussians, which is hidden"),
        (original, "Pruned to 'scene pruned', 125 Gaussians"),
    ):
        bpy.context.view_layer.objects.active = obj
        text = drawn("prune")
        assert said in text and "svrgs.job_start" in text and "Discard Original" in text
        assert bpy.ops.svrgs.job_start.poll()


def test_what_is_not_applied_is_not_pruned_again(pruned):
    for obj in pruned:
        bpy.context.view_layer.objects.active = obj
        with pytest.raises(RuntimeError, match="Apply or discard the result first"):
            bpy.ops.svrgs.job_start()


def test_a_pruned_splat_is_pruned_again(pruned, watch, results, bridge):
    first, second = pruned
    bpy.ops.svrgs.apply()
    third = prune(second, watch, results)
    assert results.pair_of(third) == results.pair_of(second) == (second, third)
    assert results.pair_of(first) == (first, second)
    assert [hidden(obj) for obj in (first, second, third)] == [True, True, False]
    assert bridge.count(third) == 62
    third.svrgs_share = 100
    assert [hidden(obj) for obj in (first, second, third)] == [True, False, True]
    third.svrgs_share = 40
    apply(third)
    assert bridge.count(third) == 50
    assert [hidden(obj) for obj in (first, second, third)] == [True, True, False]
    bpy.ops.svrgs.discard(what="ORIGINAL")
    assert set(bpy.data.objects) == {first, third} and results.pair_of(third) == (first, third)
    assert hidden(first)
    bpy.context.view_layer.update()
    assert results.pair_of(third) == (first, third) and hidden(first)


def test_a_second_result_that_does_not_please_leaves_the_first(pruned, watch, results, bridge):
    first, second = pruned
    bpy.ops.svrgs.apply()
    third = prune(second, watch, results)
    bpy.context.view_layer.objects.active = third
    bpy.ops.svrgs.discard(what="RESULT")
    bpy.context.view_layer.update()
    assert set(bpy.data.objects) == {first, second} and bridge.count(second) == 125
    assert "removed" not in second.data.attributes
    assert results.pair_of(second) == (first, second) and [hidden(first), hidden(second)] == [True, False]


def test_the_original_pruned_again_keeps_the_first_result(pruned, watch, results, bridge):
    """Hidden: it would be drawn over the new one."""
    original, first = pruned
    bpy.ops.svrgs.apply()
    set_up(SHORT | {"share": 30})
    second = prune(original, watch, results)
    assert results.pair_of(second) == (original, second) and results.pair_of(first) == (None, None)
    assert [hidden(obj) for obj in (original, first, second)] == [True, True, False]
    assert bridge.count(first) == 125 and bridge.count(second) == 75 and bridge.count(original) == COUNT


def test_an_original_with_a_running_job_is_not_discarded(pruned, watch):
    original, result = pruned
    bpy.ops.svrgs.apply()
    bpy.context.view_layer.objects.active = original
    set_up(SHORT | {"iterations": 800})
    bpy.ops.svrgs.job_start()
    bpy.context.view_layer.objects.active = result
    assert "svrgs.job_start" in drawn("prune"), "the pruned splat has no part in it"
    with pytest.raises(RuntimeError, match="A job is running on 'scene': stop it first"):
        bpy.ops.svrgs.discard(what="ORIGINAL")


def test_what_is_hidden_stays_so_after_the_file_is_opened_again(pruned, tmp_path):
    names = [obj.name for obj in pruned]
    for share, expected in ((50, [True, False]), (80, [False, True]), (30, [True, False])):
        bpy.data.objects[names[1]].svrgs_share = share
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "work.blend"))
        assert [hidden(bpy.data.objects[name]) for name in names] == expected
    bpy.context.view_layer.objects.active = bpy.data.objects[names[1]]
    bpy.ops.svrgs.discard(what="RESULT")
    assert not hidden(bpy.data.objects[names[0]])


def test_every_view_layer_hides_the_original(splat, watch, results):
    layer = bpy.context.scene.view_layers.new("second")
    other = bpy.data.scenes.new("other scene")
    other.collection.objects.link(splat)
    set_up(SHORT)
    result = prune(splat, watch, results)
    for seen in (bpy.context.view_layer, layer, other.view_layers[0]):
        assert hidden(splat, seen)
    assert not hidden(result, layer)
    bpy.ops.svrgs.discard(what="RESULT")
    assert not any(hidden(splat, seen) for seen in (bpy.context.view_layer, layer, other.view_layers[0]))
    bpy.context.scene.view_layers.remove(layer)
    bpy.data.scenes.remove(other)


def test_the_operator_for_scripts_hides_with_the_eye(splat):
    bpy.ops.svrgs.prune(data=bpy.context.scene.svrgs_prune.data, iterations=5, recovery=0, target=0.5)
    assert hidden(splat) and not hidden(bpy.context.object) and "Pruned from 'scene'" in drawn("prune")
    assert part("operators.jobs.job_result").pair_of(bpy.context.object) == (splat, bpy.context.object)

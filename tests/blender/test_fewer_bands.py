"""Fewer SH bands in a result and in an exported file."""

from __future__ import annotations

import re

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import ended, follow, set_up


def pruned(watch, **settings) -> bpy.types.Object:
    """The result of a job."""
    set_up(settings)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    follow(watch, lambda: ended(job))
    return bpy.context.object


def degree(obj: bpy.types.Object) -> int:
    return part("operators.data.splat_object").sh_degree(obj)


def test_a_quick_result_has_them_at_every_position_of_the_slider(splat, watch):
    result = pruned(watch, effort="QUICK", goal="SHARE", share=40, sh_degree=0)
    assert (degree(splat), degree(result)) == (1, 0)
    result.svrgs_share = 80
    shown = part("operators.view.compare").shown_scene(result)
    assert (shown.count, shown.sh_degree) == (200, 0)


def test_a_result_of_steps_has_them_and_takes_back_gaussians_without_the_others(splat, watch):
    result = pruned(
        watch, effort="PHOTOGRAPHS", goal="SHARE", share=40, sh_degree=0, iterations=10, recovery=10
    )
    assert (degree(splat), degree(result)) == (1, 0)
    result.svrgs_share = 80
    bpy.ops.svrgs.apply()
    found = part("operators.data.splat_object").scene_from_object(bpy.context.object)
    assert (found.count, found.sh_degree) == (200, 0)


def test_more_gaussians_fit_into_a_file_of_some_size(splat, watch):
    counts = []
    for degree in (3, 0):
        result = pruned(watch, effort="QUICK", goal="SIZE", size=0.003, sh_degree=degree)
        counts.append(part("operators.data.splat_object").count(result))
        bpy.ops.svrgs.discard(what="RESULT")
        bpy.context.view_layer.objects.active = splat
    assert counts[0] < counts[1]


def test_they_are_exported_by_what_the_imported_cameras_see(splat, tmp_path, capfd):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    read, found = part("svrgs_addon.files.registry").read_scene, []
    for name in ("a.ply", "b.spz", "c.splat"):
        for by_views in (True, False):
            capfd.readouterr()
            bpy.ops.svrgs.export_ply(filepath=str(tmp_path / name), sh_degree=0, by_views=by_views)
            said = "".join(capfd.readouterr())
            found.append(float(re.search(r"PSNR ([0-9.]+) dB against the splat", said)[1]))
            assert read(tmp_path / name).sh_degree == 0
        assert found[-2] > found[-1] + 0.5
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "d.ply"))
    assert read(tmp_path / "d.ply").sh_degree == 1
    np.testing.assert_array_equal(
        read(tmp_path / "d.ply").sh, part("operators.data.splat_object").scene_from_object(splat).sh
    )


@pytest.mark.parametrize("sh_degree", (0, 3))
def test_a_script_prunes_to_a_degree(splat, tmp_path, sh_degree):
    out = tmp_path / "a.ply"
    bpy.ops.svrgs.prune(
        scene=str(DATA / "tiny/scene.ply"), out=str(out), quick=True, target=0.4, sh_degree=sh_degree
    )
    assert part("svrgs_addon.files.registry").read_scene(out).sh_degree == min(1, sh_degree)

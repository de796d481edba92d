"""Train Smaller Sizes in the panel."""

from __future__ import annotations

import bpy
import pytest
from job_helpers import COUNT, SHORT, follow, marked, set_up


def test_smaller_sizes_are_trained_if_asked_for(splat, watch, bridge):
    set_up({"method": "removal", "goal": "SHARE", "share": 40, "recovery": 0, "nested": True})
    with pytest.raises(RuntimeError, match="set Recovery above 0"):
        bpy.ops.svrgs.job_start()
    set_up(SHORT | {"nested": True})
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    assert job.folder.request()["options"]["nested"] == 0.1
    follow(watch, lambda: len(bpy.data.objects) == 2)
    result = bpy.context.object
    result.svrgs_share = 10
    assert (~marked(bridge, result)).sum() == round(0.1 * COUNT) and bridge.count(result) == 125
    set_up({"nested": False})  # the scene is that of the other tests, too

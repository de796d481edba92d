"""A splat is trained from imported cameras, in the background."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import drawn, follow, said


def splats(bridge) -> list[bpy.types.Object]:
    return [obj for obj in bpy.data.objects if bridge.is_splat(obj)]


@pytest.fixture
def root(tmp_path, watch) -> bpy.types.Object:
    """The root of imported cameras; it is active."""
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "nerfstudio"))
    bpy.context.scene.svrgs_prune.folder = str(tmp_path / "jobs")
    bpy.context.scene.svrgs_train.iterations, bpy.context.scene.svrgs_train.use_time = 60, False
    return bpy.context.object


def test_a_splat_is_trained_and_placed_with_its_cameras(root, watch, bridge):
    assert root[bridge.POINTS] == 120 and "12 photographs, 120 sparse points" in drawn("train")
    bpy.ops.svrgs.train()
    (job,) = watch.jobs.values()
    assert job.folder.kind == "train" and not part("operators.jobs.train").about(bpy.context)
    assert part("operators.jobs.prune_state").stage(bpy.context) == "BUSY"
    assert part("operators.jobs.job_watch").current(bpy.context)[0] == root
    opened = part("operators.jobs.steps").opened
    assert opened(bpy.context) == "train"
    assert "job_stop" in drawn("train") and "iterations" not in drawn("train")
    assert "Train the splat first" in drawn("prune") and "job_stop" not in drawn("prune")
    follow(watch, lambda: splats(bridge))
    (splat,) = splats(bridge)
    assert opened(bpy.context) == "prune"
    assert splat.name == f"{root.name} splat" and splat.parent == root and bpy.context.object == splat
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(splat.matrix_world, root.matrix_world)
    assert bridge.count(splat) == job.folder.result()["count"] and bridge.sh_degree(splat) == 3
    # the splat can be pruned
    assert watch.job_of(root) is None and part("operators.jobs.prune_state").stage(bpy.context) == "READY"
    assert bpy.ops.svrgs.job_start.poll()


def test_the_list_of_photographs_shows_what_was_found_and_looks_through_their_cameras(
    root, watch, bridge, tmp_path
):
    photographs, view = part("operators.scene.photographs"), bpy.context.scene.svrgs_view
    cameras = photographs.of(root)
    assert [obj.data["svrgs_image"] for obj in cameras] == [f"{number:02}.png" for number in range(12)]
    assert not any(map(photographs.about, cameras))
    bpy.context.scene.svrgs_prune.exposure = "on"
    bpy.ops.svrgs.train()
    follow(watch, lambda: splats(bridge))
    bpy.context.scene.svrgs_prune.exposure = "auto"
    fitted = [obj for obj in cameras if photographs.about(obj)]
    assert len(fitted) == 10 and all(photographs.about(obj).endswith(" EV") for obj in fitted)
    assert part("panels.photographs").SVRGS_PT_photographs.poll(bpy.context)
    for obj in (cameras[3], cameras[5]):
        view.photograph = bpy.data.objects.find(obj.name)
        assert bpy.context.scene.camera == obj
    view.photograph = bpy.data.objects.find(root.name)
    assert bpy.context.scene.camera == cameras[5]
    mask = np.full((48, 64), 255, np.uint8)
    mask[:10] = 0
    (tmp_path / "masks").mkdir()
    image = bpy.data.images.new("mask", 64, 48)
    image.pixels.foreach_set(np.repeat(mask[::-1, :, None] / np.float32(255), 4, axis=2).ravel())
    image.filepath_raw, image.file_format = str(tmp_path / "masks" / "05.png.png"), "PNG"
    image.save()
    overlays = lambda obj: [
        one.image.name for one in obj.data.background_images if one.display_depth == "FRONT"
    ]
    bpy.context.scene.svrgs_prune.masks = str(tmp_path / "masks")
    view.photograph = bpy.data.objects.find(cameras[5].name)
    masked_out = part("operators.data.camera_object").MASKED_OUT
    assert overlays(cameras[5]) == [masked_out]
    assert part("operators.view.compare").photograph(cameras[5]).shape == (48, 64, 3)
    tint = bpy.data.images[masked_out]
    alpha = np.array(tint.pixels[:]).reshape(48, 64, 4)[::-1, :, 3]
    assert (alpha[:10] > 0.5).all() and not alpha[10:].any()
    another = bpy.data.cameras.new("of another dataset")
    another.background_images.new().image = tint
    bpy.context.scene.svrgs_prune.invert_masks = True
    assert not another.background_images
    alpha = np.array(tint.pixels[:]).reshape(48, 64, 4)[::-1, :, 3]
    assert not alpha[:10].any() and (alpha[10:] > 0.5).all()
    root["svrgs_masks"] = str(tmp_path / "masks")  # those of a job are never inverted
    view.photograph = bpy.data.objects.find(cameras[5].name)
    alpha = np.array(tint.pixels[:]).reshape(48, 64, 4)[::-1, :, 3]
    assert (alpha[:10] > 0.5).all() and not alpha[10:].any()
    bpy.context.scene.svrgs_prune.invert_masks = False
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"), copy=True)
    assert tint.packed_file is not None  # else a reloaded file would show black in front of the photograph
    view.photograph = bpy.data.objects.find(cameras[3].name)
    assert not overlays(cameras[5]) and not overlays(cameras[3])
    bpy.context.scene.svrgs_prune.masks = ""
    photographs.store(root, {"03.png": {"moved_pixels": 1.25, "hidden": 0.5}})
    assert photographs.about(cameras[3]) == "1.2 px, 50% hidden" and not photographs.about(cameras[5])


def test_it_is_stopped_and_resumed_like_any_job(root, watch, bridge):
    bpy.context.scene.svrgs_train.iterations = 2000
    bpy.ops.svrgs.train()
    (job,) = watch.jobs.values()
    follow(watch, lambda: job.facts.get("iteration", 0) > 5)
    assert not bpy.ops.svrgs.train.poll()
    bpy.ops.svrgs.job_stop()
    follow(watch, lambda: not job.running)
    assert job.state == "stopped" and "Stopped" in said()
    with pytest.raises(RuntimeError, match="Resume or discard the job of these cameras first"):
        bpy.ops.svrgs.train()
    bpy.ops.svrgs.job_resume()
    follow(watch, lambda: splats(bridge))
    assert job.state == "done"


def test_a_limit_of_time_takes_the_place_of_the_steps(root, watch):
    settings = bpy.context.scene.svrgs_train
    assert "iterations" in drawn("train")
    settings.use_time, settings.time = True, 3600
    assert "iterations" not in drawn("train")
    bpy.ops.svrgs.train()
    (job,) = watch.jobs.values()
    assert job.folder.request()["options"]["time"] == 3600
    follow(watch, lambda: job.facts.get("iteration"))
    assert job.facts["asked"] == 3600 and "Planned for 3600 s" in drawn("train")
    bpy.ops.svrgs.job_stop(now=True)
    follow(watch, lambda: not job.running)


def test_a_finished_job_is_loaded_by_hand_if_it_could_not_be_at_once(root, watch, bridge):
    bpy.ops.svrgs.train()
    (job,) = watch.jobs.values()
    mesh = bpy.data.objects.new("other", bpy.data.meshes.new("other"))
    bpy.context.collection.objects.link(mesh)
    bpy.context.view_layer.objects.active = mesh
    bpy.ops.object.mode_set(mode="EDIT")
    follow(watch, lambda: not job.running)
    assert not splats(bridge)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.objects.active = root
    assert "A finished job was found" in said()
    bpy.ops.svrgs.job_load()
    assert [obj.parent for obj in splats(bridge)] == [root]


def test_it_waits_for_other_jobs_and_its_files_go_when_the_file_is_saved(root, watch, bridge, tmp_path):
    bpy.ops.svrgs.train()
    (first,) = watch.jobs.values()
    bpy.ops.object.select_all(action="DESELECT")
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.ops.svrgs.train()
    second = watch.job_of(bpy.context.object)
    assert f"Waiting for '{root.name}'" in said() and not second.running
    follow(watch, lambda: len(splats(bridge)) == 2)
    assert watch.job_of(root) is None and first.folder.path.exists() and second.folder.path.exists()
    assert drawn("jobs").count("its files are deleted when the file is saved".split()[-1]) == 2
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    assert not first.folder.path.exists() and not second.folder.path.exists()


def test_a_job_whose_cameras_are_gone_is_opened_as_a_splat(root, watch, bridge):
    bpy.ops.svrgs.train()
    (job,) = watch.jobs.values()
    folder = bpy.context.scene.svrgs_prune.folder
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.context.scene.svrgs_prune.folder = folder
    assert "its cameras are not in this file" in drawn("jobs")
    follow(watch, lambda: not job.running)
    bpy.ops.svrgs.job_load(folder=str(job.folder.path))
    assert bpy.context.object.name == f"{job.name} splat"
    assert bridge.count(bpy.context.object) == job.folder.result()["count"]


def test_discarding_leaves_the_cameras(root, watch):
    bpy.ops.svrgs.train()
    (job,) = watch.jobs.values()
    follow(watch, lambda: job.facts.get("state") == "running")
    bpy.ops.svrgs.job_stop(now=True)
    follow(watch, lambda: not job.running)
    bpy.ops.svrgs.job_discard()
    assert not job.folder.path.exists() and len(root.children) == 13 and bpy.ops.svrgs.train.poll()


def test_it_is_offered_only_where_it_makes_sense(root, bridge):
    bpy.context.view_layer.objects.active = next(obj for obj in root.children if obj.type == "CAMERA")
    assert part("operators.jobs.train").about(bpy.context) and bpy.ops.svrgs.train.poll()
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    # a splat is active
    assert not part("operators.jobs.train").about(bpy.context) and not bpy.ops.svrgs.train.poll()
    bpy.context.view_layer.objects.active = root
    root[bridge.POINTS] = 0
    assert "has no sparse points to start from" in drawn("train") and not bpy.ops.svrgs.train.poll()


def test_without_cameras_there_is_nothing_to_train_from():
    assert not part("operators.jobs.train").about(bpy.context) and not bpy.ops.svrgs.train.poll()

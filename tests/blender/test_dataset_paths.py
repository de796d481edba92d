"""Where the photographs are: stored relative to the .blend file, right after any kind of saving, and found
again when they were moved."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import bpy
import pytest
from extension import DATA, part
from job_helpers import LONG, SHORT, drawn, follow, set_up


@pytest.fixture
def project(tmp_path, watch):
    """A folder with a dataset and, unsaved yet, a splat with its cameras."""
    folder = tmp_path / "project"
    shutil.copytree(DATA / "tiny", folder / "data")
    for name in ("data", "folder", "images", "masks"):
        bpy.context.scene.svrgs_prune.property_unset(name)
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.svrgs.import_ply(filepath=str(folder / "data/scene.ply"))
    bpy.ops.svrgs.import_colmap(directory=str(folder / "data"))
    return folder


def root() -> bpy.types.Object:
    (found,) = (obj for obj in bpy.data.objects if "svrgs_root" in obj)
    return found


def photographs() -> set[Path]:
    """The folders of all photographs, which must be there and be the background of a camera each."""
    images = [image for image in bpy.data.images if image.source == "FILE"]
    assert (
        len(images)
        == sum(bool(obj.data.background_images) for obj in bpy.data.objects if obj.type == "CAMERA")
        == 12
    )
    files = [Path(bpy.path.abspath(image.filepath)).resolve() for image in images]
    assert all(file.is_file() for file in files)
    return {file.parent for file in files}


def dataset() -> Path:
    return Path(part("operators.scene.dataset_paths").dataset_of(bpy.context)[0])


def save(path: Path, **options):
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), **options)


def select_splat():
    bpy.context.view_layer.objects.active = bpy.data.objects["scene"]


def test_a_project_that_is_moved_keeps_its_photographs(project, tmp_path):
    bpy.context.scene.svrgs_prune.data = str(project / "data")
    save(project / "work.blend")
    settings = bpy.context.scene.svrgs_prune
    assert root()["svrgs_dataset"] == settings.data == "//data"
    assert all(image.filepath.startswith("//data") for image in bpy.data.images if image.filepath)
    bpy.ops.wm.read_homefile(use_empty=True)
    moved = tmp_path / "moved/deeper"
    shutil.move(project, moved)
    bpy.ops.wm.open_mainfile(filepath=str(moved / "work.blend"))
    select_splat()
    assert dataset() == moved / "data" and photographs() == {moved / "data/images"}
    bpy.context.scene.svrgs_prune.data = ""
    assert dataset() == moved / "data" and bpy.ops.svrgs.job_start.poll() and bpy.ops.svrgs.estimate.poll()


def test_cameras_imported_into_a_saved_file_have_relative_paths_at_once(project):
    bpy.ops.wm.read_homefile(use_empty=True)
    save(project / "work.blend")
    bpy.ops.svrgs.import_colmap(directory=str(project / "data"))
    assert root()["svrgs_dataset"] == "//data" and photographs() == {project / "data/images"}
    photos = [image.filepath for image in bpy.data.images if image.source == "FILE"]
    assert all(path.replace(os.sep, "/").startswith("//data/images/") for path in photos)


@pytest.mark.parametrize("copy", [False, True])
def test_saving_in_another_folder_keeps_the_dataset(project, tmp_path, copy):
    settings = bpy.context.scene.svrgs_prune
    settings.data = str(project / "data")
    save(project / "work.blend")
    settings.folder, settings.masks = "//jobs", "//masks"
    save(tmp_path / "elsewhere/deep/work.blend", copy=copy)
    assert dataset() == project / "data" and photographs() == {project / "data/images"}
    assert Path(bpy.path.abspath(settings.folder)).resolve() == project / "jobs"
    assert Path(bpy.path.abspath(settings.masks)).resolve() == project / "masks"
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "elsewhere/deep/work.blend"))
    select_splat()
    assert dataset() == project / "data" and photographs() == {project / "data/images"}
    settings = bpy.context.scene.svrgs_prune
    assert Path(bpy.path.abspath(settings.folder)).resolve() == project / "jobs"
    assert Path(bpy.path.abspath(settings.masks)).resolve() == project / "masks"
    bpy.context.scene.svrgs_prune.data = ""
    assert dataset() == project / "data"


@pytest.mark.skipif(bpy.app.version < (5, 0), reason="Blender does not say what is appended")
def test_what_is_appended_keeps_its_dataset(project, tmp_path):
    save(project / "work.blend")
    bpy.ops.wm.read_homefile(use_empty=True)
    save(tmp_path / "elsewhere/other.blend")
    bpy.ops.wm.append(directory=f"{project}/work.blend/Object/", filename="scene")
    select_splat()
    assert dataset() == project / "data"
    save(tmp_path / "elsewhere/other.blend")
    assert dataset() == project / "data" and root()["svrgs_dataset"] == "//../project/data"


def test_a_relative_folder_of_a_file_without_a_name_is_relative_to_its_first_name(project):
    bpy.context.scene.svrgs_prune.folder = "//jobs"
    save(project / "work.blend")
    assert bpy.context.scene.svrgs_prune.folder == "//jobs"


def test_with_the_preference_off_paths_are_absolute(project):
    filepaths = bpy.context.preferences.filepaths
    filepaths.use_relative_paths = False
    try:
        save(project / "work.blend", relative_remap=False)
        assert root()["svrgs_dataset"] == str(project / "data")
    finally:
        filepaths.use_relative_paths = True


def test_a_save_that_fails_leaves_the_paths_right(project, tmp_path):
    save(project / "work.blend")
    with pytest.raises(RuntimeError):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "nowhere/deep/work.blend"))
    assert dataset() == project / "data"


# --- moved or gone


@pytest.fixture
def lost(project, tmp_path):
    """The project was opened again after its dataset had been moved; the new folder."""
    save(project / "work.blend")
    shutil.move(project / "data", tmp_path / "new place")
    bpy.ops.wm.open_mainfile(filepath=str(project / "work.blend"))
    select_splat()
    return tmp_path / "new place"


def test_a_lost_dataset_is_said_and_found_again(lost, project):
    said = f"The photographs of 'data' are not in {project / 'data'} any more: press Find Dataset in Scene"
    assert said in drawn("scene").replace("  ", " ") and said not in drawn("prune").replace("  ", " ")
    assert "svrgs.find_dataset" in drawn("scene")
    for operator in (bpy.ops.svrgs.job_start, bpy.ops.svrgs.estimate):
        with pytest.raises(RuntimeError, match="press Find Dataset in Scene"):
            operator()
    bpy.ops.svrgs.find_dataset(directory=str(lost))
    assert dataset() == lost and root()["svrgs_dataset"] == "//../new place"
    assert photographs() == {lost / "images"}
    assert "Find Dataset" not in drawn("prune") and "svrgs.find_dataset" not in drawn("scene")
    assert bpy.ops.svrgs.job_start.poll()


def test_masks_that_were_in_the_dataset_are_found_with_it(lost, project):
    for name in ("masks", "distractors"):
        (lost / name).mkdir()
    bpy.context.scene.svrgs_prune.masks = "//data/masks"
    root()["svrgs_masks"] = str(project / "data/distractors")
    bpy.ops.svrgs.find_dataset(directory=str(lost))
    paths = part("operators.scene.dataset_paths")
    assert paths.masks_of(bpy.context)["masks"] == str(lost / "masks")
    assert paths.masks_of_job(root()) == str(lost / "distractors")


def test_photographs_that_are_missing_in_the_new_place_are_counted(lost, capfd):
    (lost / "images/03.png").unlink()
    bpy.ops.svrgs.find_dataset(directory=str(lost))
    assert f"Found 11 of 12 photographs in {lost}" in capfd.readouterr().out


def test_a_folder_that_is_not_the_dataset_is_refused(lost, tmp_path):
    with pytest.raises(RuntimeError, match="holds no COLMAP model"):
        bpy.ops.svrgs.find_dataset(directory=str(tmp_path))
    shutil.move(lost / "images", tmp_path / "aside")
    with pytest.raises(RuntimeError, match="holds none of the 12 photographs of 'data'"):
        bpy.ops.svrgs.find_dataset(directory=str(lost))
    assert not dataset().is_dir()


def test_photographs_in_another_folder_of_the_dataset_are_found_by_their_names(project, tmp_path):
    """As those of the folder images_2, which the first import named."""
    bpy.ops.wm.read_homefile(use_empty=True)
    (project / "data/images").rename(project / "data/images_2")
    bpy.ops.svrgs.import_colmap(directory=str(project / "data"), images="images_2")
    for image in bpy.data.images:
        if image.source == "FILE":
            image.filepath = str(tmp_path / "an old place/images_2" / Path(image.filepath).name)
    bpy.ops.svrgs.find_dataset(directory=str(project / "data"))
    assert photographs() == {project / "data/images_2"}


def test_a_chosen_dataset_that_does_not_exist_disables_the_buttons(project):
    select_splat()
    bpy.context.scene.svrgs_prune.data = "/nowhere"
    for operator in (bpy.ops.svrgs.job_start, bpy.ops.svrgs.estimate):
        with pytest.raises(RuntimeError, match="There is no dataset .nowhere: choose it again"):
            operator()
    assert f"There is no dataset {os.sep}nowhere: choose it again" in drawn("prune")


# --- jobs


def test_a_project_that_is_moved_keeps_its_job(project, tmp_path, watch, results):
    """Its folder, and its dataset, which the job knows by its former place."""
    save(project / "work.blend")
    select_splat()
    set_up(SHORT | {"iterations": 800})
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    follow(watch, lambda: job.facts.get("iteration", 0) > 5)
    bpy.ops.svrgs.job_stop()
    follow(watch, lambda: not job.running)
    save(project / "work.blend")
    assert bpy.data.objects["scene"]["svrgs_job"].startswith("//svrgs_jobs/")
    bpy.ops.wm.read_homefile(use_empty=True)
    shutil.move(project, tmp_path / "moved")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "moved/work.blend"))
    select_splat()
    _, job = watch.current(bpy.context)
    assert job.state == "stopped" and job.folder.path.parent == tmp_path / "moved/svrgs_jobs"
    bpy.ops.svrgs.job_resume()
    follow(watch, lambda: results.pruned_of(bpy.data.objects["scene"]))
    assert job.folder.request()["options"]["data"] == str(tmp_path / "moved/data")


def test_saving_while_a_job_runs_keeps_it(project, tmp_path, watch, results):
    select_splat()
    set_up(LONG | {"folder": str(project / "jobs")})
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    for path in (project / "work.blend", tmp_path / "elsewhere/work.blend"):
        save(path)
        bpy.context.view_layer.update()
        assert watch.current(bpy.context) == (bpy.data.objects["scene"], job) and job.running
        bpy.ops.wm.open_mainfile(filepath=str(path))
        select_splat()
        bpy.context.view_layer.update()
        assert watch.current(bpy.context) == (bpy.data.objects["scene"], job) and job.running


def test_a_job_without_its_dataset_says_so(lost, watch, project):
    bpy.context.scene.svrgs_prune.data = str(lost)
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    bpy.ops.svrgs.job_stop(now=True)
    follow(watch, lambda: not job.running)
    shutil.move(lost, project / "gone")
    with pytest.raises(RuntimeError, match=re.escape(f"{lost}: the dataset of this job is not there")):
        bpy.ops.svrgs.job_resume()
    bpy.context.scene.svrgs_prune.data = str(project / "gone")
    bpy.ops.svrgs.job_resume()
    assert job.running


def test_a_job_without_its_splat_does_not_take_the_dataset_of_another_one(project, tmp_path, watch):
    select_splat()
    set_up(LONG | {"folder": str(tmp_path / "jobs")})
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    bpy.ops.svrgs.job_stop(now=True)
    follow(watch, lambda: not job.running)
    bpy.ops.wm.read_homefile(use_empty=True)
    shutil.move(project / "data", tmp_path / "gone")
    shutil.copytree(DATA / "tiny", tmp_path / "other")
    bpy.ops.svrgs.import_ply(filepath=str(tmp_path / "other/scene.ply"))
    bpy.ops.svrgs.import_colmap(directory=str(tmp_path / "other"))
    bpy.context.scene.svrgs_prune.data = str(tmp_path / "other")
    with pytest.raises(RuntimeError, match="the dataset of this job is not there"):
        bpy.ops.svrgs.job_resume(folder=str(job.folder.path))
    assert job.folder.request()["options"]["data"] == str(project / "data")

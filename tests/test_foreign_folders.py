"""Folders of strangers: what SECURITY.md says is held, with a test for each sentence, here or elsewhere."""

from __future__ import annotations

import ast
import os
import re
import shutil
from pathlib import Path

import pytest

from job_checks import SHORT, create
from scenes import ball
from svrgs_addon.files.reading import json_object
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.files.streamed_sog import write_levels
from svrgs_addon.jobs.farm.farm_job import FarmJob
from svrgs_addon.jobs.job_folder import JobFolder
from svrgs_addon.jobs.job_process import Job
from svrgs_addon.system.errors import FormatError, SceneError
from svrgs_addon.system.foreign import check_name, inside, open_regular, own

TESTS = Path(__file__).parent
HELD = {  # sentence of SECURITY.md: (file, test)
    "A splat that is a pipe or a device is refused, and not waited for.": (
        "test_commands.py", "test_a_pipe_is_not_waited_for",
    ),
    "Photographs that are pipes or devices are refused.": (
        "test_dataset.py", "test_a_link_to_anything_but_a_file_is_not_opened",
    ),
    "A photograph whose name leads out of its folder, with `..` or from the root, is refused.": (
        "test_dataset_refusals.py", "test_image_names_cannot_leave_the_folder",
    ),
    "A file that is no image is never shown as a photograph.": (
        "test_images.py", "test_files_that_begin_like_no_image_are_not_given_to_a_reader",
    ),
    "A splat of several files that names a file outside its folder, or has a link out of it, is refused.": (
        "test_foreign_folders.py", "test_a_splat_of_several_files_stays_in_its_folder",
    ),
    (
        "Of an older streamed SOG that is replaced, only files are removed that have the names which this"
        " program gives, in folders that are no links."
    ): ("test_streamed_sog.py", "test_an_older_one_names_what_is_not_its_own"),
    "A job whose folder has a link, a pipe or a device in it is refused.": (
        "test_foreign_folders.py", "test_a_job_with_a_pipe_in_its_folder_is_refused",
    ),
    "Discarding a job removes its own files; of a link, only the link.": (
        "test_job_folder.py", "test_discarding_a_job_removes_its_links_and_not_what_they_lead_to",
    ),
    "A farm job writes through no link.": (
        "test_farm.py", "test_nothing_is_written_through_links_of_a_job_folder",
    ),
    "What a job folder says of itself is never waited for.": (
        "test_foreign_folders.py", "test_pipes_of_a_job_folder_are_not_waited_for",
    ),
    "Arrays that hold Python objects are refused.": (
        "test_job_folder.py", "test_hostile_arrays_are_refused",
    ),
    "Options of a job that name files elsewhere are refused.": (
        "test_job_folder.py", "test_a_hostile_request_is_refused",
    ),
}  # fmt: skip
pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")


def test_every_sentence_of_the_policy_has_its_test():
    held = re.search(r"\*\*What is held\*\*.*\n\n((?:- .*\n)+)", (TESTS.parent / "SECURITY.md").read_text())[
        1
    ]
    assert [line.removeprefix("- ") for line in held.splitlines()] == list(HELD)
    for file, test in HELD.values():
        names = [node.name for node in ast.parse((TESTS / file).read_text()).body if hasattr(node, "name")]
        assert test in names, (file, test)


@pytest.mark.parametrize(
    "name", ["../a.png", "a/../../b", "/etc/passwd", "C:\\x", "..\\x", "", "a\0b", "\ud800"]
)
def test_names_that_lead_out_are_refused(name, tmp_path):
    with pytest.raises(FormatError, match="name"):
        check_name(name)
    with pytest.raises(FormatError):
        inside(tmp_path, name)


def test_links_are_read_where_they_stay_and_never_written_through(tmp_path):
    folder = tmp_path / "folder"
    (folder / "real").mkdir(parents=True)
    (folder / "real/a").write_text("a")
    (tmp_path / "mine").write_text("mine")
    (folder / "near").symlink_to(folder / "real")
    (folder / "far").symlink_to(tmp_path)
    assert inside(folder, "near/a").read_text() == "a" and inside(folder, "none") == folder / "none"
    with pytest.raises(FormatError, match="leads out of the folder"):
        inside(folder, "far/mine")
    for names in (("near", "a"), ("far", "mine"), ("far",)):
        with pytest.raises(FormatError, match="is a link"):
            own(folder, *names)
    assert own(folder, "real", "a") == folder / "real/a" and own(folder, "none", "b") == folder / "none/b"


@pipes
def test_only_regular_files_are_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path, tmp_path / "none"):
        with pytest.raises(OSError):
            open_regular(path)
        with pytest.raises(OSError):
            json_object(path, 100)
    (tmp_path / "file").write_text("{}")
    with open_regular(tmp_path / "file") as file:
        assert file.read() == b"{}"


def test_a_splat_of_several_files_stays_in_its_folder(tmp_path):
    town, secret = tmp_path / "town", tmp_path / "secret"
    write_levels(town / "lod-meta.json", [ball(2_000)])
    write_scene(secret / "meta.json", ball(100))
    unit = next(path for path in town.iterdir() if path.is_dir())
    shutil.rmtree(unit)
    unit.symlink_to(secret)
    with pytest.raises(FormatError, match="leads out of the folder"):
        read_scene(town / "lod-meta.json")
    (tmp_path / "means.webp").write_bytes((secret / "means_l.webp").read_bytes())
    (secret / "means_l.webp").unlink()
    (secret / "means_l.webp").symlink_to(tmp_path / "means.webp")
    with pytest.raises(FormatError, match="leads out of the folder"):
        read_scene(secret / "meta.json")


@pipes
def test_a_job_with_a_pipe_in_its_folder_is_refused(tiny, tmp_path):
    folder = create(tmp_path / "job", tiny, **SHORT)
    os.mkfifo(folder / "log.txt")
    with pytest.raises(FormatError, match="log.txt: is a pipe or a device"):
        Job(folder).start()


@pipes
@pytest.mark.parametrize(
    "name", ["job.json", "state.json", "metrics.csv", "log.txt", "kept.npy", "result.json"]
)
def test_pipes_of_a_job_folder_are_not_waited_for(tiny, tmp_path, name):
    """Blender lists jobs that it finds, before anybody starts one."""
    folder = create(tmp_path / "job", tiny, **SHORT)
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    found = Job(JobFolder(folder.path))
    assert found.state and found.kind == ("" if name == "job.json" else "prune") and folder.log_tail() == []
    assert len(folder.metrics()["iteration"]) == 0 and folder.size() > 0 and folder.tasks() == (0, 0)
    with pytest.raises(FormatError):
        folder.arrays()


@pipes
def test_a_pipe_of_a_farm_job_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "job.json")
    with pytest.raises(SceneError, match="job.json: cannot be read"):
        FarmJob.read(tmp_path)

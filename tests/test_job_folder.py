"""The folder of a job, made to do harm: requests, links, counts and arrays of a stranger."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

from job_checks import ROOT, SHORT, create, follow
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.jobs import job_folder as folders
from svrgs_addon.jobs import job_plot
from svrgs_addon.jobs.job_folder import JobFolder
from svrgs_addon.jobs.job_process import Job
from svrgs_addon.prune.options import RECOVERY
from svrgs_addon.system.errors import FormatError, SceneError
from system_checks import with_links

GOOD = {"schema": 1, "kind": "prune", "name": "a", "count": 3, "options": {"data": "somewhere"}}
HOSTILE = [
    b"", b"{", b"[]", b"null", b"[" * 100_000, json.dumps(GOOD | {"schema": 99}).encode(),
    json.dumps(GOOD | {"count": -1}).encode(),
    json.dumps(GOOD | {"count": True}).encode(), json.dumps(GOOD | {"name": 3}).encode(),
    json.dumps(GOOD | {"options": []}).encode(),
    *(json.dumps(GOOD | {"options": {"data": "x", **bad}}).encode() for bad in (
        {"out": "/etc/passwd"}, {"report": "/tmp/x"}, {"lpips_weights": "x"}, {"iterations": "3"},
        {"iterations": 1.5}, {"seed": True},
        {"lambda_f": "nan"}, {"images": "a\nb"}, {"visible_mask": 1},
    )),
    json.dumps(GOOD | {"padding": "x" * folders.LARGEST_JSON}).encode(),
]  # fmt: skip


@pytest.mark.parametrize("content", HOSTILE, ids=range(len(HOSTILE)))
def test_a_hostile_request_is_refused(content, tmp_path):
    (tmp_path / "job.json").write_bytes(content)
    with pytest.raises(FormatError, match="job.json"):
        JobFolder(tmp_path).request()
    with pytest.raises(FormatError, match="job.json"):
        Job(JobFolder(tmp_path)).start()


def test_words_of_a_request_stay_values(tmp_path):
    (tmp_path / "job.json").write_text(
        json.dumps(GOOD | {"options": {"data": "--out=x", "images": "--overwrite", "visible_mask": True}})
    )
    options = JobFolder(tmp_path).options()
    assert (str(options.data), options.images, options.visible_mask) == ("--out=x", "--overwrite", True)
    assert options.out == tmp_path / "recovered.ply"


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ({"iterations": -1}, "whole number of 0 or more"),
        ({"target": 1.5}, "share above 0"),
        ({"lambda_f": -1e-4}, "weight of 0"),
    ],
)
def test_options_out_of_range_are_refused_when_the_job_is_made(tiny, tmp_path, bad, said):
    with pytest.raises(SceneError, match=said):
        create(tmp_path / "job", tiny, **bad)
    assert not (tmp_path / "job").exists()


def test_a_zero_is_not_left_to_the_default(tmp_path):
    asked = dict(
        data="x", iterations=0, recovery=0, holdout=0, min_contribution=0.0, visible_mask=False, images=""
    )
    (tmp_path / "job.json").write_text(json.dumps(GOOD | {"options": asked}))
    options = JobFolder(tmp_path).options()
    assert RECOVERY
    assert options.iterations == options.recovery == options.holdout == options.min_contribution == 0
    assert options.visible_mask is False and options.images == ""


LINKS = (
    "messages.jsonl log.txt metrics.csv pruned.ply state.json stop previews previews/0000001.png"
    " recovered.ply.job"
).split()


@with_links
@pytest.mark.parametrize("name", LINKS)
@pytest.mark.parametrize("dangling", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_job_with_a_link_in_its_folder_is_refused(tiny, tmp_path, name, dangling):
    """A job folder of a stranger must not lead to files elsewhere."""
    folder, victim = create(tmp_path / "job", tiny, **SHORT), tmp_path / "victim"
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(victim)
    if not dangling:
        victim.write_text("mine")
    with pytest.raises(FormatError, match=f"{name}: is a link"):
        Job(folder).start()
    if name in ("state.json", "previews/0000001.png"):  # the process of the job passes the same check
        child = subprocess.run(
            [sys.executable, "-m", "svrgs_addon.jobs.job_main", str(folder.path)],
            cwd=ROOT,
            capture_output=True,
            text=True,
        )
        assert child.returncode == 2 and "is a link" in child.stderr and "Traceback" not in child.stderr
    assert victim.read_text() == "mine" if not dangling else not victim.exists()


@pytest.mark.parametrize("name", LINKS)
def test_discarding_a_job_removes_its_links_and_not_what_they_lead_to(tiny, tmp_path, name):
    folder, victim = create(tmp_path / "job", tiny, **SHORT), tmp_path / "victim"
    (victim / "0000001").mkdir(parents=True)
    (victim / "0000001.png").write_text("mine")
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(victim)
    folder.discard()
    assert not folder.path.exists()
    assert sorted(path.name for path in victim.iterdir()) == ["0000001", "0000001.png"]


def test_discarding_a_job_removes_its_masks_in_folders_of_folders(tiny, tmp_path):
    folder = create(tmp_path / "job", tiny, **SHORT)
    mask = folder / "recovered.ply_distractor_masks/rig1/cam0/0001.jpg.png"
    mask.parent.mkdir(parents=True)
    mask.write_bytes(b"")
    folder.discard()
    assert not folder.path.exists()


@pytest.mark.parametrize("count", [7, 50_000_000, 10**30])
def test_a_job_whose_count_is_not_that_of_its_scene_is_refused(tiny, tmp_path, jobs, count):
    job = Job(create(tmp_path / "job", tiny, **SHORT))
    jobs.append(job)
    job.folder.write_json("job.json", {**job.folder.request(), "count": count})
    job.start()
    follow(job)
    assert job.state == "failed"
    assert f"scene.ply: has 250 Gaussians, but job.json says {count:,}" in job.facts["text"]
    assert not (job.folder / "ranking.npz").exists()


@pytest.mark.parametrize(
    "rows",
    [
        None,
        np.arange(1, 251, dtype=np.uint32),
        np.zeros(250, np.uint32),
        np.linspace(0, 249, 250, dtype=np.float32),
    ],
)
def test_a_job_whose_scene_does_not_name_its_rows_is_refused(tiny, tmp_path, jobs, rows):
    job = Job(create(tmp_path / "job", tiny, **SHORT))
    jobs.append(job)
    scene = read_ply(job.folder / "scene.ply")
    attributes = {name: column for name, column in scene.attributes.items() if name != folders.ROW} | (
        {} if rows is None else {folders.ROW: rows}
    )
    write_ply(job.folder / "scene.ply", replace(scene, attributes=attributes, property_order=()))
    job.start()
    follow(job)
    assert job.state == "failed"
    assert "scene.ply: its column svrgs_row does not name the rows" in job.facts["text"]


def test_hostile_arrays_are_refused(tiny, tmp_path):
    folder = create(tmp_path / "job", tiny)
    for kept in (b"", b"\x93NUMPY", None):
        if kept is None:
            np.save(folder / "kept.npy", np.array([object()], dtype=object), allow_pickle=True)
        else:
            (folder / "kept.npy").write_bytes(kept)
        with pytest.raises(FormatError, match="kept.npy"):
            folder.arrays()
    np.save(folder / "kept.npy", np.ones(3, bool))
    with pytest.raises(FormatError, match="expected bool"):
        folder.arrays()


def test_hostile_states_and_metrics_show_nothing_that_is_not_a_fact(tiny, tmp_path):
    folder = create(tmp_path / "job", tiny)
    folder.write_json(
        "state.json",
        dict(state="running", count="many", psnr="x", total=True, iteration=3, evil=1, text=["a"]),
    )
    assert folder.state() == {"state": "running", "iteration": 3}
    (folder / "metrics.csv").write_bytes(
        b"iteration,count,loss,psnr\n1,2,3,\nnan,1,1,1\n1,2\nx,y,z,w\n1e300,inf,-1,5\n2,9,3,"
    )
    metrics = folder.metrics()
    assert metrics["iteration"].tolist() == [1, 1e300, 2]
    assert job_plot.draw(metrics, 10).shape == (job_plot.SIDE, job_plot.SIDE, 4)
    (folder / "metrics.csv").write_bytes(b"\xff\x00" * 100)
    assert not len(folder.metrics()["iteration"])

"""Pruning without photographs: the splat's own pictures from placed or given cameras take their place."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from job_checks import follow
from scenes import ball
from svrgs_addon.files.images import to_float
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.jobs.estimate import estimate
from svrgs_addon.jobs.job_folder import JobFolder
from svrgs_addon.jobs.job_process import Job
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.job_views import MAX_SIDE_PIXELS, without_photographs
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.pipeline import prune_scene
from svrgs_addon.prune.plans import dataset_of_pruning
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.render.metrics.measures import psnr, with_error
from svrgs_addon.scene.camera import Camera
from svrgs_addon.system.errors import Cancelled, FormatError, SceneError
from svrgs_addon.views.camera_files import load_cameras
from svrgs_addon.views.cameras_json import load_cameras_json, write_cameras_json
from svrgs_addon.views.rig.around import cameras_around

pytestmark = pytest.mark.usefixtures("small_rig")


@pytest.fixture
def splat(tmp_path):
    path = tmp_path / "ball.ply"
    write_ply(path, ball(1_000))
    return path


def dataset_of(options: PruneOptions):
    """The splat's own pictures."""
    return dataset_of_pruning(options, read_ply(options.scene))


def prune(path, **more) -> dict:
    options = dict(target=0.25, recovery=40, out=path.with_name("small.ply"), scene=path, quiet=True) | more
    return prune_scene(PruneOptions(**options))


def test_pictures_are_those_of_the_scene(splat):
    dataset, scene = dataset_of(PruneOptions(scene=splat, background=(0.2, 0.4, 0.6))), read_ply(splat)
    for index in (0, len(dataset.cameras) - 1):
        image = dataset.image(index)
        rgb = Rasterizer().forward(scene, dataset.cameras[index], render_options(scene, (0.2, 0.4, 0.6)))[
            "rgb"
        ]
        assert image.dtype == np.uint8 and np.abs(to_float(image) - rgb.clip(0, 1)).max() < 0.51 / 255
        assert not image.flags.writeable
    assert set(dataset.train_indices) | set(dataset.test_indices) == set(range(len(dataset.cameras)))
    assert len(dataset.test_indices) == dataset.facts["held_out"] == 16


def test_pictures_come_from_several_threads_in_order_and_stay_within_their_memory(splat):
    dataset = dataset_of(PruneOptions(scene=splat, image_memory=0.0))
    order = [3, 1, 3, 0, 2, 1]
    streamed = list(dataset.stream(order))
    assert [index for index, _ in streamed] == order
    assert all((image == dataset.image(index)).all() for index, image in streamed)
    assert not dataset._cache


@pytest.mark.parametrize(
    "method",
    (
        "merge",
        "svr",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("removal", "lightgaussian", "maskgs")),
    ),
)
def test_methods_of_every_kind_prune_on_them(splat, method):
    more = {"target": None} if method == "svr" else {}
    result = prune(splat, method=method, iterations=40, **more)
    assert result["method"] == method and read_ply(splat.with_name("small.ply")).count == result["count"]
    assert result["count"] == 250 or method == "svr"
    assert "psnr" not in result["before"] and result["before"]["count"] == 1_000
    assert result["psnr"] > (20 if method == "merge" else 8)
    assert result["rig"] == {"given": 0} | {
        name: result["rig"][name] for name in ("views", "held_out", "inside_out", "seen", "width", "height")
    }
    assert any("the splat's own pictures take their place" in note for note in result["notes"])


@pytest.mark.slow
def test_to_a_number_merging_is_the_default_and_better_than_a_cut(splat):
    merged, cut = prune(splat), prune(splat, method="opacity")
    assert merged["method"] == "merge" and merged["psnr"] > cut["psnr"] + 1
    assert prune(splat, target=None, iterations=40)["method"] == "removal"


@pytest.mark.slow
def test_more_steps_give_a_better_result(splat):
    assert prune(splat, recovery=150)["psnr"] > prune(splat, recovery=5)["psnr"] + 0.5


@pytest.mark.slow
def test_the_same_job_gives_the_same_bytes_on_any_number_of_threads_and_after_a_stop(splat, default_threads):
    prune(splat, out=splat.with_name("a.ply"))
    prune(splat, out=splat.with_name("b.ply"), threads=1)
    options = PruneOptions(target=0.25, recovery=40, out=splat.with_name("c.ply"), scene=splat, quiet=True)
    asked = iter(range(100))
    with pytest.raises(Cancelled):
        prune_scene(options, lambda job: dataclasses.replace(job, stop=lambda: next(asked) == 17))
    assert not options.out.exists()
    assert prune_scene(dataclasses.replace(options, resume=True))["iterations"] == 40
    first = splat.with_name("a.ply").read_bytes()
    assert splat.with_name("b.ply").read_bytes() == first == options.out.read_bytes()


def test_a_stopped_job_of_another_splat_does_not_go_on(splat):
    """The pictures are part of what must be the same, also those of Gaussians that the cut has removed."""
    dataset = dataset_of(PruneOptions(scene=splat))
    before = list(dataset.inputs())
    dataset.scene.sh[7, 0, 0] += 0.01
    assert list(dataset.inputs()) != before


@pytest.mark.slow
def test_columns_that_merging_loses_are_named(splat):
    scene = ball(1_000)
    write_ply(
        splat,
        dataclasses.replace(scene, attributes={"label": np.arange(1_000, dtype=np.int32)}, property_order=()),
    )
    assert any("these columns of the file were left out: label" in note for note in prune(splat)["notes"])
    assert not any("columns" in note for note in prune(splat, method="opacity")["notes"])


@pytest.mark.slow
def test_a_larger_allowed_drop_keeps_fewer(splat):
    """The drop is that of a splat with 30 dB on its photographs."""
    results = [prune(splat, target=None, max_drop=drop, iterations=60) for drop in (0.2, 2.0)]
    assert 50 <= results[1]["count"] < results[0]["count"] < 1_000
    assert all(result["drop"] is not None and np.isfinite(result["drop"]) for result in results)
    assert with_error(30.0, 1e-3) == pytest.approx(30 - 3.0103, abs=1e-4)
    assert with_error(np.inf, 1e-3) == pytest.approx(30)


def test_a_report_and_levels_are_written(splat):
    result = prune(splat, report=splat.with_name("report"), levels=(0.5,))
    page = splat.with_name("report").joinpath("index.html").read_text()
    assert "photograph:" not in page and f"{result['psnr']:.2f} dB" in page and "∞" not in page
    assert [level["count"] for level in result["levels"]] == [125]


def test_what_is_foreseen(splat):
    found = estimate(PruneOptions(scene=splat, target=0.25, recovery=100))
    assert 0 < found["overdraw_after"] < found["overdraw_before"]
    assert found["kept"] == 250 and found["psnr_before"] is None and found["steps"] == 100
    assert found["seconds"] > 0


def test_the_time_of_the_quick_way_is_foreseen(splat):
    found = estimate(PruneOptions(scene=splat, target=0.25, quick=True))
    assert found["kept"] == 250 and found["steps"] == 60 and found["psnr_before"] is None
    with pytest.raises(SceneError, match="--quick needs --target"):
        estimate(PruneOptions(scene=splat, quick=True))


@pytest.mark.slow
def test_a_job_folder_holds_a_job_without_photographs(splat, tmp_path, jobs):
    """Quick and fine-tuned: the result has merged Gaussians, so there is no ranking of the original's."""
    for name, options in (
        ("quick", {"quick": True}),
        ("tuned", {"recovery": 30, "iterations": 0}),
        ("removal", {"method": "opacity", "recovery": 30}),
    ):
        folder = JobFolder.create(tmp_path / name, read_ply(splat), {"target_count": 250, **options})
        job = Job(folder)
        jobs.append(job)
        job.start()
        follow(job)
        assert job.state == "done", (job.facts, folder.log_tail())
        assert folder.result()["count"] == read_ply(folder / "pruned.ply").count == 250
        assert folder.merged == (name != "removal") and (folder / "kept.npy").exists() == (name == "removal")
        assert not (folder / "recovered.ply").exists() and folder.result()["before"]["count"] == 1_000
        assert "svrgs_row" not in read_ply(folder / "pruned.ply").attributes


def test_a_batch_runs_with_given_cameras(svrgs, splat):
    write_cameras_json(splat.with_name("shot.json"), front(read_ply(splat)))
    done = svrgs(
        f"prune {splat} --cameras {splat.parent}/shot.json --seen-from-only --target 0.4 --recovery 5",
        f"--quiet --batch --out {splat.parent}/small.ply",
    )
    assert done.status == 0 and json.loads(done.out)["rig"] == {"given": 6}


# --- given cameras


def front(scene, count: int = 6, width: int = 96, height: int = 64) -> list[Camera]:
    """Views from one side, z < 0."""
    cameras = [
        camera.resized(width, height)
        for camera in cameras_around(scene, 60, 96)
        if camera.position[2] < -0.7 * np.linalg.norm(camera.position)
    ]
    return [
        dataclasses.replace(camera, name=f"shot_{number:02}.png")
        for number, camera in enumerate(cameras[:count])
    ]


def test_a_shot_that_hardly_moves_is_in_the_same_world_as_placed_views(splat):
    """Its extent, unlike that of a capture, says nothing about the world."""
    scene = read_ply(splat)
    first, second = front(scene, 1)[0], front(scene, 1)[0].viewmat.copy()
    second[0, 3] += 0.01
    write_cameras_json(
        splat.with_name("shot.json"), [first, dataclasses.replace(first, name="b", viewmat=second)]
    )
    found = without_photographs(PruneOptions(scene=splat, cameras=splat.with_name("shot.json")), scene)
    assert found.facts["given"] == 2 and {camera.unit for camera in found.train + found.test} == {1.0}


def test_a_shot_that_sees_the_front_drops_the_back(splat):
    scene = ball(1_000)
    # without gaps
    scene = dataclasses.replace(
        scene, opacity_logits=np.full(1_000, 6, np.float32), log_scales=scene.log_scales + np.float32(1)
    )
    write_ply(splat, scene)
    write_cameras_json(splat.with_name("shot.json"), front(scene))
    options = {"cameras": splat.with_name("shot.json"), "target": 0.4}
    only = prune(splat, **options, seen_from_only=True, out=splat.with_name("o.ply"))
    both = prune(splat, **options, out=splat.with_name("b.ply"))
    behind = lambda name: int((read_ply(splat.with_name(name)).means[:, 2] > 2.0).sum())
    assert behind("o.ply") == 0 < 20 < behind("b.ply")
    assert only["rig"] == {"given": 6} and both["rig"]["given"] == 6 and both["rig"]["views"] >= 8
    assert any("what they do not see may be removed" in note for note in only["notes"])
    assert (
        len(
            dataset_of(
                PruneOptions(scene=splat, cameras=options["cameras"], holdout=3, seen_from_only=True)
            ).test_indices
        )
        == 2
    )


def test_large_views_are_reduced(splat):
    write_cameras_json(splat.with_name("shot.json"), front(read_ply(splat), 1, 3840, 2160))
    dataset = dataset_of(PruneOptions(scene=splat, cameras=splat.with_name("shot.json"), seen_from_only=True))
    assert (dataset.cameras[0].width, dataset.cameras[0].height) == (MAX_SIDE_PIXELS, 900)
    assert dataset.train_indices == [0]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"seen_from_only": True}, "name them with --seen-from"),
        ({"images": "images_4"}, "--images is of the photographs of a dataset"),
        ({"cameras": "missing.json"}, "missing.json: cannot be read"),
        ({"cameras": "away.json", "seen_from_only": True}, "none of its Gaussians is near a camera"),
        ({"cameras": "away.json", "data": "data"}, "leave them out, or --data"),
    ],
)
def test_what_cannot_be_is_one_sentence(splat, more, words):
    camera = dataclasses.replace(front(read_ply(splat), 1)[0])
    away = camera.viewmat.copy()
    away[2, 3] -= 1e4
    write_cameras_json(splat.with_name("away.json"), [dataclasses.replace(camera, viewmat=away)])
    more = {
        name: splat.with_name(value) if name in ("cameras", "data") else value for name, value in more.items()
    }
    with pytest.raises((SceneError, FormatError), match=words):
        prune(splat, **more)
    assert not splat.with_name("small.ply").exists()


def test_a_scene_without_anything_visible_is_refused(splat):
    write_ply(splat, dataclasses.replace(ball(50), opacity_logits=np.full(50, -20, np.float32)))
    with pytest.raises(SceneError, match="opacity below 1/255"):
        prune(splat)


# --- files of cameras


def test_cameras_are_read_as_they_were_written(splat, tmp_path):
    cameras = front(read_ply(splat))
    write_cameras_json(tmp_path / "c.json", cameras)
    for read in (load_cameras, load_cameras_json):
        for a, b in zip(cameras, read(tmp_path / "c.json"), strict=True):
            assert a.name == b.name and (a.width, a.height) == (b.width, b.height)
            assert np.allclose(a.viewmat, b.viewmat, atol=1e-12) and np.allclose(a.K, b.K, atol=1e-9)


def test_a_transforms_json_gives_the_same_pictures(splat, tmp_path):
    cameras, frames = front(read_ply(splat)), []
    for camera in cameras:
        to_world = np.linalg.inv(camera.viewmat) @ np.diag([1.0, -1.0, -1.0, 1.0])
        frames.append({"file_path": camera.name, "transform_matrix": to_world.tolist()})
    facts = {"fl_x": cameras[0].K[0, 0], "fl_y": cameras[0].K[1, 1], "w": 96, "h": 64, "frames": frames}
    (tmp_path / "path.json").write_text(json.dumps(facts))
    found = load_cameras(tmp_path / "path.json")
    scene, rasterizer = read_ply(splat), Rasterizer()
    for a, b in zip(cameras, found, strict=True):
        assert psnr(*(rasterizer.forward(scene, camera)["rgb"].clip(0, 1) for camera in (a, b))) > 80


# --- svrgs rig


def test_the_command_writes_cameras_and_a_picture(svrgs, splat):
    rig, picture = splat.with_name("rig.json"), splat.with_name("rig.png")
    result = svrgs(f"rig {splat} --views 8 --out {rig} --preview {picture} --json").json
    assert result["views"] == 8 and 0 < result["seen"] <= 1
    assert len(load_cameras_json(rig)) == 8 + result["held_out"] and picture.stat().st_size > 10_000
    pictures = splat.with_name("pictures")
    rendered = svrgs(f"render {splat} --cameras {rig} --views rig_000 --out {pictures} --json").json
    assert len(rendered["files"]) == 1
    failed = svrgs("rig", splat, "--out", splat)
    assert failed.status and "is the input itself" in failed.err

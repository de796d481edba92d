"""Choices that contradict each other, are not followed, or lose something: a sentence says so, or they are
refused."""

from __future__ import annotations

import json
import logging
import shutil

import numpy as np
import pytest

from scenes import random_scene
from svrgs_addon.cli.batch_list import expand
from svrgs_addon.cli.main import main
from svrgs_addon.files.registry import format_to_write, left_out, read_scene, write_scene
from svrgs_addon.prune.file_size import asked_size
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.pipeline import prune_scene
from svrgs_addon.prune.plans import plan_of_pruning
from svrgs_addon.scene.affine import transformed
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.views.colmap import read_model
from svrgs_addon.views.dataset import load_dataset
from test_nothing_is_lost import refused
from transforms_dataset import write_transforms


def options(tiny, out, **more) -> PruneOptions:
    given = {"scene": tiny.splat, "data": tiny.folder, "out": out, "target": 0.5, "quiet": True}
    return PruneOptions(**given | {"iterations": 4, "recovery": 20} | more)


def test_what_was_fitted_for_another_splat_stays(tiny, tmp_path):
    splat = shutil.copy(tiny.splat, tmp_path / "s.ply")
    prune_scene(options(tiny, tmp_path / "s.spz", exposure="on", refine_poses="on"))
    fitted = sorted(path for path in tmp_path.iterdir() if path.suffix == ".json")
    assert [path.name for path in fitted] == ["s.spz_exposure.json", "s.spz_refined_cameras.json"]
    prune_scene(options(tiny, tmp_path / "s.sog", scene=splat, exposure="off", refine_poses="off"))
    assert all(path.exists() for path in fitted)
    prune_scene(options(tiny, tmp_path / "s.spz", scene=splat, exposure="off", refine_poses="off"))
    assert not any(path.exists() for path in fitted), "of an earlier result of this name"


def test_splats_in_folders_beside_a_splat_are_named(tiny, tmp_path, caplog):
    for name in ("A/scene.ply", "B/scene.ply", "stray.ply"):
        (tmp_path / "st" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(tiny.splat, tmp_path / "st" / name)
    with caplog.at_level(logging.WARNING):
        assert [item.scene.name for item in expand([tmp_path / "st"], None, tmp_path / "out")] == [
            "stray.ply"
        ]
    assert "hold splats, too: A, B" in caplog.text


def test_a_share_is_one_of_the_gaussians_that_can_be_used(tiny, tmp_path):
    scene = read_scene(tiny.splat)
    means = scene.means.copy()
    means[: scene.count // 2] = np.nan
    arrays = (scene.log_scales, scene.quats, scene.opacity_logits, scene.sh)
    write_scene(tmp_path / "a.ply", Scene(means, *arrays))
    plan = plan_of_pruning(options(tiny, tmp_path / "b.ply", scene=tmp_path / "a.ply"))
    assert plan.target == round(0.5 * (scene.count - scene.count // 2))


def test_reports_and_comparisons_replace_their_own_pages_alone(tiny, tmp_path, capsys):
    folder = tmp_path / "page"
    folder.mkdir()
    (folder / "index.html").write_text("<html>mine</html>")
    words = ("--data", tiny.folder, "--out", tmp_path / "a.ply", "--target", 0.5, "--report", folder)
    assert "holds another page" in refused(capsys, "compare", tiny.splat, tiny.splat, "--out", folder)
    assert "holds another page" in refused(capsys, "prune", tiny.splat, *words)
    assert (folder / "index.html").read_text() == "<html>mine</html>" and not (tmp_path / "a.ply").exists()


def test_placed_cameras_replace_no_others(tiny, tmp_path, small_rig, capsys):
    mine = tmp_path / "transforms.json"
    shutil.copy(tiny.folder / "sparse/0/cameras.bin", mine)
    assert "holds no cameras that svrgs rig has placed" in refused(capsys, "rig", tiny.splat, "--out", mine)
    same = tmp_path / "a.png"
    assert "two names" in refused(capsys, "rig", tiny.splat, "--out", same, "--preview", same)
    (tmp_path / "cameras.json").touch()  # as mktemp makes one
    for _ in range(2):
        assert main(["rig", str(tiny.splat), "--out", str(tmp_path / "cameras.json")]) == 0


@pytest.mark.parametrize("suffix", (".ply", ".compressed.ply", ".spz", ".sog", ".glb", ".splat", ".usdc"))
def test_positions_that_float32_rounds_are_said_in_every_format(suffix):
    far, kind = np.eye(4), format_to_write(f"a{suffix}")
    assert not [text for text in left_out(random_scene(500), kind) if "positions" in text]
    far[:3, 3] = 500_000, 4_000_000, 0
    (said,) = [text for text in left_out(transformed(random_scene(500), far), kind) if "positions" in text]
    assert "steps" in said


def test_colours_that_a_splat_file_clips_are_said():
    scene = random_scene(500)
    bright = Scene(scene.means, scene.log_scales, scene.quats, scene.opacity_logits, scene.sh + np.float32(3))
    texts = left_out(bright, format_to_write("a.splat"))
    assert any("beyond the limits of a .splat" in text for text in texts)


def test_a_folder_is_converted_with_its_splats_of_several_files(tiny, tmp_path, svrgs):
    svrgs("convert", tiny.splat, tmp_path / "in/one/meta.json")
    shutil.copy(tiny.splat, tmp_path / "in/two.ply")
    assert svrgs("convert", tmp_path / "in", tmp_path / "out", "--to", ".spz").status == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"one.spz", "two.spz"}


def test_a_training_does_not_begin_with_more_points_than_it_may_grow_to(tiny, tmp_path, capsys):
    words = ("--densify", "mcmc", "--cap", 50, "--iterations", 10, "--out", tmp_path / "a.ply")
    assert "may grow up to 50 Gaussians" in refused(capsys, "train", "--data", tiny.folder, *words)


def test_a_split_of_transforms_json_that_does_not_count_is_said(tiny, tmp_path):
    facts = write_transforms(tmp_path, read_model(tiny.folder / "sparse/0"))
    assert not any("do not count" in note for note in load_dataset(tmp_path, cameras_only=True).notes)
    facts["test_filenames"] = [facts["frames"][1]["file_path"]]
    (tmp_path / "transforms.json").write_text(json.dumps(facts))
    notes = load_dataset(tmp_path, cameras_only=True).notes
    assert "transforms.json has test_filenames, which do not count: --holdout says what is held out" in notes


def test_a_format_is_named_with_or_without_its_dot(tiny, tmp_path):
    sizes = [
        asked_size(options(tiny, tmp_path / "a.ply", target=None, target_size=0.003, target_format=name))
        for name in ("spz", ".spz")
    ]
    assert sizes[0] == sizes[1]


def test_a_farm_job_whose_tasks_would_all_be_refused_is_refused(tiny, tmp_path, capsys):
    words = ("farm", "export", tiny.splat, "--out", tmp_path / "job", "--seen-from-only")
    assert "holds some: leave them out" in refused(capsys, *words)
    assert not (tmp_path / "job" / "job.json").exists()


def test_views_of_all_photographs_are_called_training_views(tiny, tmp_path, svrgs):
    result = prune_scene(options(tiny, tmp_path / "a.ply", holdout=0))
    assert any("measured in the training views" in note for note in result["notes"])
    other = prune_scene(options(tiny, tmp_path / "b.ply"))
    assert not any("training views" in note for note in other["notes"])
    svrgs("compare", tiny.splat, tiny.splat, "--data", tiny.folder, "--holdout", 0, "--out", tmp_path / "c")
    assert "measured in the training views" in (tmp_path / "c/index.html").read_text()


def test_a_page_of_the_viewer_and_a_report_replace_each_other_nowhere(tiny, tmp_path, capsys):
    folder = tmp_path / "page"
    words = list(map(str, ("compare", tiny.splat, tiny.splat, "--data", tiny.folder, "--out", folder)))
    assert main(words) == 0
    shutil.copy(tiny.splat, folder / "pruned.spz")
    assert "holds another page" in refused(capsys, "view", tiny.splat, "--export", folder)
    assert (folder / "pruned.spz").exists()
    assert main(words) == 0
    (folder / "index.html").write_text('<head><meta name="generator" content="SVR-GS"></head>')
    assert "holds another page" in refused(capsys, "compare", tiny.splat, tiny.splat, "--out", folder)
    (folder / "index.html").unlink()
    (folder / "index.html").mkdir()
    assert "is a folder" in refused(capsys, "compare", tiny.splat, tiny.splat, "--out", folder)


def test_one_far_floater_says_nothing_of_positions():
    scene = random_scene(500)
    means = scene.means.copy()
    means[0] = 1e5, 0, 0
    far = Scene(means, scene.log_scales, scene.quats, scene.opacity_logits, scene.sh)
    assert not [text for text in left_out(far, format_to_write("a.ply")) if "positions" in text]


def test_hidden_folders_and_point_clouds_of_colmap_are_no_splats_beside(tiny, tmp_path, svrgs, caplog):
    svrgs("convert", tiny.splat, tmp_path / "in/.old/meta.json")
    for name in ("a.ply", "dense/fused.ply"):
        (tmp_path / "in" / name).parent.mkdir(exist_ok=True)
        shutil.copy(tiny.splat, tmp_path / "in" / name)
    with caplog.at_level(logging.WARNING):
        assert len(expand([tmp_path / "in"], None, tmp_path / "out")) == 1
    assert "hold splats" not in caplog.text
    assert svrgs("convert", tmp_path / "in", tmp_path / "out", "--to", ".spz").status == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"a.spz"}

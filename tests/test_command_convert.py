"""`svrgs convert`: one file, several, folders and patterns; crop, scale, rotation, move, degree; refusals."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from svrgs_addon.cli import convert_scenes
from svrgs_addon.cli.main import main
from svrgs_addon.files import memory_mapped, registry
from svrgs_addon.files.registry import describe, read_scene, write_scene
from svrgs_addon.files.streamed_sog import read_level
from svrgs_addon.prune.seen import seen_from
from svrgs_addon.scene.morton_order import morton_order
from svrgs_addon.views.dataset import HOLDOUT
from system_checks import with_links
from test_formats import differences, like_trained
from tiny_dataset import views as cameras_of
from tiny_dataset import write_tiny


@pytest.fixture
def splat(tmp_path):
    path = tmp_path / "a.ply"
    write_scene(path, like_trained(2))
    return path


def convert(capsys, *words) -> list[dict]:
    """The JSON lines."""
    assert main(["convert", *map(str, words), "--json"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize("out", ["b.spz", "b.compressed.ply", "b.splat", "new/b.ply"])
def test_one_file(splat, tmp_path, capsys, out):
    (line,) = convert(capsys, splat, tmp_path / out)
    found = describe(tmp_path / out)
    assert line == {
        "scene": str(splat), "out": str(tmp_path / out), "count": 700, "sh_degree": found["sh_degree"],
        "bytes_before": splat.stat().st_size, "bytes": found["bytes"],
    }  # fmt: skip
    assert found["sh_degree"] == (0 if out.endswith(".splat") else 2)


def test_a_plain_copy_keeps_every_value(splat, tmp_path, capsys):
    convert(capsys, splat, tmp_path / "b.ply")
    assert max(differences(read_scene(splat), read_scene(tmp_path / "b.ply")).values()) == 0


def test_folders_patterns_and_files_become_files_of_a_folder(splat, tmp_path, capsys):
    write_scene(tmp_path / "more" / "b.compressed.ply", like_trained(0))
    write_scene(tmp_path / "more" / "c.splat", like_trained(0))
    lines = convert(capsys, tmp_path / "more", str(tmp_path / "*.ply"), tmp_path / "out", "--to", "spz")
    assert [line["out"] for line in lines] == [
        str(tmp_path / "out" / name) for name in ("b.spz", "c.spz", "a.spz")
    ]
    assert all(
        "skipped" in line
        for line in convert(capsys, tmp_path / "more", splat, tmp_path / "out", "--to", "spz")
    )
    assert all(
        "bytes" in line
        for line in convert(capsys, tmp_path / "more", splat, tmp_path / "out", "--to", "spz", "--overwrite")
    )


def test_a_damaged_file_among_several_is_said_and_the_others_are_converted(splat, tmp_path, capsys):
    (tmp_path / "b.spz").write_bytes(b"NGSP broken")
    assert main(f"convert {splat} {tmp_path}/b.spz {tmp_path}/out --to .splat --json".split()) == 1
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert "bytes" in lines[0] and "b.spz" in lines[1]["error"]
    assert not (tmp_path / "out" / "b.splat").exists()


def test_crop_scale_rotation_and_move_come_in_this_order(splat, tmp_path, capsys):
    scene = read_scene(splat)
    (line,) = convert(
        capsys, splat, tmp_path / "b.ply", "--box", "-1,-1,-1,1,1,1", "--scale", "2", "--rotate", "90,0,90",
        "--move", "0,0,5", "--sh-degree", "1"
    )  # fmt: skip
    inside = (np.abs(scene.means) <= 1).all(axis=1)
    x, y, z = 2 * scene.means[inside].T
    x, y, z = x, -z, y  # a quarter turn around x takes y to z
    x, y, z = -y, x, z  # around z, x to y
    found = read_scene(tmp_path / "b.ply")
    assert line["count"] == inside.sum() and line["sh_degree"] == found.sh_degree == 1
    assert found.means == pytest.approx(np.column_stack([x, y, z + 5]), abs=1e-5)
    assert found.log_scales == pytest.approx(scene.log_scales[inside] + np.log(2), abs=1e-5)


def test_with_a_dataset_it_is_rounded_by_the_views_also_where_it_is_moved(
    tiny, tmp_path, capsys, monkeypatch
):
    scene = read_scene(tiny.splat)
    seen = seen_from(
        scene, [camera for i, camera in enumerate(tiny.cameras) if i % HOLDOUT], tmp_path / "a.spz"
    )
    write_scene(tmp_path / "a.spz", scene, seen=seen)
    convert(capsys, tiny.splat, tmp_path / "b.spz", "--data", tiny.folder)
    assert (tmp_path / "b.spz").read_bytes() == (tmp_path / "a.spz").read_bytes()
    convert(capsys, tiny.splat, tmp_path / "c.spz")
    assert (tmp_path / "c.spz").read_bytes() != (tmp_path / "a.spz").read_bytes()
    given = []
    monkeypatch.setattr(
        registry, "write_scene", lambda path, scene, version, quantise, seen: given.append(seen)
    )
    moves = "--scale", "2", "--rotate", "0,90,0", "--move", "0,0,5"
    main(["convert", str(tiny.splat), str(tmp_path / "d.spz"), "--data", str(tiny.folder), *moves])
    (moved,) = given
    x, y, z = 2 * seen.positions.T
    assert moved.positions == pytest.approx(np.column_stack([z, y, -x + 5]), abs=1e-5)
    assert moved.weights == pytest.approx(seen.weights, rel=2e-3, abs=1e-3)


@pytest.mark.parametrize(
    "out, views, said", [("b.ply", 24, "an SPZ or a SOG is rounded"), ("b.spz", 4, "3 training views")]
)
def test_a_dataset_that_is_of_no_use_is_said(tmp_path, capsys, out, views, said):
    tiny = write_tiny(tmp_path / "tiny", cameras=cameras_of(views))
    assert main(["convert", str(tiny.splat), str(tmp_path / out), "--data", str(tiny.folder)]) == 2
    assert said in capsys.readouterr().err and not (tmp_path / out).exists()


@with_links
def test_two_inputs_whose_outputs_are_one_file_by_a_link_are_refused(splat, tmp_path, capsys):
    (tmp_path / "out").mkdir()
    write_scene(tmp_path / "b.ply", like_trained(0))
    (tmp_path / "out/b.spz").symlink_to(tmp_path / "out/a.spz")
    words = [str(splat), str(tmp_path / "b.ply"), str(tmp_path / "out"), "--to", ".spz"]
    assert main(["convert", *words]) == 2
    assert "would be the output of two inputs" in capsys.readouterr().err


def test_views_that_do_not_see_the_splat_do_not_decide_how_it_is_stored(tiny, tmp_path, capsys):
    """They would store it worse than without views."""
    scene = read_scene(tiny.splat)
    means = scene.means + np.where(np.arange(scene.count)[:, None] % 3 > 0, [0, -90, 0], 0).astype(np.float32)
    write_scene(tmp_path / "a.ply", dataclasses.replace(scene, means=means))
    words = [str(tmp_path / "a.ply"), str(tmp_path / "a.spz"), "--data", str(tiny.folder)]
    assert main(["convert", *words]) == 2
    assert "views see 3" in (said := capsys.readouterr().err) and "or leave --data out" in said
    assert not (tmp_path / "a.spz").exists()
    (line,) = convert(capsys, tiny.splat, tmp_path / "b.spz", "--data", tiny.folder)
    assert line["seen"] > 0.9 and line["seen_views"] == 10
    main(["convert", str(tiny.splat), str(tmp_path / "c.spz"), "--data", str(tiny.folder)])
    assert "10 views see" in capsys.readouterr().out


def test_options_of_spherical_harmonics_without_any_are_said(tiny, tmp_path, capsys, caplog):
    write_scene(tmp_path / "a.ply", like_trained(0))
    convert(capsys, tmp_path / "a.ply", tmp_path / "a.spz", "--quantise", "4")
    convert(capsys, tmp_path / "a.ply", tmp_path / "b.spz", "--data", tiny.folder)
    assert "--quantise changes nothing" in caplog.text and "--data changes nothing" in caplog.text


@pytest.mark.parametrize("version", (2, 3, 4))
def test_the_version_of_an_spz_can_be_chosen(splat, tmp_path, capsys, version):
    convert(capsys, splat, tmp_path / "b.spz", "--spz-version", version)
    assert (tmp_path / "b.spz").read_bytes()[:4] == (b"NGSP" if version == 4 else b"\x1f\x8b\x08\x00")


@pytest.mark.parametrize(
    "words, said",
    [
        (("a.ply", "a.ply"), "never overwritten"),
        (("a.ply", "b"), "--to"),
        (("a.ply", "b.ksplat"), "--to"),
        (("a.ply", "out", "--to", "ksplat"), "written as"),
        (("a.ply", "c.ply", "b.spz"), "name of a file"),
        (("a.ply", "more/a.ply", "out", "--to", "spz"), "two inputs"),
        (("a.ply", "b.ply", "--box", "50,50,50,60,60,60"), "no Gaussian is inside"),
        (("a.ply", "b.splat", "--spz-version", "3"), "no version 3"),
        (("x.ply", "b.spz"), "no such file"),
        (("*.spz", "b.ply"), "holds no splat"),
    ],
)
def test_what_cannot_be_is_one_sentence(splat, tmp_path, capsys, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "more" / "a.ply", like_trained(0, 5))
    assert main(["convert", *words]) == 2
    assert said in capsys.readouterr().err and not (tmp_path / "b.ply").exists()
    assert not (tmp_path / "b.splat").exists()


@pytest.mark.parametrize("suffix", (".ply", ".compressed.ply", ".spz", ".glb", ".splat", ".sog"))
def test_a_large_scene_is_converted_by_way_of_the_disk_to_the_same_file(tmp_path, monkeypatch, suffix):
    scene = like_trained(2, 70_000 if suffix == ".spz" else 9_000)
    scene.means[17] = np.nan
    scene = dataclasses.replace(scene, attributes={"label": np.arange(scene.count, dtype=np.int32)})
    write_scene(tmp_path / "a.ply", scene)
    words = [str(tmp_path / "a.ply"), "--sh-degree", "1", "--rotate", "0,30,0", "--box", "-1,-1,-1,1,1,1"]
    assert main(["convert", *words, str(tmp_path / f"b{suffix}")]) == 0
    monkeypatch.setattr(convert_scenes, "LARGE", 0)
    monkeypatch.setattr(memory_mapped, "LARGE", 0)
    assert main(["convert", *words, str(tmp_path / f"c{suffix}")]) == 0
    one, other = (read_scene(tmp_path / f"{name}{suffix}") for name in "bc")
    assert (tmp_path / f"b{suffix}").read_bytes() == (tmp_path / f"c{suffix}").read_bytes()
    assert one.count == other.count > 1000
    assert ("label" in one.attributes) == (suffix == ".ply")
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(["a.ply", f"b{suffix}", f"c{suffix}"])


def test_a_full_disk_beside_the_output_is_told(tmp_path, capsys, monkeypatch):
    write_scene(tmp_path / "a.ply", like_trained(0, 500))
    monkeypatch.setattr(convert_scenes, "LARGE", 0)

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(memory_mapped.tempfile, "TemporaryFile", full)
    assert main(["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.spz")]) == 2
    assert "b.spz: needs more space in its folder" in capsys.readouterr().err
    assert not (tmp_path / "b.spz").exists()


def test_levels_of_detail_in_files_become_one_streamed_sog(tmp_path, capsys):
    scene = like_trained(1, 900)
    for name, share in (("b_25", 4), ("b", 1), ("b_50", 2)):
        write_scene(tmp_path / f"{name}.ply", scene.select(np.arange(0, 900, share)))
    (line,) = convert(capsys, tmp_path / "b*.ply", tmp_path / "b.ply", tmp_path / "town" / "lod-meta.json")
    assert line["count"] == 900 and line["levels"] == [900, 900, 450, 225]
    assert [
        sum(part.count for part in read_level(tmp_path / "town" / "lod-meta.json", level))
        for level in range(4)
    ] == line["levels"]


@pytest.mark.parametrize("command", (["convert"], ["prune", "--quick", "--target", "0.5", "--out"]))
@pytest.mark.parametrize(
    ("kind", "scene", "out"),
    [
        ("lod-meta.json", "town", "town/lod-meta.json"),
        ("lod-meta.json", "town/lod-meta.json", "town/lod-meta.json"),
        ("lod-meta.json", "town/0_0", "town/lod-meta.json"),
        ("lod-meta.json", "town/0_0/meta.json", "town/lod-meta.json"),
        ("meta.json", "town", "town/meta.json"),
    ],
)
def test_a_splat_of_several_files_is_not_replaced_by_itself(
    tmp_path, capsys, monkeypatch, command, kind, scene, out
):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "town" / kind, like_trained(1, 300))
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    assert main([command[0], scene, *command[1:], out]) == 2
    assert "is the input itself" in capsys.readouterr().err
    assert before == {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}


@pytest.mark.parametrize(
    ("out", "factors"),
    [
        ("b.spz", (0.3, 1, 8)),
        ("b.sog", (0.1, 100)),
        pytest.param("meta.json", (0.1, 100), marks=pytest.mark.slow),
        pytest.param("lod-meta.json", (0.1, 100), marks=pytest.mark.slow),
    ],
)
def test_coarser_spherical_harmonics_make_smaller_files_that_are_less_exact(tmp_path, capsys, out, factors):
    scene, lines, errors = like_trained(2, 8_000), [], []
    scene = scene.select(morton_order(scene.means))
    write_scene(tmp_path / "a.ply", scene)
    for factor in factors:
        path = tmp_path / str(factor) / out
        lines += convert(capsys, tmp_path / "a.ply", path, "--quantise", factor)
        errors.append(np.square(scene.sh[:, 1:] - read_scene(path).sh[:, 1:]).mean())
    sizes = [line["bytes"] for line in lines]
    assert sizes == sorted(sizes, reverse=True) and sizes[0] > 1.1 * sizes[-1]
    assert errors == sorted(errors) and errors[-1] > 1.2 * errors[0]


@pytest.mark.parametrize("out", ["b.ply", "b.compressed.ply", "b.splat"])
def test_formats_without_a_choice_of_steps_take_no_quantise(splat, tmp_path, capsys, out):
    assert main(["convert", str(splat), str(tmp_path / out), "--quantise", "2"]) == 2
    assert "leave --quantise out" in capsys.readouterr().err and not (tmp_path / out).exists()

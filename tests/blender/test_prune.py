"""The same job from Blender as from a shell: same scene, same figures, same JSON."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from extension import DATA, PACKAGE, part

SHORT = {"iterations": 10, "recovery": 5, "target": 0.5, "seed": 3}
FIGURES = ("count", "psnr", "ssim", "flip", "lpips", "bytes", "method", "lambda_f")


def json_lines(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines() if line.startswith("{")]


@pytest.fixture(scope="module")
def from_a_shell(tmp_path_factory) -> tuple[dict, bytes]:
    return by_a_shell(tmp_path_factory.mktemp("shell") / "pruned.ply")


def by_a_shell(out: Path) -> tuple[dict, bytes]:
    child = part("svrgs_addon.system.subprocess_python")
    words = [f"--{name}={value}" for name, value in SHORT.items()]
    job = f"prune {DATA}/tiny/scene.ply --data {DATA}/tiny --out {out} --json --quiet"
    command = [sys.executable, "-m", "svrgs_addon", *job.split(), *words]
    done = subprocess.run(command, env=child.environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), out.read_bytes()


def test_pruning_the_active_splat_is_the_job_of_the_command_line(from_a_shell, bridge, ply, tmp_path, capfd):
    expected, content = from_a_shell
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    source = bpy.context.object
    bpy.ops.svrgs.prune(
        data=str(DATA / "tiny"),
        out=str(tmp_path / "out.ply"),
        report_folder=str(tmp_path / "report"),
        **SHORT,
    )
    said = capfd.readouterr().out
    (result,) = json_lines(said)
    assert result.keys() == expected.keys()
    assert [result[name] for name in FIGURES] == [expected[name] for name in FIGURES]
    assert (tmp_path / "out.ply").read_bytes() == content and (tmp_path / "report/index.html").exists()
    assert "Kept 125 of 250 Gaussians" in said
    pruned = bpy.context.object
    assert bridge.count(source) == 250 and bridge.count(pruned) == 125 and pruned.name == "scene pruned"
    ply.write_ply(tmp_path / "object.ply", bridge.scene_from_object(pruned))
    assert (tmp_path / "object.ply").read_bytes() == content
    assert pruned.matrix_world == source.matrix_world
    assert part("operators.jobs.job_result").pair_of(pruned) == (source, pruned) and source.hide_render
    assert not pruned.hide_render


def test_photographs_imported_beside_the_splat_need_not_be_named(from_a_shell, bridge, tmp_path):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.object.parent.location = (1, 2, 3)
    source = bpy.context.object
    bpy.ops.svrgs.prune(out=str(tmp_path / "out.ply"), **SHORT)
    pruned = bpy.context.object
    bpy.context.view_layer.update()
    assert bridge.count(pruned) == from_a_shell[0]["count"] and pruned.parent == source.parent
    assert pruned.matrix_world == source.matrix_world


def test_pruning_a_file_needs_no_object(from_a_shell, bridge, tmp_path):
    bpy.ops.svrgs.prune(
        scene=str(DATA / "tiny/scene.ply"), data=str(DATA / "tiny"), out=str(tmp_path / "out.ply"), **SHORT
    )
    assert bridge.count(bpy.context.object) == from_a_shell[0]["count"]


def test_masks_of_the_photographs_count(tmp_path, capfd):
    images = part("svrgs_addon.files.images")
    (tmp_path / "masks").mkdir()
    for photo in (DATA / "tiny/images").iterdir():
        height, width = images.read_image(photo).shape[:2]
        white = np.full((height, width), 255, np.uint8)
        white[:, : width // 4] = 0
        images.write_image(tmp_path / "masks" / f"{photo.name}.png", white)
    given = {"scene": str(DATA / "tiny/scene.ply"), "data": str(DATA / "tiny"), **SHORT}
    for inverted, share in ((False, "25.0%"), (True, "75.0%")):
        out = str(tmp_path / f"{inverted}.ply")
        bpy.ops.svrgs.prune(masks=str(tmp_path / "masks"), invert_masks=inverted, out=out, **given)
        (result,) = json_lines(capfd.readouterr().out)
        assert (
            f"12 of 12 photographs have a mask; {share} of their pixels count nowhere" in result["notes"][0]
        )


# --- the file of the result


@pytest.fixture
def saved(tmp_path):
    """Folder of a saved .blend with the splat "tiny.001", its dataset in data/ beside it. Afterwards the
    .blend is unsaved again."""
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    bpy.context.object.name = "tiny.001"
    shutil.copytree(DATA / "tiny", tmp_path / "data")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    yield tmp_path
    bpy.ops.wm.read_homefile(use_empty=True)


@pytest.fixture
def unsaved():
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))


@pytest.mark.filterwarnings("error")  # Blender warns of a property that is not made for paths with //
def test_in_background_the_result_lies_beside_the_blend(saved, tmp_path, capfd):
    bpy.ops.svrgs.prune(data="//data", report_folder="//report", **SHORT)
    (result,) = json_lines(capfd.readouterr().out)
    assert result["out"] == str(saved / "tiny_001_pruned.spz")
    assert result["scene"] == str(saved / "work.blend")
    assert Path(result["out"]).read_bytes() == by_a_shell(tmp_path / "shell.spz")[1]
    assert (saved / "report/index.html").exists()


def test_in_background_the_result_of_a_file_lies_beside_it(unsaved, tmp_path, capfd):
    scene = shutil.copy(DATA / "tiny/scene.ply", tmp_path / "a.ply")
    bpy.ops.svrgs.prune(scene=str(scene), data=str(DATA / "tiny"), **SHORT)
    (result,) = json_lines(capfd.readouterr().out)
    assert (result["scene"], result["out"]) == (str(scene), str(tmp_path / "a_pruned.spz"))
    assert (tmp_path / "a_pruned.spz").read_bytes() == by_a_shell(tmp_path / "shell.spz")[1]


def test_an_existing_file_is_only_replaced_when_told(saved):
    for name, more in (("tiny_001_pruned.spz", {}), ("mine.ply", {"out": "//mine.ply"})):
        (saved / name).write_text("a day's work")
        with pytest.raises(
            RuntimeError,
            match=f"{name}: exists; name another output with out=, or replace it with overwrite=True",
        ):
            bpy.ops.svrgs.prune(data="//data", **SHORT, **more)
        assert (saved / name).read_text() == "a day's work" and len(bpy.data.objects) == 1
    bpy.ops.svrgs.prune(data="//data", overwrite=True, out="//mine.ply", **SHORT)
    assert (saved / "mine.ply").read_bytes()[:3] == b"ply"


@pytest.mark.skipif(sys.platform == "win32", reason="only some users of Windows make links")
def test_a_link_is_only_written_through_when_it_is_named(saved):
    (saved / "tiny_001_pruned.spz").symlink_to(saved / "elsewhere.spz")
    with pytest.raises(
        RuntimeError, match=r"tiny_001_pruned.spz: is a link to .*elsewhere.spz; name the output with out="
    ):
        bpy.ops.svrgs.prune(data="//data", overwrite=True, **SHORT)
    assert not (saved / "elsewhere.spz").exists()
    bpy.ops.svrgs.prune(data="//data", out="//tiny_001_pruned.spz", **SHORT)
    assert (saved / "elsewhere.spz").exists() and (saved / "tiny_001_pruned.spz").is_symlink()


@pytest.mark.parametrize(
    "more, sentence",
    [
        (
            {},
            (
                "name a file for the result with out=: in background mode it lies beside the .blend, and this"
                " one has not been saved"
            ),
        ),
        ({"out": "//a.ply"}, "//a.ply: begins at the folder of the .blend, which has not been saved"),
        (
            {"out": "/nowhere/a.ply", "data": "//tiny"},
            "//tiny: begins at the folder of the .blend, which has not been saved",
        ),
        ({"out": "/tmp"}, "tmp: is a folder; give the name of a file"),
        ({"out": "/nowhere/result"}, "result: scenes are written as .ply"),
    ],
)
def test_an_output_without_a_place_is_refused_in_a_sentence(unsaved, more, sentence):
    with pytest.raises(RuntimeError, match=f"^Error: .*{sentence}"):
        bpy.ops.svrgs.prune(**{"data": str(DATA / "tiny")} | more, **SHORT)
    assert len(bpy.data.objects) == 1


def test_with_a_window_the_result_is_in_the_scene_alone(saved, bridge, capfd, monkeypatch):
    monkeypatch.setattr(part("operators.jobs.prune"), "BACKGROUND", False)
    bpy.ops.svrgs.prune(data="//data", **SHORT)
    (result,) = json_lines(capfd.readouterr().out)
    assert result["out"] is None and bridge.count(bpy.context.object) == 125
    assert sorted(path.name for path in saved.iterdir()) == ["data", "work.blend"]


# --- refusals and options


@pytest.mark.parametrize(
    "options, sentence",
    [
        ({"seen_from_only": True}, "name them with --seen-from"),
        ({"data": "/nowhere"}, "nowhere: holds no COLMAP model"),
        ({"scene": "/nowhere.ply"}, "there is no such file"),
    ],
)
def test_what_cannot_be_pruned_is_said_in_a_sentence(options, sentence, tmp_path):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    options = {"data": str(DATA / "tiny"), **options} if "scene" in options else options
    with pytest.raises(RuntimeError, match=sentence):
        bpy.ops.svrgs.prune(out=str(tmp_path / "out.ply"), **SHORT, **options)
    assert len(bpy.data.objects) == 1


def test_a_drop_is_the_option_of_the_command_line(capfd, tmp_path):
    data, out = str(DATA / "tiny"), str(tmp_path / "out.ply")
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    with pytest.raises(RuntimeError, match="method 'opacity' cannot take --max-drop"):
        bpy.ops.svrgs.prune(data=data, out=out, max_drop=0.5, method="opacity")
    with pytest.raises(RuntimeError, match="not allowed with"):
        bpy.ops.svrgs.prune(data=data, out=out, max_drop=0.5, target=0.5)
    bpy.ops.svrgs.prune(data=data, out=out, max_drop=0.5, iterations=300, recovery=0)
    (result,) = json_lines(capfd.readouterr().out)
    assert result["count"] < 250


def test_a_limit_of_time_is_the_option_of_the_command_line(capfd, tmp_path):
    data, out = str(DATA / "tiny"), str(tmp_path / "out.ply")
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    with pytest.raises(
        RuntimeError, match="--time chooses the number of steps itself: leave out --iterations"
    ):
        bpy.ops.svrgs.prune(data=data, out=out, time=600, iterations=20)
    bpy.ops.svrgs.prune(data=data, out=out, time=4, method="opacity", target=0.5)
    (result,) = json_lines(capfd.readouterr().out)
    assert result["time"]["asked"] == 4 and result["iterations"] == round(5_000 * result["time"]["schedule"])


def test_pruning_without_a_splat_says_so():
    with pytest.raises(RuntimeError, match="there is no object"):
        bpy.ops.svrgs.prune(data=str(DATA / "tiny"))


def test_the_command_line_of_blender_is_the_products(capfd):
    run = part("operators.jobs.command_line").run
    assert run(["info", str(DATA / "tiny/scene.ply"), "--json"]) == 0
    (facts,) = json_lines(capfd.readouterr().out)
    assert facts == part("svrgs_addon.files.registry").describe(DATA / "tiny/scene.ply")
    assert run(["info", "/nowhere.ply"]) == 2
    assert "there is no such file" in capfd.readouterr().err


def test_threads_are_taken_from_the_preferences(capfd):
    bpy.context.preferences.addons[PACKAGE].preferences.threads = 1
    try:
        assert part("operators.data.extension").threads(bpy.context) == 1
    finally:
        bpy.context.preferences.addons[PACKAGE].preferences.threads = 0


def test_figures_that_cannot_be_compared_are_left_out(capfd, monkeypatch, tmp_path):
    child = part("svrgs_addon.system.subprocess_python")
    ask = child.ask
    monkeypatch.setattr(child, "ask", lambda words: ask(words) | {"psnr": None})
    bpy.ops.svrgs.prune(
        scene=str(DATA / "tiny/scene.ply"), data=str(DATA / "tiny"), out=str(tmp_path / "out.ply"), **SHORT
    )
    assert "Kept 125 of 250 Gaussians\n" in capfd.readouterr().out
    assert bpy.context.object.name == "scene pruned"


def test_only_what_prunes_can_be_chosen():
    methods = bpy.ops.svrgs.prune.get_rna_type().properties["method"].enum_items
    assert "removal" in methods and "3dgs" not in methods and all(method.description for method in methods)


@pytest.mark.parametrize("name", ["prune", "contribution", "discard", "set_lambda"])
def test_every_setting_explains_itself(name):
    for prop in getattr(bpy.ops.svrgs, name).get_rna_type().properties:
        assert prop.description or prop.identifier == "rna_type", prop.identifier

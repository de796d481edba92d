"""Nothing of the user's is replaced by an output, and nothing stale is taken for new."""

from __future__ import annotations

import os
import shutil
import stat
import sys

import numpy as np
import pytest

from svrgs_addon.cli.main import main
from svrgs_addon.files.atomic import atomic_write, checked
from svrgs_addon.files.images import image_size
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.files.repair import FILTER
from svrgs_addon.system.errors import SceneError
from svrgs_addon.views.posed_photos import read
from test_mip_splatting import filtered_scene


@pytest.fixture
def tiny_copy(tiny, tmp_path):
    """A folder of the tiny dataset that may be changed."""
    return shutil.copytree(tiny.folder, tmp_path / "copy")


posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such files")


def refused(capsys, *words) -> str:
    assert main(list(map(str, words))) == 2
    return capsys.readouterr().err


def test_a_web_page_replaces_neither_its_splats_nor_files_of_others(tiny, tmp_path, capsys):
    pytest.importorskip("OpenImageIO")
    folder = tmp_path / "page"
    folder.mkdir()
    scene = read_scene(tiny.splat)
    for name in ("original.spz", "pruned.spz"):
        write_scene(folder / name, scene)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    said = refused(capsys, "view", folder / "pruned.spz", "--export", folder)
    assert "is the input itself" in said
    said = refused(capsys, "view", tiny.splat, "--export", folder)
    assert "original.spz would be replaced" in said or "make wheels fetches them" in said
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@posix
def test_a_pipe_is_no_output(tiny, tmp_path, capsys):
    os.mkfifo(tmp_path / "x.ply")
    assert "is a device or a pipe" in refused(capsys, "convert", tiny.splat, tmp_path / "x.ply")
    assert stat.S_ISFIFO((tmp_path / "x.ply").lstat().st_mode)


@posix
def test_a_file_that_is_replaced_keeps_its_permissions(tiny, tmp_path):
    out = tmp_path / "a.ply"
    out.write_bytes(b"")
    out.chmod(0o600)
    assert main(["convert", str(tiny.splat), str(out), "--overwrite"]) == 0
    assert stat.S_IMODE(out.stat().st_mode) == 0o600


def test_a_comparison_replaces_no_photograph(tiny_copy, capsys):
    photographs = tiny_copy / "images"
    words = [tiny_copy / "scene.ply", tiny_copy / "scene.ply", "--data", tiny_copy, "--out", photographs]
    before = {path.name: path.read_bytes() for path in photographs.iterdir()}
    assert "is a photograph, and would be replaced" in refused(capsys, "compare", *words)
    assert {path.name: path.read_bytes() for path in photographs.iterdir()} == before


def test_photographs_of_the_folder_one_stands_in_are_not_those_of_a_dataset(
    tiny, tiny_copy, capsys, monkeypatch
):
    (tiny_copy / "images").rename(tiny_copy / "photos")
    monkeypatch.chdir(tiny.folder)
    assert "has no image folder images" in refused(capsys, "eval", tiny.splat, "--data", tiny_copy)
    monkeypatch.chdir(tiny_copy.parent)
    words = ["eval", str(tiny.splat), "--data", str(tiny_copy), "--images", f"{tiny_copy.name}/photos"]
    assert main(words) == 0, "a path that is given is one"


def test_a_selection_of_mip_splatting_is_what_was_judged(tmp_path):
    write_scene(tmp_path / "mip.ply", filtered_scene(np.full(10, 0.3)))
    for out in ("a.spz", "a.ply"):
        assert (
            main(["select", str(tmp_path / "mip.ply"), "--opacity", "0,1", "--out", str(tmp_path / out)]) == 0
        )
    baked, kept = read_scene(tmp_path / "a.spz"), read_scene(tmp_path / "a.ply")
    assert FILTER in kept.attributes and np.median(baked.log_scales) > np.median(kept.log_scales) + 0.1


def test_undistorted_copies_follow_the_lens(tiny_copy, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    model, found = tiny_copy / "sparse/0", []
    for number, k in enumerate((0.2, -0.2)):
        reconstruction = pycolmap.Reconstruction(model)
        for lens in reconstruction.cameras.values():
            lens.model, lens.params = pycolmap.CameraModelId.OPENCV, [*lens.params[:4], k, 0, 0, 0]
        reconstruction.write_binary(model)
        for path in model.iterdir():
            os.utime(path, (2e9 + 10 * number, 2e9 + 10 * number))
        photos = read(tiny_copy, "", tmp_path / "copies")
        os.utime(photos.files[0], (2e9 + 5, 2e9 + 5))
        found.append((photos.cameras[0].width, image_size(photos.files[0])[0]))
    assert found[0][0] != found[1][0] and all(camera == file for camera, file in found)


def test_a_check_of_one_output_is_none_of_another(tmp_path):
    def refuse(written):
        raise SceneError(f"{written}: refused")

    with checked(tmp_path / "a.ply", refuse):
        with atomic_write(tmp_path / "b.ply") as file:
            file.write(b"b")
        with pytest.raises(SceneError, match="refused; the new file is kept as 'a \\(new\\).ply'"):
            with atomic_write(tmp_path / "a.ply") as file:
                file.write(b"a")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a (new).ply", "b.ply"]

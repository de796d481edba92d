"""Compressed formats: what is written is what was meant, within the steps of the format; other programs read
it alike, and we read theirs."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path

import numpy as np
import pytest

from ksplat_file import ksplat_of
from scenes import random_scene
from svrgs_addon.files import compressed_ply, spz
from svrgs_addon.files.axes import turned_over
from svrgs_addon.files.registry import (
    FORMATS,
    describe,
    format_to_read,
    format_to_write,
    left_out,
    read_scene,
    write_scene,
)
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.scene.morton_order import morton_order
from svrgs_addon.system.errors import FormatError, SceneError

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
WRITTEN = (".compressed.ply", ".spz", ".splat", ".glb", ".spz.glb", ".sog", ".usdc", ".usda")
JUDGED = (".compressed.ply", ".spz", ".splat", ".sog")  # formats that gaussforge knows
# its names
GAUSSFORGE = {
    ".ply": "ply",
    ".compressed.ply": "compressed.ply",
    ".spz": "spz",
    ".splat": "splat",
    ".ksplat": "ksplat",
    ".sog": "sog",
}


def rotations(quats: np.ndarray) -> np.ndarray:
    """(N, 3, 3)."""
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float64).T
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    return np.stack(
        [*rows, 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1
    ).reshape(-1, 3, 3)


def alphas(scene: Scene) -> np.ndarray:
    return 1 / (1 + np.exp(-scene.opacity_logits.astype(np.float64)))


def differences(one: Scene, other: Scene) -> dict[str, float]:
    """The largest difference of each kind of value. sh: of the base colour, 0 to 1; rest: of the other
    coefficients."""
    assert one.count == other.count and one.sh_degree == other.sh_degree
    pairs = {
        "means": (one.means, other.means),
        "logs": (one.log_scales, other.log_scales),
        "turn": (rotations(one.quats), rotations(other.quats)),
        "alphas": (alphas(one), alphas(other)),
        "color": (0.2821 * one.sh[:, 0], 0.2821 * other.sh[:, 0]),
        "rest": (one.sh[:, 1:], other.sh[:, 1:]),
    }
    return {name: float(np.abs(first - second).max(initial=0)) for name, (first, second) in pairs.items()}


def like_trained(degree: int, count: int = 700, **words) -> Scene:
    """A scene whose values are within what all formats can hold."""
    scene = random_scene(count, 3, degree, **words)
    sh = np.clip(scene.sh, -0.9, 0.9)
    sh[:, 0] = np.clip(scene.sh[:, 0], -1.7, 1.7)
    return dataclasses.replace(scene, sh=sh)


def by_gaussforge(data: bytes, kind: str, out: str, **words) -> bytes:
    gaussforge = pytest.importorskip("gaussforge")
    result = gaussforge.GaussForge().convert(data, GAUSSFORGE[kind], GAUSSFORGE[out], **words)
    assert "data" in result, result
    return result["data"]


def judged(data: bytes, kind: str, path: Path) -> Scene:
    """The scene as gaussforge reads it. It leaves the axes of SPZ as they are, right, up, back."""
    path.write_bytes(by_gaussforge(data, kind, ".ply"))
    scene = read_scene(path)
    if kind != ".spz":
        return scene
    return turned_over(scene)


STEPS = {  # largest differences of what is read from what was written
    ".compressed.ply": dict(means=6e-3, logs=5e-3, turn=6e-3, alphas=0.0022, color=0.003, rest=8 / 256),
    ".spz": {"means": 2.0**-13, "logs": 1 / 31, "turn": 6e-3, "alphas": 0.0022, "color": 0.0038, "rest": 0.5},
    ".spz.glb": dict(means=2.0**-13, logs=1 / 31, turn=0.2, alphas=0.0022, color=0.0038, rest=0.5),
    ".glb": {"means": 0, "logs": 1e-6, "turn": 1e-6, "alphas": 1e-6, "color": 0, "rest": 0},
    ".usdc": {"means": 0, "logs": 1e-6, "turn": 1e-6, "alphas": 1e-6, "color": 0, "rest": 0},
    ".usda": {"means": 1e-6, "logs": 1e-6, "turn": 1e-6, "alphas": 1e-6, "color": 1e-6, "rest": 1e-6},
    ".sog": {"means": 1e-3, "logs": 0.5, "turn": 0.02, "alphas": 0.0022, "color": 0.03, "rest": 0.6},
    ".splat": {"means": 0, "logs": 1e-6, "turn": 0.03, "alphas": 0.0022, "color": 0.0021},
}


@pytest.mark.parametrize(
    "suffix, degree",
    [
        pytest.param(suffix, degree, marks=pytest.mark.slow if "usd" in suffix and degree < 3 else ())
        for suffix in WRITTEN
        for degree in range(4)
    ],
)
def test_what_is_read_is_what_was_written_within_the_steps_of_the_format(tmp_path, suffix, degree):
    scene, path = like_trained(degree), tmp_path / f"a{suffix}"
    write_scene(path, scene)
    expected = (
        scene if suffix in (".splat", ".glb", ".usdc", ".usda") else scene.select(morton_order(scene.means))
    )
    if suffix == ".splat":
        expected = dataclasses.replace(expected, sh=np.ascontiguousarray(scene.sh[:, :1]))
    found = differences(read_scene(path), expected)
    assert all(found[name] <= step for name, step in STEPS[suffix].items()), found
    info = describe(path)
    assert info["count"] == scene.count and info["sh_degree"] == expected.sh_degree
    assert info["bytes"] == path.stat().st_size


@pytest.mark.parametrize("version", (2, 3, 4))
def test_every_version_of_spz_is_read_alike(tmp_path, version):
    scene, path = like_trained(2), tmp_path / "a.spz"
    spz.write(path, scene, version)
    found = differences(read_scene(path), scene.select(morton_order(scene.means)))
    assert path.read_bytes()[:2] == (b"NG" if version == 4 else b"\x1f\x8b")
    assert all(
        found[name] <= step
        for name, step in (STEPS[".spz"] | {"turn": 0.2 if version == 2 else 6e-3}).items()
    ), found


@pytest.mark.parametrize("suffix", JUDGED)
def test_a_stranger_reads_what_we_write_as_we_do(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_scene(path, like_trained(3))
    ours, theirs = read_scene(path), judged(path.read_bytes(), suffix, tmp_path / "judged.ply")
    found = differences(
        ours, dataclasses.replace(theirs, sh=np.ascontiguousarray(theirs.sh[:, : ours.sh.shape[1]]))
    )
    # within a step: they take another place of the same one
    assert found.pop("rest") <= (0.02 if suffix == ".compressed.ply" else 1e-4)
    assert max(found.values()) < 0.004, found


@pytest.mark.parametrize("version", (2, 3, 4))
def test_a_stranger_reads_every_version_of_spz(tmp_path, version):
    path = tmp_path / "a.spz"
    spz.write(path, like_trained(2), version)
    found = differences(read_scene(path), judged(path.read_bytes(), ".spz", tmp_path / "judged.ply"))
    assert max(found.values()) < 0.002, found


@pytest.mark.parametrize("degree", (0, 1, 2))
@pytest.mark.parametrize("suffix", [*JUDGED, ".ksplat"])
def test_we_read_what_a_stranger_writes_as_it_does(tmp_path, suffix, degree):
    source, path = tmp_path / "a.ply", tmp_path / f"b{suffix}"
    write_scene(source, like_trained(degree))
    path.write_bytes(by_gaussforge(source.read_bytes(), ".ply", suffix))
    ours, theirs = read_scene(path), judged(path.read_bytes(), suffix, tmp_path / "judged.ply")
    found = differences(
        ours, dataclasses.replace(theirs, sh=np.ascontiguousarray(theirs.sh[:, : ours.sh.shape[1]]))
    )
    rest = found.pop("rest")
    if (suffix, degree) != (".ksplat", 2):  # it orders the coefficients of degree 2 as no one else
        assert rest <= (0.02 if suffix == ".compressed.ply" else 1e-3), found
    assert max(found.values()) < 0.004, found
    assert ours.sh_degree == (0 if suffix == ".splat" else degree)


@pytest.mark.parametrize("level", (0, 1, 2))
def test_a_ksplat_of_two_sections_is_read_as_its_own_program_reads_it(tmp_path, level):
    """Buckets that are full and that are not; SH in bands of red, green, blue."""
    scene = like_trained(2, 40)
    (tmp_path / "a.ksplat").write_bytes(
        ksplat_of([scene.select(np.arange(25)), scene.select(np.arange(25, 40))], level)
    )
    found = differences(read_scene(tmp_path / "a.ksplat"), scene)
    close = dict(
        means=3e-4, logs=2e-3, turn=3e-3, alphas=0.0022, color=0.0021, rest=(1e-6, 1e-3, 0.013)[level]
    )
    assert all(found[name] <= step for name, step in close.items()), found


@pytest.mark.parametrize(
    ("at", "value", "said"),
    [
        (4096 + 4, 1, "a section of SH degree 2 with 40 of 1 Gaussians"),
        (4096 + 40, 5, "a section of SH degree 5"),
        (16, 41, "holds 41 Gaussians, but its sections hold others"),
        (4096 + 8, 2, "Gaussians without a bucket"),
    ],
)
def test_a_ksplat_whose_numbers_contradict_each_other_is_refused(tmp_path, at, value, said):
    data = bytearray(ksplat_of([like_trained(2, 40)], 1))
    data[at : at + 4] = value.to_bytes(4, "little")
    (tmp_path / "a.ksplat").write_bytes(data)
    with pytest.raises(FormatError, match=said):
        read_scene(tmp_path / "a.ksplat")


def test_a_compressed_ply_whose_elements_contradict_each_other_is_refused(tmp_path):
    write_scene(tmp_path / "a.compressed.ply", like_trained(1, 100))
    data = (tmp_path / "a.compressed.ply").read_bytes()
    for old, new, said in (
        (b"sh 100", b"sh 101", "other SH"),
        (b"chunk 1", b"chunk 2", "another number of them"),
    ):
        (tmp_path / "a.compressed.ply").write_bytes(data.replace(b"element " + old, b"element " + new))
        with pytest.raises(FormatError, match=said):
            read_scene(tmp_path / "a.compressed.ply")


def test_a_gaussian_that_is_not_usable_is_not_invisible_too(tmp_path):
    scene = like_trained(0, 10)
    scene.opacity_logits[:] = [-20, -20, *[3] * 8]
    scene.means[0] = np.nan
    write_scene(tmp_path / "a.ply", scene)
    found = describe(tmp_path / "a.ply")
    assert (found["invisible"], found["nonfinite"]) == (1, 1)


def test_a_scene_without_sh_is_an_spz_that_blender_reads(tmp_path):
    spz.write(tmp_path / "a.spz", like_trained(0))
    assert (tmp_path / "a.spz").read_bytes()[:2] == b"\x1f\x8b"


def test_an_spz_holds_the_nearest_to_coefficients_beyond_its_ends(tmp_path):
    scene = like_trained(1)
    scene.sh[:, 1:] = np.where(scene.sh[:, 1:] > 0, 5, -5)
    spz.write(tmp_path / "a.spz", scene)
    found, expected = (
        read_scene(tmp_path / "a.spz").sh[:, 1:],
        scene.select(morton_order(scene.means)).sh[:, 1:],
    )
    assert (found * expected > 0).all() and np.unique(np.abs(found)).tolist() == [127 / 128, 1]


def test_gaussians_far_along_one_axis_alone_make_a_compressed_ply_coarse():
    scene = like_trained(0, 1_000)
    assert not compressed_ply.limits(scene)
    scene.means[::100, 0] = 1e5
    assert "stored in steps larger than these are" in compressed_ply.limits(scene)[0]


def test_a_ksplat_that_was_cut_off_is_refused(tmp_path):
    (tmp_path / "a.ksplat").write_bytes(ksplat_of([like_trained(2, 40)], 1)[:-1])
    with pytest.raises(FormatError, match="is incomplete: .* of at least"):
        read_scene(tmp_path / "a.ksplat")


def test_a_position_that_is_not_finite_spoils_no_other_of_an_spz(tmp_path):
    scene = like_trained(0)
    scene.means[:] *= 1_500
    scene.means[0] = np.inf
    spz.write(tmp_path / "a.spz", scene)
    found, expected = read_scene(tmp_path / "a.spz"), scene.select(morton_order(scene.means))
    close = np.abs(found.means - expected.means).max(axis=1) < 0.01
    assert close.sum() == scene.count - 1


@pytest.mark.parametrize("name", ["biker_splat/biker.compressed.ply", "biker_splat/biker.v3.spz"])
def test_a_capture_is_the_same_in_every_format(name):
    if not (DATA / name).exists():
        pytest.skip(f"{name} of the shared data is missing")
    one, other = read_scene(DATA / "biker_splat/biker.spz"), read_scene(DATA / name)
    found = differences(one, other)
    assert found["means"] < 2e-3 and found["alphas"] < 1e-6 and found["color"] < 0.005
    assert np.quantile(np.abs(one.log_scales - other.log_scales), 0.99) < 0.04  # an SPZ has none below -10
    turned = np.abs(rotations(one.quats) - rotations(other.quats)).max(axis=(1, 2))
    assert np.quantile(turned, 0.99) < 6e-3


@pytest.mark.parametrize("name", ["playbot_lod3.v3.spz", "playbot_lod3.compressed.ply"])
def test_a_capture_with_colours_that_depend_on_the_view_is_the_same_in_every_format(name):
    folder = DATA / "playbot_splat"
    if not folder.exists():
        pytest.skip("playbot_splat of the shared data is missing")
    plain, other = read_scene(folder / "playbot_lod3.ply"), read_scene(folder / name)
    assert other.sh_degree == 2
    tree = pytest.importorskip("scipy.spatial").cKDTree(plain.means)  # its writers order by place
    distance, row = tree.query(other.means)
    near = differences(plain.select(row), other)
    assert np.quantile(distance, 0.9) < 1e-3
    assert np.quantile(np.abs(plain.sh[row][:, 1:] - other.sh[:, 1:]), 0.9) < 0.07, near


@pytest.mark.parametrize("name", ["sog_lod3", "sog_lod3/meta.json"])
def test_a_folder_of_textures_is_what_the_program_that_made_it_says(name):
    folder = DATA / "playbot_splat"
    if not folder.exists():
        pytest.skip("playbot_splat of the shared data is missing")
    found, expected = read_scene(folder / name), read_scene(folder / "playbot_lod3.ply")
    assert max(differences(found, expected).values()) < 1e-6
    assert describe(folder / name)["bytes"] == sum(
        file.stat().st_size for file in (folder / "sog_lod3").iterdir()
    )


def test_the_kind_of_a_ply_is_told_by_its_header(tmp_path):
    scene = like_trained(1)
    compressed_ply.write(tmp_path / "plain-name.ply", scene)
    assert format_to_read(tmp_path / "plain-name.ply").name == "compressed-ply"
    write_scene(tmp_path / "a.ply", scene)
    assert format_to_read(tmp_path / "a.ply").name == "ply"
    assert format_to_write("A.COMPRESSED.PLY").name == "compressed-ply"
    assert format_to_write("a.ply").name == "ply"
    with pytest.raises(SceneError, match=r"\.spz"):
        format_to_write("a.ksplat")


@pytest.mark.parametrize("suffix", WRITTEN)
@pytest.mark.parametrize("count", (1, 255, 257, pytest.param(2**16 + 1, marks=pytest.mark.slow)))
def test_any_number_of_gaussians_is_written(tmp_path, suffix, count):
    scene = like_trained(1, count)
    write_scene(tmp_path / f"a{suffix}", scene)
    found = read_scene(tmp_path / f"a{suffix}")
    assert found.count == count and np.isfinite(found.means).all()


@pytest.mark.parametrize("found", [one for one in FORMATS if one.size], ids=lambda one: one.name)
def test_the_size_is_foreseen_to_the_byte(tmp_path, found):
    scene, path = like_trained(2, 1_000), tmp_path / f"a{found.suffixes[0]}"
    write_scene(path, scene)
    assert found.size(scene) == path.stat().st_size


@pytest.mark.parametrize("found", FORMATS, ids=lambda one: one.name)
def test_an_empty_scene_is_beyond_no_limit(found):
    assert left_out(random_scene(0, sh_degree=0), found) == []


@pytest.mark.parametrize("suffix", WRITTEN)
def test_the_flag_of_antialiasing_is_kept_or_its_loss_is_said(tmp_path, suffix, caplog):
    with caplog.at_level(logging.WARNING):
        write_scene(tmp_path / f"a{suffix}", dataclasses.replace(like_trained(0), antialiased=True))
    assert read_scene(tmp_path / f"a{suffix}").antialiased == (
        suffix not in (".splat", ".glb", ".usdc", ".usda")
    )
    assert ("antialiased" in caplog.text) == (suffix in (".splat", ".glb", ".usdc", ".usda"))


def test_further_columns_that_a_format_cannot_hold_are_named(tmp_path, caplog):
    scene = dataclasses.replace(
        like_trained(0), attributes={"nx": np.zeros(700, np.float32), "confidence": np.ones(700, np.float32)}
    )
    with caplog.at_level(logging.WARNING):
        write_scene(tmp_path / "a.spz", scene)
    assert "confidence" in caplog.text and "nx" not in caplog.text


@pytest.mark.parametrize(
    ("change", "said"), [("far", "steps of"), ("tiny", "the limits of an SPZ"), ("none", "")]
)
def test_what_is_beyond_the_limits_of_an_spz_is_said(tmp_path, caplog, change, said):
    scene = like_trained(0)
    if change == "far":
        scene.means[5] = 1e6
    if change == "tiny":
        scene = dataclasses.replace(
            scene,
            means=scene.means * np.float32(1e-5),
            log_scales=scene.log_scales + np.float32(np.log(1e-5)),
        )
    with caplog.at_level(logging.WARNING):
        write_scene(tmp_path / "a.spz", scene)
    assert (said in caplog.text) if said else not caplog.text
    found = read_scene(tmp_path / "a.spz").means
    assert found.max() == pytest.approx(scene.means.max(), rel=0.01)


@pytest.mark.parametrize(
    ("suffix", "change", "said"),
    [
        (".spz", "bright", "clipped"),
        (".spz", "shiny", "clipped"),
        (".compressed.ply", "shiny", "clipped"),
        (".compressed.ply", "far", "larger than these are"),
        (".compressed.ply", "bright", ""),
        (".ply", "shiny", ""),
    ],
)
def test_colours_and_places_that_a_format_cannot_hold_are_said(tmp_path, caplog, suffix, change, said):
    scene = like_trained(1)
    if change == "far":
        scene.means[:] *= 1e6
    else:
        scene.sh[:100, 0 if change == "bright" else slice(1, None)] = 5.0
    with caplog.at_level(logging.WARNING):
        write_scene(tmp_path / f"a{suffix}", scene)
    assert (said in caplog.text) if said else not caplog.text


@pytest.mark.slow
def test_opaque_and_transparent_gaussians_stay_finite_and_what_they_are(tmp_path):
    scene = dataclasses.replace(like_trained(0, 4), opacity_logits=np.array([-80, -6, 6, 80], np.float32))
    for suffix in WRITTEN:
        write_scene(tmp_path / f"a{suffix}", scene)
        found = np.sort(alphas(read_scene(tmp_path / f"a{suffix}")))
        assert 0 < found[0] < 1 / 255 and 0.998 < found[3] < 1

"""Whatever the bytes are, a reader gives something valid or one sentence, within a second and bounded
memory."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import scenes
from fuzz import NAMES
from fuzz.mutate import mutated
from fuzz.seeds import camera_entries, ply_seeds, target
from fuzz.targets import Checkpoint, cameras_json, ply
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.files.registry import FORMATS, describe, load_scene
from svrgs_addon.scene.gaussians import SH_COEFFICIENTS, Scene
from svrgs_addon.system.errors import FormatError, SceneError

ROOT = Path(__file__).resolve().parents[1]
ARRAYS = ("means", "log_scales", "quats", "opacity_logits", "sh")
SHORT = settings(max_examples=150, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def seeds(tmp_path_factory) -> list[bytes]:
    return ply_seeds(tmp_path_factory.mktemp("seeds"))


def in_time_and_memory(check, data: bytes) -> bool:
    """The promises of targets.py: first three seconds, then 64 MiB + 4 times the input."""
    accepted = check(data)
    tracemalloc.start()
    try:
        assert check(data) == accepted
    finally:
        tracemalloc.stop()
    return accepted


# --- PLY


def test_seeds_are_valid(seeds):
    assert all(map(ply, seeds))


def test_every_truncated_header_and_200_bodies(seeds):
    for data in seeds:
        body = data.index(b"end_header\n") + len(b"end_header\n")
        cuts = {*range(body), *np.linspace(body, len(data) - 1, 200).astype(int).tolist()}
        whole = [cut for cut in sorted(cuts) if ply(data[:cut])]
        # complete: the first element of a file with more of them, the last number of a text
        assert not whole or b"element face" in data or (b"ascii" in data and min(whole) > len(data) - 9), (
            whole[:5]
        )


HEADER_LINES = st.one_of(
    st.sampled_from([b"property" + rest for rest in (b"", b" float x", b" float y", b" uchar y")]),
    st.sampled_from([b"property list uchar int a", b"comment", b"obj_info x", b"end_header", b"ply", b""]),
    st.sampled_from(
        [b"format %s 1.0" % k for k in (b"ascii", b"binary_little_endian", b"binary_big_endian")]
    ),
    st.builds(
        lambda name, n: b"element %s %d" % (name, n),
        st.sampled_from([b"vertex", b"face", b"chunk"]),
        st.sampled_from([0, 1, 5, 2**31, 2**32, 2**63, 10**9]),
    ),
    st.binary(max_size=30),
)


@SHORT
@given(st.lists(HEADER_LINES, max_size=25), st.binary(max_size=400))
def test_headers_of_any_lines(lines, body):
    ply(b"\n".join([b"ply", *lines, b"end_header", body]))


@SHORT
@given(st.integers(0, 2**31), st.integers(0, 5))
def test_changed_files(seeds, seed, which):
    in_time_and_memory(ply, mutated(seeds[which], random.Random(seed)))


@pytest.mark.parametrize("kind", ["properties", "comments", "elements", "zeros", "numbers", "count"])
def test_files_of_a_megabyte(seeds, kind):
    size, (header, body) = 999_000, seeds[0].split(b"end_header\n")
    text = seeds[4].split(b"end_header\n")[0]
    data = {
        "properties": header + b"".join(b"property float a%d\n" % i for i in range(44_000)) + b"end_header\n",
        "comments": header + b"comment\n" * 120_000 + b"end_header\n" + body,
        "elements": header
        + b"".join(b"element e%d 4294967295\n" % i for i in range(900))
        + b"end_header\n"
        + body,
        "zeros": header.replace(b"vertex 5", b"vertex %d" % ((size - 1000) // 68))
        + b"end_header\n"
        + bytes((size - 1000) // 68 * 68),
        "numbers": text.replace(b"vertex 5", b"vertex %d" % (size // 40))
        + b"end_header\n"
        + b"1 " * (size // 2 - 500),
        "count": header.replace(b"vertex 5", b"vertex 9999999999") + b"end_header\n" + bytes(size - 1000),
    }[kind]
    assert 900_000 < len(data) < 1_000_000 or kind == "elements"
    in_time_and_memory(ply, data)


def test_two_vertex_elements_are_refused(tmp_path, seeds):
    twice = seeds[0].replace(b"end_header", b"element vertex 5\nproperty float x\nend_header")
    (tmp_path / "a.ply").write_bytes(twice + bytes(20))
    with pytest.raises(FormatError, match="vertex twice"):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ARRAYS)
def test_rows_that_are_not_finite_are_counted(tmp_path, name, value, caplog):
    """Dropped or, where the value has a meaning, clamped: what is left is finite."""
    scene = scenes.random_scene(9, 0, 1)
    array = getattr(scene, name).copy()
    array.reshape(9, -1)[::3, -1] = value
    write_ply(tmp_path / "a.ply", replace(scene, **{name: array}))
    loaded = load_scene(tmp_path / "a.ply")
    dropped = 9 - loaded.count
    assert dropped in (0, 3) and f"{dropped} Gaussians" in caplog.text
    assert f"{3 - dropped} with" in caplog.text
    assert describe(tmp_path / "a.ply")["nonfinite"] == dropped
    assert all(np.isfinite(getattr(loaded, other)).all() for other in ARRAYS)


def test_a_file_of_bad_rows_alone_is_refused(tmp_path):
    scene = scenes.random_scene(3, 0, 0)
    scene.means[:] = np.nan
    write_ply(tmp_path / "a.ply", scene)
    with pytest.raises(SceneError, match="no usable Gaussian"):
        load_scene(tmp_path / "a.ply")


FLOATS = st.floats(width=32)


@st.composite
def any_scene(draw) -> Scene:
    count, coefficients = draw(st.integers(0, 6)), draw(st.sampled_from(SH_COEFFICIENTS))
    widths = {"means": 3, "log_scales": 3, "quats": 4, "opacity_logits": 1, "sh": 3 * coefficients}
    shapes = {"opacity_logits": (count,), "sh": (count, coefficients, 3)}
    arrays = {}
    for name, width in widths.items():
        values = draw(st.lists(FLOATS, min_size=width, max_size=width))
        rows = np.array([np.roll(values, i) for i in range(count)], np.float32)
        arrays[name] = rows.reshape(shapes.get(name, (count, width)))
    comments = draw(st.lists(st.text(st.characters(min_codepoint=32, max_codepoint=126)), max_size=3))
    return Scene(**arrays, comments=tuple(comments), antialiased=draw(st.booleans()))


@SHORT
@given(any_scene())
def test_what_is_written_is_read(tmp_path_factory, scene):
    path = tmp_path_factory.getbasetemp() / "round.ply"
    write_ply(path, scene)
    again = read_ply(path)
    for name in ARRAYS:
        assert getattr(again, name).tobytes() == getattr(scene, name).tobytes(), name
    assert again.antialiased == scene.antialiased
    first = path.read_bytes()
    write_ply(path, again)
    assert path.read_bytes() == first


# --- cameras.json


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-(10**20), 10**20) | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(list(camera_entries(1)[0])), inner, max_size=4)
    ),
    max_leaves=12,
)


@SHORT
@given(JSON, st.sampled_from(list(camera_entries(1)[0])))
def test_cameras_of_any_values(value, key):
    cameras_json(json.dumps(value).encode())
    cameras_json(json.dumps([camera_entries(1)[0] | {key: value}]).encode())


@pytest.mark.slow
def test_hostile_camera_files():
    whole = json.dumps(camera_entries()).encode()
    assert cameras_json(whole)
    assert not any(cameras_json(whole[:cut]) for cut in range(len(whole)))
    for data in (
        b"[" * 400_000,
        b"1" * 900_000,
        b"[1e999]",
        b'"' + b"a" * 900_000,
        b"[" + b"{}," * 300_000 + b"{}]",
        b"\xff\xfe" + whole,
        bytes(900_000),
    ):
        assert not in_time_and_memory(cameras_json, data)
    many = json.dumps(camera_entries(4500)).encode()
    assert len(many) < 1_000_000 and in_time_and_memory(cameras_json, many)


@pytest.mark.parametrize("name", ["/etc/passwd", "../a.png", "a/../../b", "C:\\a.png", "..\\a.png", ""])
def test_camera_names_stay_inside(name):
    assert not cameras_json(json.dumps([camera_entries(1)[0] | {"img_name": name}]).encode())


# --- checkpoints


def test_a_checkpoint_changed_anywhere_is_none(tmp_path):
    from fuzz.seeds import checkpoint_folder

    check = Checkpoint(checkpoint_folder(tmp_path))
    manifest, arrays = check.seeds()
    assert check(manifest) and check(arrays)
    for cut in range(1, len(manifest)):
        assert not check(manifest[:cut])
    for at in range(1, len(manifest) - 1):
        changed = bytearray(manifest)
        changed[at] = ord("7") if changed[at] != ord("7") else ord("8")
        assert not check(bytes(changed)), bytes(changed)
    for at in range(1, len(arrays), 7):
        assert not check(arrays[:at] + bytes([arrays[at] ^ 1]) + arrays[at + 1 :])


# --- in processes of their own: a reader in C++ could take the tests down with it


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name == "usd" else []) for name in NAMES]
)
def test_what_the_search_starts_from_is_valid(name, tmp_path):
    if name.startswith("colmap"):
        pytest.importorskip("pycolmap")
        pytest.importorskip("OpenImageIO")
    check, found = target(name, tmp_path)
    assert found and all(map(check, found))


@pytest.mark.slow
@pytest.mark.parametrize("target", sorted({*NAMES, *(splat_format.name for splat_format in FORMATS)}))
def test_a_short_run_of_changed_files(target, tmp_path):
    if target.startswith("colmap"):
        pytest.importorskip("pycolmap")
        pytest.importorskip("OpenImageIO")
    command = [sys.executable, "-m", "tests.fuzz", target, "--seconds", "1", "--seed", "1"]
    environment = {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "PATH": "/usr/bin:/bin", "TMPDIR": str(tmp_path)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0 and "nothing broken" in done.stdout, done.stderr[-2000:]

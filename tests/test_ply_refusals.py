"""3DGS PLY: no file can do harm, and each one that is refused is refused in one sentence."""

from __future__ import annotations

import numpy as np
import pytest

from ply_cases import STANDARD, ply_bytes, read_bytes
from svrgs_addon.files.ply import read_ply
from svrgs_addon.system.errors import FormatError


def test_truncated_at_every_header_byte(tmp_path):
    data = ply_bytes()
    for size in range(len(data) - 2 * 4 * len(STANDARD)):
        with pytest.raises(FormatError):
            read_bytes(tmp_path, data[:size])


@pytest.mark.parametrize("fmt", ["binary_little_endian", "ascii"])
def test_truncated_body(tmp_path, fmt):
    body = b"1 " * 14 * 20 if fmt == "ascii" else b"\1" * (56 * 20)
    data = ply_bytes(count=20, body=body, fmt=fmt)
    for cut in np.linspace(2, len(body), 50).astype(int):
        with pytest.raises(FormatError):
            read_bytes(tmp_path, data[:-cut])


def test_how_much_is_missing_is_said(tmp_path):
    data = ply_bytes(count=1000)
    whole = f"{len(data) / 1e3:.1f}"
    for size, sentence in (
        (5_000, f"5.0 of {whole} kB"),
        (len(data) - 10, f"10 bytes of {whole} kB are missing"),
    ):
        (tmp_path / "trunc.ply").write_bytes(data[:size])
        with pytest.raises(
            FormatError, match=rf"trunc\.ply is incomplete: {sentence}; copy or export it again$"
        ):
            read_ply(tmp_path / "trunc.ply")


def test_one_byte_too_many(tmp_path):
    with pytest.raises(FormatError, match="1 bytes more"):
        read_bytes(tmp_path, ply_bytes() + b"\0")


@pytest.mark.parametrize("count", [10**9, 2**31, 2**32 + 2, 9_999_999_999])
@pytest.mark.parametrize("fmt", ["binary_little_endian", "ascii"])
def test_huge_count_allocates_nothing(tmp_path, count, fmt):
    data = ply_bytes(count=2, fmt=fmt).replace(b"vertex 2", b"vertex %d" % count)
    with pytest.raises(FormatError, match="incomplete"):
        read_bytes(tmp_path, data, max_count=10**10)
    with pytest.raises(FormatError, match="limit"):
        read_bytes(tmp_path, data)


@pytest.mark.parametrize("name", STANDARD)
def test_missing_property_is_named(tmp_path, name):
    with pytest.raises(FormatError, match=f"lacks the property {name}"):
        read_bytes(tmp_path, ply_bytes([other for other in STANDARD if other != name]))


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("property float opacity", "property list uchar float opacity", "list property opacity"),
        ("property float opacity", "property uchar opacity", "opacity as uchar"),
        ("property float opacity", "property float x", "x of vertex twice"),
        ("property float opacity", "property half opacity", "not understood"),
        ("property float opacity", "property float", "not understood"),
        ("property float opacity", "property", "not understood"),
        ("property float opacity", "surprise", "not understood"),
        ("property float x", "property float f_rest_0", "1 f_rest"),
        ("property float x", "property float x\x80", "ASCII"),
        ("property float x", "element vertex 2\nproperty float x", "vertex twice"),
        ("element vertex 2", "property float early\nelement vertex 2", "before any element"),
        ("element vertex 2", "element face 1\nelement vertex 2", "face before"),
        ("element vertex 2", "element vertices 2", "no vertex"),
        ("element vertex 2", "element vertex -2", "name and a count"),
        ("element vertex 2", "element vertex 2.0", "name and a count"),
        ("element vertex 2", "element vertex 0x2", "name and a count"),
        ("element vertex 2", "element vertex \u0662", "ASCII"),
        ("element vertex 2", "element vertex 00000000002", "name and a count"),
        ("element vertex 2", "element vertex", "name and a count"),
        ("format binary_little_endian 1.0", "format binary_middle_endian 1.0", "unknown format"),
        ("format binary_little_endian 1.0", "format binary_little_endian 2.0", "unknown format"),
        ("format binary_little_endian 1.0", "comment none", "one format"),
        ("format binary_little_endian 1.0", "format ascii 1.0\nformat ascii 1.0", "one format"),
        ("format binary_little_endian 1.0", "format ascii 1.0" + "\ncomment" * 1000, "header lines"),
        ("format binary_little_endian 1.0", "comment " + "x" * 66_000, "does not end"),
        ("ply\n", "plyx\n", "not a PLY"),
    ],
)
def test_wrong_headers_are_refused(tmp_path, old, new, message):
    data = ply_bytes()
    assert old.encode() in data
    with pytest.raises(FormatError, match=message) as caught:
        read_bytes(tmp_path, data.replace(old.encode(), new.encode("utf-8"), 1))
    assert "case.ply" in str(caught.value) and "\n" not in str(caught.value)


def test_sh_degree_4_is_refused(tmp_path):
    with pytest.raises(FormatError, match="72 f_rest"):
        read_bytes(tmp_path, ply_bytes(STANDARD + [f"f_rest_{i}" for i in range(72)]))


def test_gap_in_f_rest_is_named(tmp_path):
    with pytest.raises(FormatError, match="f_rest_8"):
        read_bytes(tmp_path, ply_bytes(STANDARD + [f"f_rest_{i}" for i in (*range(8), 9)]))


def test_compressed_ply_is_recognised(tmp_path):
    lines = "ply\nformat binary_little_endian 1.0\nelement chunk 1\nproperty float min_x\n"
    lines += "element vertex 4\nproperty uint packed_position\nend_header\n"
    with pytest.raises(FormatError, match="compressed PLY"):
        read_bytes(tmp_path, lines.encode() + bytes(20))


def test_missing_file_and_folder(tmp_path):
    for path in (tmp_path / "none.ply", tmp_path):
        with pytest.raises(FormatError, match="is not a file"):
            read_ply(path)

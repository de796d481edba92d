"""PLY files made line by line, and scenes to write."""

from __future__ import annotations

import numpy as np

from svrgs_addon.files.ply import read_ply
from svrgs_addon.scene.gaussians import SH_COEFFICIENTS, Scene

ARRAYS = ("means", "log_scales", "quats", "opacity_logits", "sh")
STANDARD = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()


def make_scene(count: int = 7, degree: int = 1, **more) -> Scene:
    rng = np.random.default_rng(degree)
    shapes = dict(means=(3,), log_scales=(3,), quats=(4,), opacity_logits=(), sh=(SH_COEFFICIENTS[degree], 3))
    return Scene(
        **{k: rng.standard_normal((count, *s)).astype(np.float32) for k, s in shapes.items()}, **more
    )


def ply_bytes(
    properties=STANDARD, count=2, body=None, fmt="binary_little_endian", kind="float", extra_lines=()
):
    """A PLY made line by line, so that single things can be wrong with it."""
    lines = [
        "ply",
        f"format {fmt} 1.0",
        f"element vertex {count}",
        *(f"property {kind} {name}" for name in properties),
    ]
    if body is None:
        body = np.arange(count * len(properties), dtype="<f4").tobytes()
    return "\n".join([*lines, *extra_lines, "end_header", ""]).encode() + body


def read_bytes(tmp_path, data: bytes, **options) -> Scene:
    path = tmp_path / "case.ply"
    path.write_bytes(data)
    return read_ply(path, **options)


def assert_same(a: Scene, b: Scene):
    for name in ARRAYS:
        assert np.array_equal(getattr(a, name), getattr(b, name)), name

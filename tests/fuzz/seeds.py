"""Small valid inputs of every target, for engines to change."""

from __future__ import annotations

import gzip
import io
import json
from pathlib import Path

import numpy as np

from fuzz.targets import SPLATS, Checkpoint, Colmap, Streamed, cameras_json, transforms_json
from ksplat_file import ksplat_of
from svrgs_addon.files import spz
from svrgs_addon.files.registry import FORMATS, write_scene
from svrgs_bench.scenes import room


def target(name: str, folder: Path):
    """(target, its seeds) by a name from fuzz.NAMES; folder: for what a target needs beside its bytes."""
    if name in SPLATS:
        return SPLATS[name], SEEDS[name](folder) if name in SEEDS else splat_seeds(name, folder)
    if name == "cameras-json":
        return cameras_json, [json.dumps(camera_entries()).encode()]
    if name == "transforms-json":
        return transforms_json, [json.dumps(contents).encode() for contents in transforms_contents()]
    if name == "checkpoint":
        found = Checkpoint(checkpoint_folder(folder))
    elif name == "streamed-sog":
        found = Streamed(folder)
    else:
        found = Colmap(colmap_folder(folder, text=name == "colmap-text"))
    return found, found.seeds()


def splat_seeds(name: str, folder: Path) -> list[bytes]:
    """SH degrees 0 and 1, as the format writes them."""
    write, found = next(splat_format.write for splat_format in FORMATS if splat_format.name == name), []
    for degree in (0, 1):
        write(folder / "seed", room(5, degree))
        found.append((folder / "seed").read_bytes())
    return found


def usd_seeds(folder: Path) -> list[bytes]:
    """Binary and text; the text as it is for a file of the suffix .usd, which may be either."""
    found = []
    for degree, suffix in ((0, ".usdc"), (1, ".usdc"), (1, ".usda")):
        write_scene(folder / f"seed{suffix}", room(3, degree))
        found.append((folder / f"seed{suffix}").read_bytes())
    return found


def ksplat_seeds(folder: Path) -> list[bytes]:
    """Each level of compression."""
    return [ksplat_of([room(3, 2), room(2, 2)], level, bucket=2) for level in range(3)]


def spz_seeds(folder: Path) -> list[bytes]:
    """Each version that is written; streams that are stored, so that changes reach what is in them."""
    found = []
    for version in (2, 3, 4):
        spz.write(folder / "seed", room(5, 1), version)
        found.append((folder / "seed").read_bytes())
    plain = gzip.compress(gzip.decompress(found[1]), 0)
    return [*found, plain]


def sog_seeds(folder: Path) -> list[bytes]:
    """Bundles by another program, without and with a palette; what is in them is stored, so changes reach
    it."""
    gaussforge, found = __import__("gaussforge"), []
    for degree in (0, 1):
        write_scene(folder / "seed.ply", room(5, degree))
        found.append(
            gaussforge.GaussForge().convert((folder / "seed.ply").read_bytes(), "ply", "sog")["data"]
        )
    return found


def ply_seeds(folder: Path) -> list[bytes]:
    """SH degrees 0 and 1; a file of doubles, an ASCII one, one with more elements."""
    found = splat_seeds("ply", folder)
    header, body = found[0].split(b"end_header\n")
    values = np.frombuffer(body, "<f4").reshape(5, -1)
    found.append(header.replace(b"float", b"double") + b"end_header\n" + values.astype("<f8").tobytes())
    found.append(
        header.replace(b"binary_little_endian", b"binary_big_endian")
        + b"end_header\n"
        + values.astype(">f4").tobytes()
    )
    text = io.BytesIO()
    np.savetxt(text, values, fmt="%.6g")
    found.append(header.replace(b"binary_little_endian", b"ascii") + b"end_header\n" + text.getvalue())
    more = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    return [*found, header + more + body + b"\3" + bytes(12)]


SEEDS = {"ply": ply_seeds, "spz": spz_seeds, "ksplat": ksplat_seeds, "sog": sog_seeds, "usd": usd_seeds}


def camera_entries(count: int = 2) -> list[dict]:
    """What 3DGS training writes for each view, and that it is perspective."""
    turn = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    sizes = {"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "orthographic": False}
    return [
        {"id": i, "img_name": f"{i:02}", "position": [0.1 * i, 0.0, -3.0], "rotation": turn, **sizes}
        for i in range(count)
    ]


def transforms_contents() -> list[dict]:
    """Pinholes as instant-ngp writes them, and a lens with distortion as Nerfstudio does."""
    pose = [[1.0, 0.0, 0.0, 0.1], [0.0, 0.0, -1.0, -3.0], [0.0, 1.0, 0.0, 0.2], [0.0, 0.0, 0.0, 1.0]]
    frames = [{"file_path": f"./images/{i:02}.png", "transform_matrix": pose} for i in range(2)]
    lens = dict(fl_x=60.0, fl_y=58.0, cx=31.0, cy=25.0, w=64, h=48, k1=-0.1, k2=0.02, p1=0.002, p2=-0.001)
    named = {"camera_model": "OPENCV", "applied_transform": pose[:3], "ply_file_path": "sparse_pc.ply"}
    return [
        {"camera_angle_x": 0.9, "w": 64, "h": 48, "frames": frames},
        {**named, "frames": [frame | lens for frame in frames]},
    ]


def colmap_folder(folder: Path, text: bool) -> Path:
    import pycolmap

    import tiny_dataset

    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL  # it tells of every refusal
    tiny_dataset.write_colmap(folder / "model", tiny_dataset.views(3), np.zeros((4, 3)))
    if text:
        (folder / "text").mkdir()
        pycolmap.Reconstruction(folder / "model").write_text(folder / "text")
    return folder / ("text" if text else "model")


def checkpoint_folder(folder: Path) -> Path:
    """A checkpoint's two files, as save() makes them."""
    import hashlib

    from svrgs_addon.finetune import checkpoint

    target = folder / "checkpoint"
    target.mkdir()
    np.savez(target / "arrays.npz", values=np.arange(7.0))
    digest = hashlib.sha256((target / "arrays.npz").read_bytes()).hexdigest()
    manifest = {
        "schema": checkpoint.SCHEMA,
        "identity": "x",
        "sha256": digest,
        "iteration": 3,
        "loss": 0.5,
        "curves": {"count": [1, 2]},
    }
    manifest["digest"] = checkpoint.text_digest(manifest)
    (target / "manifest.json").write_text(json.dumps(manifest))
    return target

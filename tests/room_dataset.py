"""A dataset of any size, for measuring: the room of the bench as a splat, photographs drawn from it, and
their COLMAP model.

.venv/bin/python -m tests.room_dataset DIR [--count N] [--views V]        writes DIR/scene.ply, DIR/images,
DIR/sparse/0
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from colmap_model import write_colmap
from svrgs_addon.files.images import write_image
from svrgs_addon.files.ply import write_ply
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_bench.scenes import orbit_camera, room

WIDTH, HEIGHT = 640, 360
POINTS = 10_000  # of the sparse model, at most


def write_room(folder: Path, count: int, views: int) -> None:
    """Views turn around the room; every one sees about half of its `count` Gaussians."""
    scene, rasterizer = room(count), Rasterizer()
    cameras = [
        replace(orbit_camera(WIDTH, HEIGHT, 360 * i / views), name=f"{i:03}.png") for i in range(views)
    ]
    for camera in cameras:
        write_image(folder / "images" / camera.name, rasterizer.forward(scene, camera)["rgb"])
    write_colmap(folder / "sparse" / "0", cameras, scene.means[:: max(1, count // POINTS)])
    write_ply(folder / "scene.ply", scene)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, metavar="DIR")
    parser.add_argument("--count", type=int, default=1_000_000, help="Gaussians (default: %(default)s)")
    parser.add_argument("--views", type=int, default=24, help="photographs (default: %(default)s)")
    options = parser.parse_args()
    write_room(options.out, options.count, options.views)


if __name__ == "__main__":
    main()

"""A picture of a splat before and after pruning, from a view of its dataset, with the spatial masks F of
both: for README.

python -m benchmarks.side_by_side BEFORE.ply AFTER.ply DATASET OUT.jpg [--view N] [--height PIXELS]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from svrgs_addon.files.atomic import atomic_path
from svrgs_addon.files.images import to_bytes
from svrgs_addon.files.registry import load_scene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render import color_maps
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.views.dataset import load_dataset

GAP, MARGIN, QUALITY = 6, 12, 88  # pixels, pixels, of JPEG in percent


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("before", "after", "dataset", "out"):
        words.add_argument(name, type=Path)
    words.add_argument("--view", type=int, default=0, help="number of the view in name order")
    words.add_argument("--height", type=int, default=480, help="height of each picture, pixels")
    given = words.parse_args()
    dataset = load_dataset(given.dataset)
    camera = dataset.cameras[given.view]
    camera = camera.resized(round(camera.width * given.height / camera.height), given.height)
    columns = []
    for name, path in (("Original", given.before), ("Pruned", given.after)):
        scene = load_scene(path)
        images = Rasterizer().forward(
            scene, camera, render_options(scene, mask_kind="svr"), outputs=("rgb", "mask")
        )
        columns.append((f"{name}: {scene.count:,} Gaussians, {path.stat().st_size / 1e6:.1f} MB", images))
    top = max(images["mask"].max() for _, images in columns)
    rows = [[labelled(to_bytes(images["rgb"]), text) for text, images in columns]]
    masks = [to_bytes(color_maps.colored(images["mask"], top)) for _, images in columns]
    rows.append(
        [labelled(mask, "Spatial mask F" + ", same scale" * number) for number, mask in enumerate(masks)]
    )
    write(given.out, np.concatenate([line(row) for row in rows]))


def line(images: list[np.ndarray]) -> np.ndarray:
    """Images (H, W, 3) uint8 beside each other, with gaps, and a gap below."""
    gap = np.full((images[0].shape[0], GAP, 3), 255, np.uint8)
    row = np.concatenate([part for image in images for part in (image, gap)][:-1], axis=1)
    return np.concatenate([row, np.full((GAP, row.shape[1], 3), 255, np.uint8)])


def labelled(image: np.ndarray, text: str) -> np.ndarray:
    """The image with white text, black edged, in its lower left corner."""
    picture = oiio.ImageBuf(np.ascontiguousarray(image))
    size = max(12, image.shape[0] // 22)
    oiio.ImageBufAlgo.render_text(
        picture, MARGIN, image.shape[0] - MARGIN, text, size, "", (1, 1, 1), shadow=2
    )
    return picture.get_pixels(oiio.UINT8)


def write(path: Path, image: np.ndarray):
    with atomic_path(path) as temporary:
        picture = oiio.ImageBuf(np.ascontiguousarray(image[:-GAP]))
        picture.specmod().attribute("Compression", f"jpeg:{QUALITY}")
        if not picture.write(str(temporary), oiio.UINT8, "jpeg"):
            raise SystemExit(f"{path}: cannot be written ({picture.geterror()})")


if __name__ == "__main__":
    main()

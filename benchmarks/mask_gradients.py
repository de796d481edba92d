"""The exact gradient of F in the masks, on a trained scene: how far the paper's self and occlusion terms
cancel on a ray, and how hard mean F^2 pushes with few and with many active masks (docs/methods.md, "Spatial
mask").

    .venv/bin/python benchmarks/mask_gradients.py SCENE.ply --data DATASET
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from svrgs_addon.files.registry import read_scene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.scene.camera import evenly
from svrgs_addon.views.dataset import load_dataset

VIEWS = 8
SHARES = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)  # of active masks
OPAQUE = 0.01  # transmittance below which a ray counts as opaque


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene")
    parser.add_argument("--data", required=True)
    options = parser.parse_args()
    scene, dataset = read_scene(options.scene), load_dataset(options.data, cameras_only=True)
    cameras = evenly(dataset.cameras, VIEWS)
    cancelled(scene, cameras)
    pushed(scene, cameras)


def cancelled(scene, cameras):
    """On rays whose transmittance is below OPAQUE and on the others: log(1 + N) dF/dM_i, mean of all hits. 1:
    the terms cancel."""
    sums = np.zeros((2, 3))  # opaque, other: gradients, hits, rays
    for camera in cameras:
        rasterizer, images = drawn(scene, camera)
        opaque = images["transmittance"] < OPAQUE
        for row, rays in enumerate((opaque, ~opaque)):
            weight = np.where(rays, np.log1p(images["hits"]), 0).astype(np.float32)
            gradients = rasterizer.backward({"mask": weight}, ["masks"])["masks"]
            sums[row] += gradients.sum(dtype=np.float64), images["hits"][rays].sum(), rays.sum()
    for name, (gradients, hits, rays) in zip(("opaque", "other"), sums, strict=True):
        print(
            f"{name} rays: {rays / sums[:, 2].sum():.1%} of the rays, {hits / rays:.1f} hits each;"
            f" log(1 + N) dF/dM: {gradients / hits:.4f}"
        )


def pushed(scene, cameras):
    """The mean gradient of mean F^2 in the mask of a hit, times the pixels of the view, by the share of
    active masks."""
    for share in SHARES:
        masks = (np.random.default_rng(0).random(scene.count) < share).astype(np.uint8)
        total = hits = 0.0
        for camera in cameras:
            rasterizer, images = drawn(scene, camera, masks)
            gradients = rasterizer.backward({"mask": 2 * images["mask"]}, ["masks"])["masks"]
            total, hits = total + gradients.sum(dtype=np.float64), hits + images["hits"].sum()
        print(f"{share:.0%} of the masks active: {total / hits:.3f} a hit")


def drawn(scene, camera, masks=None):
    rasterizer = Rasterizer()
    options = replace(render_options(scene, mask_kind="svr"))
    everything = ("rgb", "mask", "hits", "transmittance")
    images = rasterizer.forward(scene, camera, options, masks, outputs=everything)
    return rasterizer, {name: np.array(image) for name, image in images.items()}


if __name__ == "__main__":
    main()

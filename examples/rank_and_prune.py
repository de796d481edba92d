"""Keeps the half of a splat's Gaussians whose removal would cost most, without any training.

python examples/rank_and_prune.py scene.ply DATASET half.ply
"""

import sys

from svrgs_addon.files.registry import load_scene, write_scene
from svrgs_addon.finetune.saliency import removal_errors
from svrgs_addon.finetune.scores import top
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.metrics.evaluate import mean_quality, render_options
from svrgs_addon.views.dataset import load_dataset

splat, folder, out = sys.argv[1:]

scene, dataset, rasterizer = load_scene(splat), load_dataset(folder), Rasterizer()
options = render_options(scene, dataset.background)
cameras = [dataset.cameras[i] for i in dataset.train_indices]

# (N,): growth of the squared error without each Gaussian
score = removal_errors(ViewedScene(scene, cameras, rasterizer, options))
half = scene.select(top(score, scene.count // 2))
write_scene(out, half)

for name, part in (("all", scene), ("half", half)):
    psnr = mean_quality(part, dataset, dataset.test_indices, rasterizer, options)
    print(f"{name}: {part.count:,} Gaussians, PSNR {psnr:.2f} dB on {len(dataset.test_indices)} test views")

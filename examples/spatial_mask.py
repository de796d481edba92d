"""Draws a splat and its spatial mask F from one camera.

python examples/spatial_mask.py scene.ply colors.png mask.png
"""

import sys

from svrgs_addon.files.images import write_image
from svrgs_addon.files.registry import load_scene
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.prune.report.pictures import mask_to_rgb
from svrgs_bench.scenes import facing_camera

splat, colors, mask = sys.argv[1:]

# arrays as 3DGS stores them: means (N, 3), log_scales, quats, opacity_logits, sh
scene = load_scene(splat)
camera = facing_camera(scene, 640, 360)  # viewmat (4, 4) world to camera, K (3, 3) in pixels
images = Rasterizer().forward(scene, camera, RenderOptions(mask_kind="svr"), outputs=("rgb", "mask"))

write_image(colors, images["rgb"])  # (H, W, 3) display sRGB
write_image(mask, mask_to_rgb(images["mask"]))  # F (H, W): bright where a ray passes many Gaussians
print(f"{scene.count:,} Gaussians, mean F {images['mask'].mean():.3g}")

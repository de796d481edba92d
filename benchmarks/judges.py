"""What judges a smaller scene, or a file of it: the original on views from above, or photographs."""

from __future__ import annotations

from collections.abc import Callable
from statistics import fmean

from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.metrics import flip, psnr, ssim
from svrgs_addon.render.metrics.evaluate import evaluate, render_options, rounded_to_8_bits
from svrgs_addon.render.metrics.lpips import default_lpips
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.views.dataset import Dataset
from svrgs_addon.views.rig.around import cameras_around, middle_and_radius

VIEWS, SIDE = 50, 512
Judge = Callable[[Scene], tuple[float, float, float]]  # PSNR in dB, SSIM, and FLIP or LPIPS


def views_from_above(scene: Scene) -> list[Camera]:
    """VIEWS cameras on the upper half of the sphere, y down, nearer than those of the quick way and turned
    against them."""
    middle, _ = middle_and_radius(scene)
    cameras = cameras_around(scene, 2 * VIEWS, SIDE, turn=2.0, nearer=0.97)
    return [camera for camera in cameras if camera.position[1] < middle[1]]


def against_scene(original: Scene, cameras: list[Camera] | None = None) -> Judge:
    """PSNR, SSIM and FLIP against the original, means over the views; without any, from above."""
    rasterizer, options = Rasterizer(), render_options(original)
    cameras = cameras or views_from_above(original)

    def judge(scene: Scene) -> tuple[float, float, float]:
        rows = []
        for camera in cameras:
            images = [
                rounded_to_8_bits(rasterizer.forward(some, camera, options)["rgb"])
                for some in (scene, original)
            ]
            rows.append((psnr(*images), ssim(*images), flip(*images)))
        found = [fmean(column) for column in zip(*rows, strict=True)]
        return found[0], found[1], found[2]

    return judge


def against_photographs(dataset: Dataset) -> Judge:
    """PSNR, SSIM and LPIPS (make lpips), means over the test photographs of the dataset."""
    lpips = default_lpips()

    def judge(scene: Scene) -> tuple[float, float, float]:
        found = evaluate(scene, dataset, dataset.test_indices, Rasterizer(), lpips)
        return found["psnr"], found["ssim"], found["lpips"]

    return judge

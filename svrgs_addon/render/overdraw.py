"""What drawing costs where rays do not end early, as on the graphics card of a headset."""

from __future__ import annotations

from collections.abc import Sequence

from ..native.rasterizer import Rasterizer, RenderOptions
from ..scene.camera import Camera
from ..scene.gaussians import Scene


def overdraw(scene: Scene, cameras: Sequence[Camera]) -> float:
    """Gaussians that a pixel blends on average: N of the spatial mask (alpha >= 1/255), along whole rays."""
    rasterizer, options = (
        Rasterizer(),
        RenderOptions(antialiased=scene.antialiased, full=True, mask_kind="svr", picture_only=True),
    )
    hits = (rasterizer.forward(scene, camera, options, outputs=("hits",))["hits"] for camera in cameras)
    return sum(int(image.sum()) for image in hits) / sum(camera.width * camera.height for camera in cameras)

"""Forward time over the size of the image and over the number of Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions

from .cases import Case
from .scenes import orbit_camera, room
from .timing import rounds, seconds, summary
from .trial import drawn_masks

COUNT, SIZE = 500_000, (640, 360)  # number of Gaussians and image size while the other one is varied
SIZES = ((320, 180), (640, 360), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160))
COUNTS = (100_000, 250_000, 500_000, 1_000_000, 2_500_000, 5_000_000)


def measure_scaling(
    repeat: int, progress: Callable[[str], None], sizes=SIZES, counts=COUNTS, count=COUNT
) -> list[dict]:
    """The entry `scaling` of the result: over pixels with `count` Gaussians, and over Gaussians at image size
    SIZE."""
    entries = []
    for axis, case in _cases(sizes, counts, count):
        progress(
            f"scaling over {axis}: {case.scene.count:,} Gaussians, {case.camera.width} x {case.camera.height}"
        )
        entries.append({"axis": axis, **_measured(case, repeat)})
    return entries


def _cases(sizes, counts, count: int) -> Iterator[tuple[str, Case]]:
    scene = room(count)
    for size in sizes:
        yield "pixels", Case("room", scene, orbit_camera(*size))
    for count in counts:
        yield "gaussians", Case("room", room(count), orbit_camera(*SIZE))


def _measured(case: Case, repeat: int) -> dict:
    rasterizer = Rasterizer()
    masks, _ = drawn_masks(case.scene.count)
    options = RenderOptions(mask_kind="svr")
    arguments = case.scene, case.camera, options, masks, ("rgb", "mask")
    readings = rounds(lambda: {"forward": seconds(rasterizer.forward, *arguments)}, repeat)
    ms = summary(readings["forward"])["ms"]
    pixels = case.camera.width * case.camera.height
    return {
        "count": case.scene.count,
        "width": case.camera.width,
        "height": case.camera.height,
        "visible": len(rasterizer.visible()),
        "pixels": pixels,
        "forward_ms": ms,
        "ms_per_megapixel": ms / pixels * 1e6,
        "ms_per_million_gaussians": ms / case.scene.count * 1e6,
    }

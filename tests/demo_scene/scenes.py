"""The scenes that can be made, and the size each has if nothing else is asked for.

Each is a module of this package: `build(scene)` models it in an empty scene of Blender, `cameras(count)`
returns the poses.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """One scene's defaults and its camera."""

    about: str
    views: int
    width: int  # pixels
    aspect: tuple[int, int]  # width : height
    focal: float  # focal length in widths
    samples: int  # per pixel, before denoising
    points: int  # sparse points aimed at
    phone: bool = False  # photographs as a phone takes them: capture.py


SCENES = {
    "plaza": Kind("things in a paved yard, from all around", 60, 360, (4, 3), 0.9, 8, 5000),
    "room": Kind("a furnished room, from inside", 50, 360, (4, 3), 0.8, 12, 5000),
    "portrait": Kind(
        "a potted plant close up before a far background, taken with a phone",
        40,
        270,
        (9, 16),
        1.3,
        8,
        5000,
        phone=True,
    ),  # fmt: skip
    "row": Kind("a row of shops, from cameras that all look forward", 30, 360, (4, 3), 0.9, 12, 5000),
}

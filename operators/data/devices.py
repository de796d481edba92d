"""How many Gaussians devices show fluently: the goal Device. One table, to be changed as devices do."""

from __future__ import annotations

from typing import NamedTuple


class Device(NamedTuple):
    """A device, or a kind of viewer."""

    name: str
    gaussians: int  # that it shows fluently
    source: str  # who says so, and of what


DEVICES = {  # as of 2026
    "QUEST_3": Device("Quest 3", 400_000, "Reports of Unity at 72 frames per second"),
    "VISION_PRO": Device("Vision Pro", 400_000, "Reports of MetalSplatter at 90 frames per second"),
    "SPATIAL_SDK": Device("Meta Spatial SDK", 150_000, "The limit that Meta names"),
    "PHONE": Device("Phone, in the Web", 1_000_000, "What PlayCanvas names for phones"),
    "DESKTOP": Device("Desktop, in the Web", 3_000_000, "What PlayCanvas names for desktops"),
}

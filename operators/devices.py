"""How many Gaussians devices show fluently: the goal Device. One table, to be changed as devices do.

Sources: reports of developers and makers, 2025 and 2026: Unity on Quest 3 at 72 frames per second; MetalSplatter on Vision Pro at 90; the limit
that Meta names for its Spatial SDK; PlayCanvas on phones and desktops.
"""

DEVICES = {  # item of the menu: its name, the number of Gaussians
    "QUEST_3": ("Quest 3", 400_000),
    "VISION_PRO": ("Vision Pro", 400_000),
    "SPATIAL_SDK": ("Meta Spatial SDK", 150_000),
    "PHONE": ("Phone, in the Web", 1_000_000),
    "DESKTOP": ("Desktop, in the Web", 3_000_000),
}

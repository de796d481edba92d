"""Image metrics: PSNR (NumPy), SSIM and FLIP (the native library), and LPIPS (needs a weight file).

Each metric takes two arrays (H, W, 3), display sRGB in [0, 1], and raises SceneError if their shapes differ
or a value is not finite. Values are used as given. So a render must be clamped first, and rounded to 8 bits
where results are compared with published ones, because 3DGS measures saved PNG files (evaluate.py does both).
"""

from .lpips import Lpips, load_lpips
from .measures import flip, flip_map, psnr, ssim

__all__ = ["Lpips", "flip", "flip_map", "load_lpips", "psnr", "ssim"]

"""How alike two pictures are: PSNR, SSIM, FLIP (NumPy only) and LPIPS (needs torch and a weight file).

Every metric takes two (H, W, 3) arrays, display sRGB in [0, 1], and uses the values as given: clamp a render first, and
round it to 8 bits where a figure must be comparable with published ones (3DGS measures saved PNG files).
"""

from .flip import flip, flip_map
from .lpips import Lpips, load_lpips
from .psnr import psnr
from .ssim import ssim

__all__ = ["Lpips", "flip", "flip_map", "load_lpips", "psnr", "ssim"]

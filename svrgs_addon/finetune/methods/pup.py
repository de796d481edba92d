"""PUP 3D-GS (arXiv 2406.10219): ranks by sensitivity to position and size (../sensitivity.py). One cut; published with two."""

from ..sensitivity import log_determinants
from .ranked import Ranked


class PUP(Ranked):
    def score(self, scene, cameras, rasterizer, options):
        return log_determinants(scene, cameras, rasterizer, options)


METHODS = (PUP("pup", "PUP 3D-GS: ranks the Gaussians once, by the sensitivity of the images to their position and size", 17),)

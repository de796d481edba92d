"""PUP 3D-GS (arXiv 2406.10219): ranks by ../sensitivity.py. One cut; published with two."""

from ..sensitivity import log_determinants
from .ranked import Ranked


class PUP(Ranked):
    def score(self, scene, cameras, rasterizer, options):
        return log_determinants(scene, cameras, rasterizer, options)


METHODS = (
    PUP(
        "pup",
        "removes, in one cut, the Gaussians whose position and size change the photographs least",
        17,
        "PUP 3D-GS",
        source="PUP 3D-GS, arXiv 2406.10219",
    ),
)

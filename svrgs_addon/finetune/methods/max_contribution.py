"""Ranks by the largest alpha T in any pixel of any view (RadSplat, arXiv 2403.13806)."""

from .. import scores
from .ranked import Ranked


class MaxContribution(Ranked):
    def score(self, scene, cameras, rasterizer, options):
        return scores.contribution(scene, cameras, rasterizer, options)[1]


METHODS = (
    MaxContribution(
        "max-contribution",
        "removes, in one cut, the Gaussians that never add much to any pixel (largest αT)",
        16,
        "RadSplat",
        source="RadSplat",
    ),
)

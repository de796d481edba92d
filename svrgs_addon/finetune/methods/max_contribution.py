"""Ranks by the largest alpha T in any pixel of any view (RadSplat)."""

from .. import scores
from .ranked import Ranked


class MaxContribution(Ranked):
    def score(self, scene, cameras, rasterizer, options):
        return scores.contribution(scene, cameras, rasterizer, options)[1]


METHODS = (MaxContribution("max-contribution", "RadSplat: ranks the Gaussians once, by the largest αT in any pixel", 16),)

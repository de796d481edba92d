"""Ranks by contribution: sum of alpha T over all pixels of all views."""

from .. import scores
from .ranked import Ranked


class Contribution(Ranked):
    def score(self, scene, cameras, rasterizer, options):
        return scores.contribution(scene, cameras, rasterizer, options)[0]


METHODS = (Contribution("contribution", "ranks the Gaussians once, by the sum of αT over all views", 15),)

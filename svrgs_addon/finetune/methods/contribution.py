"""Ranks by contribution: the sum of alpha T over all pixels of all views."""

from .. import scores
from .ranked import Ranked


class Contribution(Ranked):
    def score(self, scene, cameras, rasterizer, options):
        return scores.contribution(scene, cameras, rasterizer, options)[0]


METHODS = (
    Contribution(
        "contribution",
        "removes, in one cut, the Gaussians that add least to the photographs (sum of αT)",
        15,
        "Contribution",
        source="common in the literature",
    ),
)

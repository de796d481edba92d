"""Ranks by contribution to the pixels of all views: by the sum of alpha T, or by its largest value (RadSplat,
arXiv 2403.13806)."""

from .. import scores
from .ranked import Ranked


class Contribution(Ranked):
    def score(self, scene, cameras, rasterizer, options):
        return scores.contribution(scene, cameras, rasterizer, options)[0]


class MaxContribution(Ranked):
    def score(self, scene, cameras, rasterizer, options):
        return scores.contribution(scene, cameras, rasterizer, options)[1]


METHODS = (
    Contribution(
        "contribution",
        "removes, in one cut, the Gaussians that add least to the photographs (sum of αT)",
        15,
        "Contribution",
        source="common in the literature",
    ),
    MaxContribution(
        "max-contribution",
        "removes, in one cut, the Gaussians that never add much to any pixel (largest αT)",
        16,
        "RadSplat",
        source="RadSplat",
    ),
)

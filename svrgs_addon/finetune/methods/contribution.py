"""Ranks by contribution to the pixels of all views: by the sum of alpha T, or by its largest value (RadSplat,
arXiv 2403.13806)."""

from ..scores import contribution
from .ranked import Ranked

METHODS = (
    Ranked(
        "contribution",
        "removes, in one cut, the Gaussians that add least to the photographs (sum of αT)",
        15,
        "Contribution",
        source="common in the literature",
        ranking=lambda viewed: contribution(viewed)[0],
    ),
    Ranked(
        "max-contribution",
        "removes, in one cut, the Gaussians that never add much to any pixel (largest αT)",
        16,
        "RadSplat",
        source="RadSplat, arXiv 2403.13806",
        ranking=lambda viewed: contribution(viewed)[1],
    ),
)

"""Ranks by opacity."""

from .ranked import Ranked

METHODS = (
    Ranked(
        "opacity",
        "removes, in one cut, the Gaussians of lowest opacity",
        14,
        "Opacity",
        source="common in the literature",
        ranking=lambda viewed: viewed.scene.opacity_logits,
    ),
)

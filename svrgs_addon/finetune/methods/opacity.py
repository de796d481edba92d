"""Ranks by opacity."""

from .ranked import Ranked


class Opacity(Ranked):
    def score(self, scene, cameras, rasterizer, options):
        return scene.opacity_logits


METHODS = (
    Opacity(
        "opacity",
        "removes, in one cut, the Gaussians of lowest opacity",
        14,
        "Opacity",
        source="common in the literature",
    ),
)

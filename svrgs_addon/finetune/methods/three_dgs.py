"""Plain 3DGS (Kerbl et al. 2023, arXiv 2308.04079). It prunes only what 3DGS itself prunes."""

from .base import Method

METHODS = (Method("3dgs", "plain 3DGS: prunes nothing beyond its own rules", 18, prunes=False),)

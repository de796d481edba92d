"""Plain 3DGS (Kerbl et al. 2023, arXiv 2308.04079). It prunes only what 3DGS itself prunes."""

from .base import Method

METHODS = (
    Method(
        "3dgs",
        "prunes nothing beyond the rules of plain 3DGS",
        18,
        "3DGS",
        prunes=False,
        source="3DGS, arXiv 2308.04079",
    ),
)

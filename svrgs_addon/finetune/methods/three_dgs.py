"""3DGS (Kerbl et al. 2023): nothing is pruned."""

from .base import Method

METHODS = (Method("3dgs", "plain 3DGS: nothing is pruned", 18, prunes=False),)

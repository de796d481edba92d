"""PUP 3D-GS (arXiv 2406.10219): ranks by ../sensitivity.py. One cut; published with two."""

from ..sensitivity import log_determinants
from .ranked import Ranked

METHODS = (
    Ranked(
        "pup",
        "removes, in one cut, the Gaussians whose position and size change the photographs least",
        17,
        "PUP 3D-GS",
        source="PUP 3D-GS, arXiv 2406.10219",
        ranking=log_determinants,
    ),
)

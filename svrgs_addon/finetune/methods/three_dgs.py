"""3DGS (Kerbl et al. 2023): the scene every other method starts from or grows beside."""

from __future__ import annotations

from dataclasses import dataclass

from .base import Method


@dataclass
class ThreeDGS(Method):
    """The defaults of Method; nothing is pruned."""

    prunes: bool = False

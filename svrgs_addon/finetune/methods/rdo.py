"""RDO-Gaussian (arXiv 2406.01597): its pruning mask alone, without its quantiser and its masks of SH degrees.
The mask is a gate on opacity and scale, as in Compact3DGS; without the quantiser each Gaussian costs the same
rate. It is removed once, after the optimisation."""

from ..run_view import Keep, RunView
from .compact3dgs import Compact3DGS


class RDO(Compact3DGS):
    def survivors(self, run: RunView) -> Keep:
        return None


METHODS = (
    RDO(
        "rdo",
        "learns a gate on opacity and scale and removes, once at the end, the Gaussians whose gate is closed",
        26,
        "RDO-Gaussian",
        source="RDO-Gaussian, arXiv 2406.01597",
    ),
)

"""SVR-GS (arXiv 2509.11116): lambda_F mean F^2 in place of a count of all masks; its scenarios A and B, and forms of its gradient."""

from __future__ import annotations

from dataclasses import dataclass

from .masked import Masked


@dataclass
class SVR(Masked):
    """The spatial mask F is rendered beside the colours; mask_kind says which F and which gradient."""

    mask_kind: str = "svr"
    lambda_f: float = 1e-4


# The paper's own form, whatever the default may become: exact gradient, F along the whole ray, lambda_F = 1e-4 from first to
# last, 10 draws at each densification and every 1000 steps after, and no first cut. `--paper` chooses it.
PAPER = SVR(mask_kind="svr", lambda_f=1e-4, first_cut=False)

VARIANTS = {
    "svr-mask": SVR(),  # the paper, after a first cut where the scene is a trained one
    "svr-self": SVR(mask_kind="self"),  # the paper's prose: dF/dM from the self term alone
    "svr-even": SVR(mask_kind="even"),  # each Gaussian's push scaled to one footprint, so that size does not matter
    "svr-a": SVR(mask_kind="a", lambda_f=1e-2),  # F_A is a share, at most 1: the same push needs a larger weight
    "svr-b": SVR(mask_kind="b"),
}

"""SVR-GS (arXiv 2509.11116): sampled masks and the term lambda_F mean F^2; its scenarios A and B; two other
gradients of F.

L = L_image + lambda_F mean F^2,   F = sum_i M_i (1 - alpha_i T_i) / log(1 + N)        (SVR-GS Eq. 5 and 10)
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from .masked import Masked

WEIGHT = "the weight of the spatial mask in the loss, as in the paper: λ_F mean F²"


@dataclass
class SVR(Masked):
    """The method. mask_kind chooses F and its gradient."""

    mask_kind: str = "svr"
    largest_strength: float = 10.0  # with more, the image loss no longer says which masks stay
    first_cut: bool = True  # no part of the paper; with a target it helps much (docs/methods.md)
    lambda_f: float = 1e-4
    lambda_f_help: str = field(default=WEIGHT, repr=False)


SVR_GS = SVR(
    "svr",
    "learns the probability that each Gaussian exists and penalises the spatial mask F, as in the paper",
    1,
    "SVR-GS (paper)",
    source="SVR-GS, arXiv 2509.11116",
    halved=59.0,
)

# The printed settings of the paper to the letter: L1 + (1 - SSIM) with weights 1 and 1, exact gradient, F
# along the whole ray, lambda_F = 1e-4 in every step, no first cut. Pruning events of 10 samples, at each
# densification and every 1000 steps after it, are the defaults of Settings and Phase. `--method svr --paper`
# chooses them; --method has no name for them.
PAPER = replace(SVR_GS, name="svr-paper", first_cut=False, image_weights=(1.0, 1.0))

METHODS = (  # svr-a has a larger lambda_F because its F is at most 1
    SVR_GS,
    SVR(
        "svr-self",
        "SVR-GS with another gradient of F: only the self term, as the prose of the paper says",
        2,
        "SVR-GS, Self Term",
        mask_kind="self",
        source="the prose of SVR-GS, arXiv 2509.11116",
    ),
    SVR(
        "svr-even",
        "SVR-GS with another gradient of F: the same for large and for small Gaussians",
        3,
        "SVR-GS, Even Footprint",
        mask_kind="even",
        source="this project",
    ),
    SVR(
        "svr-a",
        "SVR-GS with another F: scenario A of the paper, weights by inverse importance",
        4,
        "SVR-GS, Scenario A",
        mask_kind="a",
        lambda_f=1e-2,
        source="SVR-GS, arXiv 2509.11116, ablation",
    ),
    SVR(
        "svr-b",
        "SVR-GS with another F: scenario B of the paper, weights by accumulated opacity",
        5,
        "SVR-GS, Scenario B",
        mask_kind="b",
        source="SVR-GS, arXiv 2509.11116, ablation",
    ),
)

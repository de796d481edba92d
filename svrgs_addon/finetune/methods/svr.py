"""SVR-GS (arXiv 2509.11116): masks are sampled, and the loss gains lambda_F mean F^2; its scenarios A and B, and other gradients of F.

L = L_rgb + lambda_F mean_x F(x)^2,   F = sum_i M_i (1 - alpha_i T_i) / log(1 + N)        (paper Eq. 5 and 10)
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from .masked import Masked

WEIGHT = "weight of the spatial mask in the loss, as in the paper: λ_F mean F²"


@dataclass
class SVR(Masked):
    """mask_kind says which F and which gradient."""

    mask_kind: str = "svr"
    lambda_f: float = 1e-4
    lambda_f_help: str = field(default=WEIGHT, repr=False)


SVR_GS = SVR(
    "svr", "samples a mask per Gaussian and penalises the spatial mask: SVR-GS as in its paper, with the weights 0.8 L1 + 0.2 (1 − SSIM)", 1, "SVR-GS (paper)"
)

# The paper's printed settings to the letter; `--method svr --paper` chooses them, they have no name of their own on the command line:
# L1 + (1 - SSIM) with weights of 1, exact gradient, F along the whole ray, lambda_F = 1e-4 all the time, no first cut. 10 draws at each
# densification and every 1000 steps after it are the defaults of Settings and Phase.
PAPER = replace(SVR_GS, name="svr-paper", first_cut=False, image_weights=(1.0, 1.0))

METHODS = (
    SVR_GS,
    SVR("svr-self", "SVR-GS with the self term of the gradient alone: ∂F/∂M = 1 − αT, the prose of the paper", 2, mask_kind="self"),
    SVR("svr-even", "SVR-GS with each Gaussian's gradient scaled to one footprint, so that size does not matter", 3, mask_kind="even"),
    SVR("svr-a", "SVR-GS, scenario A of the paper: masks weighted by inverse importance", 4, mask_kind="a", lambda_f=1e-2),  # F_A <= 1 needs more
    SVR("svr-b", "SVR-GS, scenario B of the paper: masks weighted by cumulative transmittance", 5, mask_kind="b"),
)

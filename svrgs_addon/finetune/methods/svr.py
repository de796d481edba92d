"""SVR-GS (arXiv 2509.11116): sampled masks and the term lambda_F mean F^2; its scenarios A and B; two other gradients of F.

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
    lambda_f: float = 1e-4
    lambda_f_help: str = field(default=WEIGHT, repr=False)


SVR_GS = SVR("svr", "SVR-GS as in its paper, with 0.8 L1 + 0.2 (1 − SSIM): samples one mask per Gaussian and penalises the spatial mask F", 1, "SVR-GS (paper)")

# The printed settings of the paper to the letter: L1 + (1 - SSIM) with weights 1 and 1, exact gradient, F along the whole ray,
# lambda_F = 1e-4 in every step, no first cut. Pruning events of 10 samples, at each densification and every 1000 steps after it, are the
# defaults of Settings and Phase. `--method svr --paper` chooses them; --method has no name for them.
PAPER = replace(SVR_GS, name="svr-paper", first_cut=False, image_weights=(1.0, 1.0))

METHODS = (
    SVR_GS,
    SVR("svr-self", "SVR-GS with another gradient: only the self term, ∂F/∂M = (1 − αT) / log(1 + N), as the prose of the paper says", 2, mask_kind="self"),
    SVR("svr-even", "SVR-GS with another gradient: scaled to the same footprint for every Gaussian, so that size does not matter", 3, mask_kind="even"),
    SVR("svr-a", "SVR-GS, scenario A of the paper: F weights masks by inverse importance", 4, mask_kind="a", lambda_f=1e-2),  # larger because F is at most 1
    SVR("svr-b", "SVR-GS, scenario B of the paper: F weights masks by 1 − T, T the cumulative transmittance", 5, mask_kind="b"),
)

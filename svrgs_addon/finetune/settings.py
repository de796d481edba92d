"""Every number of a run, with the published defaults (3DGS, MaskGaussian, SVR-GS, LightGaussian recovery)."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import SceneError


@dataclass(frozen=True)
class Method:
    """What makes one pruning method differ from the others."""

    mask_kind: str = "none"  # spatial mask and gradient: a name of native.MASK_KINDS
    learns_masks: bool = False
    lambda_f: float = 0.0  # weight of mean F^2
    lambda_m: float = 0.0  # weight of (mean M)^2
    score: str = ""  # ranks Gaussians once instead of learning masks


METHODS = {
    "svr": Method("svr", True, lambda_f=1e-4),
    "svr-self": Method("self", True, lambda_f=1e-4),  # the paper's prose: dF/dM from the self term alone
    "svr-even": Method("even", True, lambda_f=1e-4),  # each Gaussian's push scaled to one footprint, so that size does not matter
    "svr-a": Method("a", True, lambda_f=1e-2),  # F_A is a share, at most 1: the same push needs a larger weight
    "svr-b": Method("b", True, lambda_f=1e-4),
    "maskgs": Method(learns_masks=True, lambda_m=5e-4),
    "3dgs": Method(),
    "opacity": Method(score="opacity"),
    "contribution": Method(score="contribution"),
}


@dataclass(frozen=True)
class Rates:
    """Learning rates of one phase. Position rates are per unit of extent, log-linear from first to last (3DGS)."""

    position_first: float = 1.6e-4
    position_last: float = 1.6e-6
    position_steps: int = 30_000
    sh: float = 2.5e-3  # degree 0
    sh_rest: float = 2.5e-3 / 20
    opacity: float = 0.05
    scale: float = 5e-3
    rotation: float = 1e-3
    mask: float = 0.02  # of one logit: MaskGaussian's 0.01 on a pair of scores
    decay: float = 1.0  # of all but the position rate, every decay_every steps
    decay_every: int = 400

    def at(self, step: int, extent: float) -> dict[str, float]:
        """Rates of step 1, 2, ... of the phase, by parameter name; 'sh_rest' beside 'sh'."""
        t = min(step / self.position_steps, 1.0)
        position = self.position_first ** (1 - t) * self.position_last**t * extent
        share = self.decay ** (step // self.decay_every)
        return {
            "means": position,
            "log_scales": self.scale * share,
            "quats": self.rotation * share,
            "opacity_logits": self.opacity * share,
            "sh": self.sh * share,
            "sh_rest": self.sh_rest * share,
            "mask_logits": self.mask * share,
        }


@dataclass(frozen=True)
class Densify:
    """3DGS densification: clone, split, prune, opacity reset."""

    start: int = 500
    until: int = 15_000
    every: int = 100
    reset_every: int = 3_000
    gradient: float = 2e-4  # mean norm of dL/d(projected centre), in units of half the image
    small: float = 0.01  # clone up to this share of the extent, split above
    split_into: int = 2
    split_shrink: float = 1.6
    min_opacity: float = 0.005
    max_scale: float = 0.1  # of the extent, after the first opacity reset


@dataclass(frozen=True)
class Phase:
    """A stretch of iterations under one set of rules."""

    name: str
    steps: int
    rates: Rates
    densify: Densify | None = None
    masks: bool = False
    prune_every: int = 1_000  # 10-draw pruning events, outside densification
    sh_every: int = 0  # raise the SH degree every so many steps; 0: all bands from the start
    coarse_until: int = 0  # steps up to this one look at reduced photographs
    coarse_factor: int = 2  # pixels a side that become one at first, a power of 2; halved in equal stretches

    def reduction(self, number: int) -> int:
        """Pixels a side that step `number` (from 1) sees as one."""
        if number > self.coarse_until:
            return 1
        return self.coarse_factor >> (number - 1) * (self.coarse_factor.bit_length() - 1) // self.coarse_until


@dataclass(frozen=True)
class Settings:
    """One whole run."""

    method: str
    phases: tuple[Phase, ...]
    lambda_f: float = 0.0
    lambda_m: float = 0.0
    full: bool = True  # F walks each ray to its end
    mask_to_shape: bool = False
    seed: int = 0
    mask_init: float = 9.0
    draws: int = 10
    drop_settled: bool = False  # do not wait for an event to prune what has all but ceased to exist (benchmarks/jobs.py: not worth it)
    views_by_loss: bool = False  # show the views with the lower loss every other epoch only
    spatial_order: bool = True  # Gaussians that lie together in space lie together in memory: the same work, done faster
    l1_weight: float = 0.8
    ssim_weight: float = 0.2
    min_contribution: float = 0.0  # before all else, drop what never reaches this alpha T in a training view
    target: int = 0  # Gaussians to keep at the end of the mask phase; 0: whatever survives
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def total(self) -> int:
        return sum(phase.steps for phase in self.phases)

    def at(self, iteration: int) -> tuple[Phase, int]:
        """The phase of iteration 0, 1, ... of the run, and its step's number within it (from 1)."""
        number = iteration + 1
        for phase in self.phases:
            if number <= phase.steps:
                return phase, number
            number -= phase.steps
        raise IndexError("the run is finished")


def method_named(name: str) -> Method:
    if name not in METHODS:
        raise SceneError(f"method '{name}' is unknown; choose one of {', '.join(METHODS)}")
    return METHODS[name]


def recovery_phase(steps: int, position_first: float = 5e-6) -> Phase:
    """LightGaussian's recovery: the plain 3DGS loss, nothing added, nothing pruned, rates fading."""
    return Phase("recover", steps, Rates(position_first=position_first, position_steps=max(steps, 1), decay=0.95))


def weights(method: str, lambda_f: float | None) -> dict:
    m = method_named(method)
    if lambda_f is not None and m.mask_kind == "none":
        raise SceneError(f"method '{method}' has no spatial mask to weigh: leave lambda-f out, or use an svr method")
    return {"method": method, "lambda_f": m.lambda_f if lambda_f is None else lambda_f, "lambda_m": m.lambda_m}


def train_settings(
    method: str, iterations: int, recovery: int, *, lambda_f: float | None = None, densify: Densify = Densify(), coarse_until: int = 0, **rest
) -> Settings:
    """`svrgs train`: 3DGS from the sparse points, masks learned along the way where the method has them."""
    masks = method_named(method).learns_masks
    phases = [Phase("train", iterations, Rates(), densify, masks, sh_every=1_000, coarse_until=coarse_until)]
    if recovery:
        phases.append(recovery_phase(recovery, Rates().at(iterations, 1.0)["means"]))
    return Settings(phases=tuple(phases), **weights(method, lambda_f), **rest)


def prune_settings(method: str, iterations: int, recovery: int, *, lambda_f: float | None = None, prune_every: int = 500, **rest) -> Settings:
    """`svrgs prune`: masks on an already trained scene, then recovery. Score methods skip the first phase."""
    phases = []
    if method_named(method).learns_masks and iterations:
        phases.append(Phase("prune", iterations, Rates(position_first=5e-6, position_steps=iterations), masks=True, prune_every=prune_every))
    if recovery:
        phases.append(recovery_phase(recovery))
    return Settings(phases=tuple(phases), **weights(method, lambda_f), **rest)



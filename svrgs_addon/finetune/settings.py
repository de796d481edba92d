"""Every number of a run, with the published defaults (3DGS, MaskGaussian, SVR-GS, LightGaussian recovery)."""

from __future__ import annotations

from dataclasses import dataclass


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

    @classmethod
    def within(cls, iterations: int, until: int | None = None) -> Densify:
        """Of a run of so many iterations: until half of them, as published for 30 000, so that what was added is learned too."""
        return cls(until=min(cls.until, iterations // 2) if until is None else until)


MAX_DROPOUT = 0.3  # share of the Gaussians


@dataclass(frozen=True)
class Phase:
    """A stretch of iterations under one set of rules."""

    name: str
    steps: int
    rates: Rates
    densify: Densify | None = None
    active: bool = False  # the method takes part: it learns masks or presses opacities, and decides in the end what stays
    prune_every: int = 1_000  # its pruning events, outside densification; 0: none
    sh_every: int = 0  # raise the SH degree every so many steps; 0: all bands from the start
    dropout: float = 0.0  # times 1 / training views: share of the Gaussians that a step leaves out, in the first 4/5 of the steps
    coarse_until: int = 0  # steps up to this one look at reduced photographs
    coarse_factor: int = 2  # pixels a side that become one at first, a power of 2; halved in equal stretches
    label: str = ""  # what happens in it, for people

    def dropout_rate(self, number: int, views: int) -> float:
        """The probability with which step `number` (from 1) leaves a Gaussian out. With few training `views` it keeps the scene from fitting
        those alone."""
        return min(MAX_DROPOUT, self.dropout / views) if 5 * number <= 4 * self.steps else 0.0

    def reduction(self, number: int) -> int:
        """Pixels a side that step `number` (from 1) sees as one."""
        if number > self.coarse_until:
            return 1
        return self.coarse_factor >> (number - 1) * (self.coarse_factor.bit_length() - 1) // self.coarse_until


@dataclass(frozen=True)
class Settings:
    """One whole run, but for its method (plan.Plan)."""

    phases: tuple[Phase, ...]
    lambda_f: float = 0.0  # weight of mean F^2
    lambda_m: float = 0.0  # of the method's term of all masks
    full: bool = True  # F walks each ray to its end
    seed: int = 0
    mask_init: float = 9.0
    draws: int = 10
    views_by_loss: bool = False  # show the views with the lower loss every other epoch only
    spatial_order: bool = True  # Gaussians that lie together in space lie together in memory: the same work, done faster
    l1_weight: float = 0.8
    ssim_weight: float = 0.2
    min_contribution: float = 0.0  # before all else, drop what never reaches this alpha T in a training view
    target: int = 0  # Gaussians to keep when the method decides; 0: whatever survives
    share: float = 0.0  # instead of a target: of the Gaussians there are once densification has ended
    max_drop: float = 0.0  # instead of a target: dB that may be lost in the end, on a few training views
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def prunes(self) -> bool:
        """Whether the method takes part in some steps."""
        return any(phase.active and phase.steps for phase in self.phases)

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


def recovery_phase(steps: int, position_first: float = 5e-6) -> Phase:
    """LightGaussian's recovery: the plain 3DGS loss, nothing added, nothing pruned, rates fading."""
    rates = Rates(position_first=position_first, position_steps=max(steps, 1), decay=0.95)
    return Phase("recover", steps, rates, label="Recovering the quality")

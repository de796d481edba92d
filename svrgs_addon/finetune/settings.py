"""All settings of a run. The defaults are the published ones (3DGS, MaskGaussian, SVR-GS; LightGaussian for
the recovery)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import sqrt
from typing import ClassVar

# a run of fewer steps S takes larger ones: sqrt(12 800 / S) times the rates of 3DGS, but at most
USUAL_STEPS = 12_800
LARGEST, LARGEST_OF_POSITION = 4.0, 2.0
SAMPLES = 16  # values in an average


@dataclass(frozen=True)
class Rates:
    """Learning rates of one phase, for Adam. The position rate is log-linear from first to last and is
    multiplied by the extent (3DGS)."""

    position_first: float = 1.6e-4
    position_last: float = 1.6e-6
    position_steps: int = 30_000
    sh: float = 2.5e-3  # degree 0
    sh_rest: float = 2.5e-3 / 20
    opacity: float = 0.05
    scale: float = 5e-3
    rotation: float = 1e-3
    mask: float = 0.02  # of one existence logit; the same steps as MaskGaussian's 0.01 on a pair of scores
    decay: float = 1.0  # factor on all rates but that of position, every decay_every steps
    decay_every: int = 400

    def at(self, step: int, extent: float) -> dict[str, float]:
        """Rates of step 1, 2, ... by parameter; 'sh' is that of SH degree 0, 'sh_rest' of higher ones."""
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


def rates_for(steps: int, rates: Rates) -> Rates:
    """`rates` with those rates of position (the first), scale, rotation and SH that a run of so many steps
    needs to get as far: those with which 3DGS begins, and the larger, the fewer steps there are. Calling it
    again changes nothing."""
    usual, larger = Rates(), min(max(sqrt(USUAL_STEPS / max(steps, 1)), 1.0), LARGEST)
    others = {name: larger * getattr(usual, name) for name in ("scale", "rotation", "sh", "sh_rest")}
    return replace(rates, position_first=usual.position_first * min(larger, LARGEST_OF_POSITION), **others)


@dataclass(frozen=True)
class Densify:
    """Densification of 3DGS (section 5.2): clone, split, prune, opacity reset; steps are the phase's."""

    start: int = 500
    until: int = 15_000
    every: int = 100
    reset_every: int = 3_000
    gradient: float = 2e-4  # least mean norm of dL/d(projected centre), in units of half the image
    small: float = 0.01  # share of the extent: Gaussians up to this size are cloned, larger ones are split
    split_into: int = 2
    split_shrink: float = 1.6
    min_opacity: float = 0.005
    max_scale: float = 0.1  # share of the extent; applied after the first opacity reset
    INITIAL: ClassVar = (0.1, 1.0)  # of a sparse point: opacity; size, times the distance to its neighbours

    @classmethod
    def within(cls, iterations: int, until: int | None = None) -> Densify:
        """Densification of a run of so many iterations. It ends after half of them, at most at step 15 000,
        so that new Gaussians are trained too, and begins in the first third of that time. Published for 30
        000 iterations: 500 to 15 000. until: the last step instead."""
        until = min(cls.until, iterations // 2) if until is None else until
        return cls(start=min(cls.start, until // 3), until=until)


@dataclass(frozen=True)
class MCMC(Densify):
    """Densification of 3DGS-MCMC (arXiv 2404.09591): relocation, growth up to a cap, noise and two penalties.
    Of the rules of 3DGS only the steps `start`, `until`, `every` and `min_opacity` count."""

    until: int = 25_000
    cap: int = 0  # Gaussians up to which the scene grows
    growth: float = 1.05  # most by which a densification multiplies the number of Gaussians
    noise: float = 5e5  # noise of the positions, over their learning rate
    opacity_weight: float = 0.01  # of the mean opacity in the loss
    scale_weight: float = 0.01  # of the mean scale in the loss
    INITIAL: ClassVar = (0.5, 0.1)

    @classmethod
    def capped(cls, cap: int, iterations: int, until: int | None = None) -> MCMC:
        """It ends after 5/6 of the iterations, at most at step 25 000. until: the last step instead."""
        until = min(cls.until, iterations * 5 // 6) if until is None else until
        return cls(start=min(cls.start, until // 3), until=until, cap=cap)


@dataclass(frozen=True)
class Phase:
    """A part of a run, with its own rates and rules."""

    name: str
    steps: int
    rates: Rates
    densify: Densify | None = None
    # the method takes part in the steps, and decides at the end of the phase which Gaussians stay
    active: bool = False
    prune_every: int = 1_000  # steps between pruning events, outside densification; 0: no events
    sh_every: int = 0  # the SH degree rises by 1 every so many steps; 0: all bands from the start
    coarse_until: int = 0  # steps up to this one use reduced photographs
    # reduction of the first steps, per side, a power of 2; it is halved after equal numbers of steps
    coarse_factor: int = 2
    # share of the steps, the last ones, over which the values are averaged (averaging.py)
    averaged: float = 0.0
    # what happens in the phase, as shown to users; not part of a checkpoint's identity
    label: str = field(default="", repr=False)

    def reduction(self, number: int) -> int:
        """Reduction of the photographs, per side, in step `number` (from 1)."""
        if number > self.coarse_until:
            return 1
        return self.coarse_factor >> (number - 1) * (self.coarse_factor.bit_length() - 1) // self.coarse_until

    def samples(self, number: int) -> bool:
        """Whether step `number` (from 1) counts in the average: about SAMPLES do, the last among them."""
        left, averaged = self.steps - number, round(self.averaged * self.steps)
        return left < averaged and left % max(1, averaged // SAMPLES) == 0


@dataclass(frozen=True)
class Settings:
    """All settings of a run except its method, which plan.Plan adds."""

    phases: tuple[Phase, ...]
    lambda_f: float = 0.0  # weight of mean F^2
    lambda_m: float = 0.0  # weight of the method's term over all masks or opacities
    full: bool = True  # F counts every hit of a ray; False: only up to where the colours stop
    seed: int = 0
    mask_init: float = 9.0  # existence logit at the start
    draws: int = 10  # samples at a pruning event
    views_by_loss: bool = False  # views of low loss are shown in every other epoch only
    # rows are kept in Morton order: Gaussians near in space are near in memory, which is faster
    spatial_order: bool = True
    l1_weight: float = 0.8  # of the mean absolute error
    ssim_weight: float = 0.2  # of 1 - SSIM
    # first cut: Gaussians whose alpha T stays below this in every pixel of every training view are removed
    min_contribution: float = 0.0
    target: int = 0  # Gaussians to keep when the method decides; 0: no target
    share: float = 0.0  # instead of a target: share of the Gaussians that exist when densification has ended
    # share of the Gaussians down to which smaller numbers are trained too (nested.py); 0: none
    nested: float = 0.0
    sh_degree: int = 3  # at most, of the Gaussians from the first step on
    # instead of a target: what may be lost at the end, on a few views (quality.py), and what it is counted
    # in, a key of render.metrics.allowed_loss.MEASURES
    max_loss: float = 0.0
    measure: str = "psnr"
    # whether each photograph has an exposure that is fitted (exposure.py): "on", "off", or "auto" until the
    # photographs were compared with the splat
    exposure: str = "off"
    refine_poses: str = "off"  # the same for the poses of the photographs (poses.py)
    mask_distractors: bool = False  # what stands in one photograph alone does not count there
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # rows of the source, from and to, that the result is about (RunView.own). None: all
    own: tuple[int, int] | None = field(default=None, repr=False)

    @property
    def prunes(self) -> bool:
        """Whether the method takes part in any step."""
        return any(phase.active and phase.steps for phase in self.phases)

    @property
    def total(self) -> int:
        return sum(phase.steps for phase in self.phases)

    def averaged_count(self, count: int) -> int:
        """The number of Gaussians whose values will be averaged, of `count` in the run; `count` if it is not
        known how many stay. 0 if none are."""
        if any(phase.averaged for phase in self.phases):
            return self.target or round(self.share * count) or count
        return 0

    def at(self, iteration: int) -> tuple[Phase, int]:
        """The phase of iteration 0, 1, ... of the run, and the number of the step in this phase (from 1).
        Raises IndexError after the last one."""
        number = iteration + 1
        for phase in self.phases:
            if number <= phase.steps:
                return phase, number
            number -= phase.steps
        raise IndexError("the run is finished")


def recovery_phase(steps: int, position_first: float = 5e-6) -> Phase:
    """The recovery of LightGaussian: the plain 3DGS loss; nothing is added or pruned; all rates but that of
    position decay by 0.95 every 400 steps."""
    rates = Rates(position_first=position_first, position_steps=max(steps, 1), decay=0.95)
    return Phase("recover", steps, rates, label="Recovering the quality")

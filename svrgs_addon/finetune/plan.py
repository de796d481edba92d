"""The plan of a run: its method and all settings, made from a request. The method defines the phases."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..system.errors import SceneError
from .methods.base import Method
from .settings import Densify, Phase, Settings


@dataclass(frozen=True, kw_only=True)
class Plan(Settings):
    """The settings of a run and its method. Each run works on a copy of the method."""

    method: Method


def train_plan(
    method: Method,
    iterations: int,
    recovery: int,
    *,
    densify: Densify | None = None,
    coarse_until: int = 0,
    schedule: float = 1.0,
    target: int = 0,
    share: float = 0.0,
    **rest,
) -> Plan:
    """The plan of `svrgs train`, which starts from sparse points. share: share of the Gaussians that exist
    when densification ends; it replaces a target. rest: as of _plan(). Raises SceneError."""
    phases = method.train_phases(iterations, recovery, densify or Densify(), coarse_until)
    share = share or (0.0 if target else method.share)
    return _plan(method, scaled(phases, schedule), False, target=target, share=share, **rest)


def prune_plan(
    method: Method, iterations: int, recovery: int, *, prune_every: int = 500, schedule: float = 1.0, **rest
) -> Plan:
    """The plan of `svrgs prune`, which starts from a trained scene. Methods that rank have no phase before
    the recovery. rest: as of _plan(). Raises SceneError."""
    phases = method.prune_phases(iterations, recovery, prune_every)
    return _plan(method, scaled(phases, schedule), True, **rest)


def _plan(
    method: Method,
    phases: list[Phase],
    trained: bool,
    *,
    lambda_f: float | None = None,
    lambda_m: float | None = None,
    **rest,
) -> Plan:
    """lambda_f, lambda_m: None takes the method's own weight. rest: further settings. Raises SceneError for a
    weight that the method lacks."""
    own = dict(zip(("lambda_f", "lambda_m"), method.weights(trained), strict=True))
    if lambda_f is not None and not method.lambda_f:
        raise SceneError(
            f"method '{method.name}' has no spatial mask: leave lambda-f out, or use removal, saliency or an"
            " svr method"
        )
    if lambda_m is not None and not own["lambda_m"]:
        raise SceneError(
            f"method '{method.name}' has no term with the weight lambda-m: leave it out, or use maskgs,"
            " compact3dgs, rdo, reduced3dgs or gns"
        )
    given = {"lambda_f": lambda_f, "lambda_m": lambda_m}
    own |= {name: value for name, value in given.items() if value is not None}
    l1_weight, ssim_weight = method.image_weights
    own |= {"l1_weight": l1_weight, "ssim_weight": ssim_weight, "mask_init": method.mask_init}
    return Plan(method=method, phases=tuple(method.paced(phases)), **own | rest)


def at_schedule(plan: Plan, share: float) -> Plan:
    """The plan with all step counts multiplied by `share`: that of the same request with schedule=share.
    plan: one with schedule=1."""
    return replace(plan, phases=tuple(plan.method.paced(scaled(list(plan.phases), share))))


def scaled(phases: list[Phase], share: float) -> list[Phase]:
    """The phases with all step counts multiplied by `share`. The rate of the masks is divided by `share`, so
    that logits still change by the same amount in the whole phase. The weights of the loss stay: they trade
    quality against count, whatever the number of steps."""
    if share == 1:
        return phases
    steps = lambda n: max(1, round(n * share)) if n else 0
    return [
        replace(
            p,
            steps=steps(p.steps),
            prune_every=steps(p.prune_every),
            sh_every=steps(p.sh_every),
            coarse_until=steps(p.coarse_until),
            densify=p.densify and _scaled_densify(p.densify, steps),
            rates=replace(
                p.rates,
                position_steps=steps(p.rates.position_steps),
                decay_every=steps(p.rates.decay_every),
                mask=p.rates.mask / share,
            ),
        )
        for p in phases
    ]


def _scaled_densify(d: Densify, steps) -> Densify:
    """Densification for a shorter schedule: it starts and ends earlier. The steps between two densifications
    and between two opacity resets do not shrink, because gradients must be averaged over as many views and
    opacities need as many steps to recover."""
    every, until = max(d.every, steps(d.every)), steps(d.until)
    reset_every = max(1, round(max(d.reset_every, steps(d.reset_every)) / every)) * every
    return replace(
        d,
        start=min(max(d.start, steps(d.start)), until // 3),
        until=until,
        every=every,
        reset_every=reset_every,
    )

"""From a request to the settings of a run: the phases are the method's own."""

from __future__ import annotations

from dataclasses import replace

from ..errors import SceneError
from .methods import method_named
from .methods.base import Method
from .settings import Densify, Phase, Settings


def train_settings(
    method: str, iterations: int, recovery: int, *, lambda_f: float | None = None, lambda_m: float | None = None,
    densify: Densify = Densify(), coarse_until: int = 0, target: int = 0, share: float = 0.0, schedule: float = 1.0, **rest,
) -> Settings:  # fmt: skip
    """`svrgs train`: from the sparse points. share: of the Gaussians there are when densification ends, instead of a target."""
    m = method_named(method)
    phases = scaled(m.train_phases(iterations, recovery, densify, coarse_until), schedule)
    share = share or (0.0 if target else m.share)
    return Settings(method, tuple(phases), mask_init=m.mask_init, target=target, share=share, **weights(m, method, False, lambda_f, lambda_m), **rest)


def prune_settings(
    method: str, iterations: int, recovery: int, *, lambda_f: float | None = None, lambda_m: float | None = None,
    prune_every: int = 500, schedule: float = 1.0, **rest,
) -> Settings:  # fmt: skip
    """`svrgs prune`: on an already trained scene, then recovery. Methods that rank skip the first phase."""
    if rest.get("max_drop"):
        method = method_named(method).drop_held_by or method
    m = method_named(method)
    phases = scaled(m.prune_phases(iterations, recovery, prune_every), schedule)
    return Settings(method, tuple(phases), mask_init=m.mask_init, **weights(m, method, True, lambda_f, lambda_m), **rest)


def scaled(phases: list[Phase], share: float) -> list[Phase]:
    """The phases with their milestones at `share` of their steps, and masks that learn 1/share times as fast, so that their logits
    come as far. Weights of the loss stay: they say what a Gaussian is worth, not when.
    """
    if share == 1:
        return phases
    steps = lambda n: max(1, round(n * share)) if n else 0  # noqa: E731
    return [
        replace(
            p, steps=steps(p.steps), prune_every=steps(p.prune_every), sh_every=steps(p.sh_every), coarse_until=steps(p.coarse_until),
            densify=p.densify and _scaled_densify(p.densify, steps),
            rates=replace(p.rates, position_steps=steps(p.rates.position_steps), decay_every=steps(p.rates.decay_every), mask=p.rates.mask / share),
        )
        for p in phases
    ]  # fmt: skip


def _scaled_densify(d: Densify, steps) -> Densify:
    """Densification begins and ends sooner, but takes as many views as ever to see where the image pulls, and opacities as long to return."""
    every, until = max(d.every, steps(d.every)), steps(d.until)
    reset_every = max(1, round(max(d.reset_every, steps(d.reset_every)) / every)) * every
    return replace(d, start=min(max(d.start, steps(d.start)), until // 3), until=until, every=every, reset_every=reset_every)


def weights(m: Method, name: str, trained: bool, lambda_f: float | None, lambda_m: float | None) -> dict[str, float]:
    """The weights asked for, or else the method's own. Raises SceneError for one the method does not have."""
    own = dict(zip(("lambda_f", "lambda_m"), m.weights(trained), strict=True))
    if lambda_f is not None and not m.lambda_f:
        raise SceneError(f"method '{name}' has no spatial mask to weigh: leave lambda-f out, or use an svr method")
    if lambda_m is not None and not own["lambda_m"]:
        raise SceneError(f"method '{name}' has no term that lambda-m weighs: leave it out, or use maskgs, compact3dgs or gns")
    return own | {key: value for key, value in (("lambda_f", lambda_f), ("lambda_m", lambda_m)) if value is not None}

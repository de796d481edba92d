"""From a request to the settings of a run: the phases are the method's own."""

from __future__ import annotations

from ..errors import SceneError
from .methods import method_named
from .methods.base import Method
from .settings import Densify, Settings


def train_settings(
    method: str, iterations: int, recovery: int, *, lambda_f: float | None = None, lambda_m: float | None = None,
    densify: Densify = Densify(), coarse_until: int = 0, target: int = 0, share: float = 0.0, **rest,
) -> Settings:  # fmt: skip
    """`svrgs train`: from the sparse points. share: of the Gaussians there are when densification ends, instead of a target."""
    m = method_named(method)
    phases = m.train_phases(iterations, recovery, densify, coarse_until)
    share = share or (0.0 if target else m.share)
    return Settings(method, tuple(phases), mask_init=m.mask_init, target=target, share=share, **weights(m, method, False, lambda_f, lambda_m), **rest)


def prune_settings(
    method: str, iterations: int, recovery: int, *, lambda_f: float | None = None, lambda_m: float | None = None, prune_every: int = 500, **rest
) -> Settings:
    """`svrgs prune`: on an already trained scene, then recovery. Methods that rank skip the first phase."""
    m = method_named(method)
    phases = m.prune_phases(iterations, recovery, prune_every)
    return Settings(method, tuple(phases), mask_init=m.mask_init, **weights(m, method, True, lambda_f, lambda_m), **rest)


def weights(m: Method, name: str, trained: bool, lambda_f: float | None, lambda_m: float | None) -> dict[str, float]:
    """The weights asked for, or else the method's own. Raises SceneError for one the method does not have."""
    own = dict(zip(("lambda_f", "lambda_m"), m.weights(trained), strict=True))
    if lambda_f is not None and m.mask_kind == "none":
        raise SceneError(f"method '{name}' has no spatial mask to weigh: leave lambda-f out, or use an svr method")
    if lambda_m is not None and not own["lambda_m"]:
        raise SceneError(f"method '{name}' has no term that lambda-m weighs: leave it out, or use maskgs, compact3dgs or gns")
    return own | {key: value for key, value in (("lambda_f", lambda_f), ("lambda_m", lambda_m)) if value is not None}

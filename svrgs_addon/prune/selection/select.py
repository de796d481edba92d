"""Combines criteria: a Gaussian is selected if it fulfils all that are given."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...files.repair import bake_filter, clamp_extremes, unusable
from ...scene.camera import Camera
from ...scene.gaussians import Scene
from ...system.errors import SceneError
from . import criteria
from .options import Criteria

# "all", or names and numbers as in Criteria.seen_by; "": all that there are, which may be none
Views = Callable[[str], list[Camera]]


def selected(scene: Scene, wanted: Criteria, views: Views, matrix: np.ndarray | None = None) -> np.ndarray:
    """(N,) bool: the Gaussians that fulfil all criteria of `wanted`. Those that cannot be rendered
    (repair.py) are never selected.

    scene: as stored in a file. views: called only for criteria that use views, in coordinates of the scene.
    matrix: (4, 4) affine, from the scene's coordinates to those of wanted.box and wanted.sphere. Raises
    SceneError if no criterion is given, and without views that are needed.
    """
    if not wanted.given():
        raise SceneError("no criterion is given; choose at least one, such as an opacity or a box")
    mask, usable = usable_part(scene)
    chosen = np.ones(usable.count, bool)
    for name in wanted.given() if usable.count else ():
        chosen &= _fulfilled(usable, name, wanted, views, matrix)
    mask[mask] = chosen
    return mask


def usable_part(scene: Scene) -> tuple[np.ndarray, Scene]:
    """The Gaussians of a scene, as stored in a file, that can be rendered: (N,) bool, and they as they are
    rendered."""
    mask = ~unusable(scene)
    return mask, clamp_extremes(bake_filter(scene.select(mask))[0])[0]


def _fulfilled(
    scene: Scene, name: str, wanted: Criteria, views: Views, matrix: np.ndarray | None
) -> np.ndarray:
    """(N,) bool: the Gaussians that fulfil one criterion."""
    limits = getattr(wanted, name)
    values = {
        "opacity": lambda: criteria.opacities(scene),
        "size": lambda: criteria.sizes(scene),
        "contribution": lambda: criteria.contributions(scene, views("all")),
        "removal_error": lambda: criteria.errors(scene, views("all")),
    }
    if name == "box":
        return criteria.in_box(scene.means, limits, matrix)
    if name == "sphere":
        return criteria.in_sphere(scene.means, limits, matrix)
    if name == "color":
        return criteria.in_sphere(criteria.base_colours(scene), limits)
    if name == "seen_by":
        return criteria.seen(scene, views(limits))
    if name == "floaters":
        return criteria.floaters(scene, views(""))
    measured = values[name.removeprefix("lowest_")]()
    judge = criteria.lowest if name.startswith("lowest_") else criteria.between
    return judge(measured, limits)

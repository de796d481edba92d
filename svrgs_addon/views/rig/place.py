"""Places cameras for a splat that has no photographs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...native.library import thresholds
from ...scene.camera import Camera
from ...scene.gaussians import Scene
from .around import views_around
from .coverage import TIMES, Choice, Coverage
from .space import Space, matter_of, usable_rows
from .viewpoints import Around, View, Within, setting_of, side_of

# candidates: spread over the scene; aimed at what few of the first see, if they are needed
FIRST, SECOND = 96, 48
MIN_CHOSEN, MAX_CHOSEN = 32, 128  # views that are chosen by what they see
ENOUGH = 0.995  # share of what can be seen that TIMES of them must see
USUAL_VIEWS = 192  # of a rig: steps would fit fewer pictures, but not what lies between them
HELD_OUT, QUICK_HELD_OUT = 16, 8
# views from outside of a scene that is seen from within, if they show at least this share of it
OUTSIDE, OPEN = 32, 0.7
SCORED = 384  # side, in pixels, at which candidates are rendered, at most
LARGE = 1_000_000  # a scene with more Gaussians has the fewer candidates, at least half as many


@dataclass(frozen=True)
class Rig:
    """Cameras around or within a splat."""

    cameras: list[Camera]  # rig_000 ...
    held_out: list[Camera]  # off_000 ...: from other places, in other directions
    # the splat is a room, a street or a sky, seen from within; some cameras may stand outside all the same
    inside_out: bool
    # share of what can be seen that 3 cameras or more see, weighted by the largest alpha T; None: unknown
    seen: float | None

    def facts(self) -> dict:
        """What a JSON result says about the rig."""
        return {
            "views": len(self.cameras),
            "held_out": len(self.held_out),
            "inside_out": self.inside_out,
            "seen": self.seen,
            "width": self.cameras[0].width,
            "height": self.cameras[0].height,
        }


def place_rig(
    scene: Scene, *, views: int | None = None, held_out: int = HELD_OUT, seed: int = 0, enlarged: float = 1.0
) -> Rig:
    """The fewest cameras that see ENOUGH of what can be seen from free space in at least 3 views each,
    MIN_CHOSEN to MAX_CHOSEN, and further ones, evenly spread, up to USUAL_VIEWS.

    views: their number instead, each chosen by what it sees. held_out: further cameras for testing. enlarged:
    as for side_of(). The result depends on the seed, not on the number of threads. Raises SceneError if the
    splat shows nothing.
    """
    rng = np.random.default_rng([seed, 0])
    setting = _setting(scene)
    side = side_of(setting, enlarged)
    outside, coverage = _outside(scene, min(side, SCORED)) if setting.inside_out else ([], _coverage(scene))
    candidates, choice = _candidates(coverage, setting, outside, min(side, SCORED), rng)
    choice.run(views or MIN_CHOSEN, views or MAX_CHOSEN, 2.0 if views else ENOUGH)
    chosen = [candidates[view] for view in choice.chosen] or candidates[: views or MIN_CHOSEN]
    if not views:
        chosen += [candidates[view] for view in range(len(outside)) if view not in choice.chosen]
        missing = max(0, USUAL_VIEWS - len(chosen))
        chosen += setting.views(missing, rng)[:missing]
    others = views_around(scene, held_out // 4, turn=1.0, nearer=0.9) if outside else []
    others += setting.other_views(held_out - len(others), np.random.default_rng([seed, 1]))
    return Rig(_named(chosen, "rig", side), _named(others, "off", side), setting.inside_out, choice.share())


def quick_rig(scene: Scene, views: int = 24, *, held_out: int = QUICK_HELD_OUT, seed: int = 0) -> Rig:
    """About so many cameras, spread evenly, whatever they see.

    Around an object they stand on a sphere. Within a scene, cameras at a few places show all around. Raises
    SceneError as place_rig().
    """
    setting = _setting(scene)
    rng = np.random.default_rng([seed, 0])
    chosen = setting.views(views, rng, 0)
    others = setting.other_views(held_out, np.random.default_rng([seed, 1]))
    side = side_of(setting)
    return Rig(_named(chosen, "rig", side), _named(others, "off", side), setting.inside_out, None)


def _setting(scene: Scene) -> Around | Within:
    matter = matter_of(scene)
    return setting_of(matter, Space.of(matter))


def _outside(scene: Scene, side: int) -> tuple[list[View], Coverage]:
    """Views from outside of the whole scene, if they show most of it, and what they see."""
    views, coverage = views_around(scene, OUTSIDE), _coverage(scene)
    coverage.add([view.camera(side) for view in views])
    if (coverage.peaks >= thresholds().alpha_cut).mean() >= OPEN:
        return views, coverage
    return [], _coverage(scene)


def _coverage(scene: Scene) -> Coverage:
    """Of the Gaussians that can be seen at all, without any views."""
    rows = usable_rows(scene)
    scene = replace(scene.select(rows), sh=np.ascontiguousarray(scene.sh[rows][:, :1]))
    with np.errstate(over="ignore"):  # twice the geometric mean of the two larger standard deviations
        widths = 2 * np.exp((scene.log_scales.sum(axis=1) - scene.log_scales.min(axis=1)) / 2)
    return Coverage(scene, widths)


def _candidates(
    coverage: Coverage, setting: Around | Within, outside: list[View], side: int, rng: np.random.Generator
) -> tuple[list[View], Choice]:
    """The candidate views, those from outside first, and the choice. coverage: of those from outside."""
    scene = coverage.scene
    share = min(1.0, max(0.5, LARGE / scene.count))
    within = setting.views(int(share * FIRST), rng)
    first = outside + within
    coverage.add([view.camera(side) for view in within])
    choice = Choice(coverage)
    if choice.possible() >= ENOUGH:
        return first, choice
    more = _aimed(scene, setting, first, choice, int(share * SECOND), rng)
    coverage.add([view.camera(side) for view in more])
    return first + more, Choice(coverage)


def _aimed(
    scene: Scene,
    setting: Around | Within,
    candidates: list[View],
    choice: Choice,
    count: int,
    rng: np.random.Generator,
) -> list[View]:
    """Further views of the Gaussians that fewer than TIMES candidates see, each near one that sees them."""
    few, views = choice.few(), list[View]()
    for _ in range(count // (TIMES - 1)):
        rows = [choice.rows(view, few) for view in range(len(candidates))]
        view = int(np.argmax([choice.weights[found].sum() for found in rows]))
        if not len(rows[view]):
            break
        for _ in range(TIMES - 1):
            target = scene.means[rows[view][rng.integers(len(rows[view]))]].astype(np.float64)
            found = setting.varied(candidates[view], target, rng)
            views += [found] if found is not None else []
        few[rows[view]] = False
    return views


def _named(views: list[View], prefix: str, side: int) -> list[Camera]:
    return [view.camera(side, f"{prefix}_{number:03}") for number, view in enumerate(views)]

"""Whether the views of a job, and its photographs, belong to its splat: what share of the Gaussians the views
see, and what share of the photographs the splat explains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from ..files.images import to_float
from ..files.registry import invisible
from ..finetune.decimate.order import hidden, visibility_sums
from ..finetune.viewed_scene import ViewedScene
from ..render.metrics.evaluate import Renderable, Renderer
from ..render.metrics.explained import fit, mismatch, sample_views
from ..render.metrics.measures import almost_empty
from ..scene.camera import Camera, evenly
from ..scene.gaussians import Scene
from ..system.errors import SceneError
from ..views.dataset import Dataset
from ..views.rendered import RenderedDataset

MIN_SEEN = 0.5  # share of the Gaussians that the views of a job must see
MIN_EXPLAINED = 0.2  # share of the variance of its photographs that a splat must explain
# views in which Gaussians are looked for, evenly spread: at first, and if those see too few of them
FIRST_LOOKED, MAX_LOOKED = 32, 256
LOOKED_SIDE = 512  # pixels of the longer side of such a view


class Seen(NamedTuple):
    """What views see of a splat."""

    share: float  # of the Gaussians that can be drawn
    views: int

    def sentence(self) -> str:
        return f"{self.views} views see {percent(self.share)} of the Gaussians"

    def facts(self) -> dict[str, Any]:
        """For the JSON result."""
        return {"seen": self.share, "seen_views": self.views}


def seen_of(scene: Scene, cameras: Sequence[Camera]) -> Seen:
    """What FIRST_LOOKED of the cameras see, or, if that is less than MIN_SEEN, MAX_LOOKED of them: each view
    of a large place shows little of it. A Gaussian is seen unless its mean transmittance is at most HIDDEN
    (finetune/decimate/order.py)."""
    drawn = ~invisible(scene)
    for most in (FIRST_LOOKED, MAX_LOOKED):
        some = [camera.fitted(LOOKED_SIDE) for camera in evenly(cameras, most)]
        sums, _ = visibility_sums(ViewedScene.of(scene, some), pictures=False)
        seen = Seen(1 - hidden(sums[drawn]) / max(1, int(drawn.sum())), len(some))
        if seen.share >= MIN_SEEN or len(some) == len(cameras):
            break
    return seen


def check_seen(seen: Seen, name: str, force: bool) -> list[str]:
    """Raises SceneError if the views see less than MIN_SEEN of the Gaussians, unless that is forced; then a
    note says so. name: of the splat."""
    if seen.share >= MIN_SEEN:
        return []
    sentence = f"{name}: {seen.views} views see only {percent(seen.share)} of its Gaussians"
    if not force:
        raise SceneError(
            f"{sentence}, and the others would count for nothing: give the cameras of this splat, or force it"
            " (--force)"
        )
    return [f"{sentence}; it was forced"]


def check_explained(
    scene: Renderable, dataset: Dataset, name: str, force: bool, rasterizer: Renderer | None = None
) -> list[str]:
    """Raises SceneError if the splat explains less than MIN_EXPLAINED of the photographs, unless that is
    forced. Returns what the user must know: that it was forced, or that the splat explains little. name,
    rasterizer: of the splat. Raises FormatError."""
    found = fit(scene, sample_views(dataset), dataset.background, rasterizer)
    if found["explained"] >= MIN_EXPLAINED:
        return list(filter(None, [mismatch(found)]))
    sentence = (
        f"{name}: explains only {percent(max(0.0, found['explained']))} of the photographs (PSNR"
        f" {found['psnr']:.1f} dB), so they are of another capture, or their cameras of another model"
    )
    if not force:
        raise SceneError(
            f"{sentence}: give the dataset that this splat was trained on, or force it (--force)"
        )
    return [f"{sentence}; it was forced"]


def check_dataset(scene: Scene, dataset: Dataset, name: str, force: bool) -> tuple[list[str], dict[str, Any]]:
    """check_explained(), or check_seen() where the splat's own pictures are the measure; test views that show
    almost nothing then no longer count. Returns what the user must know, and facts for the JSON result."""
    if not isinstance(dataset, RenderedDataset):
        return check_explained(scene, dataset, name, force), {}
    seen = seen_of(scene, dataset.training_cameras)
    notes = [seen.sentence(), *check_seen(seen, name, force), *leave_out_empty_tests(dataset)]
    return notes, seen.facts()


def leave_out_empty_tests(dataset: RenderedDataset) -> list[str]:
    """Test views that show almost nothing do not count: any two such pictures are alike. Returns what the
    user must know."""
    total = len(dataset.test_indices)
    shows = lambda index: not almost_empty(to_float(dataset.image(index)), dataset.background)
    dataset.test_indices = list(filter(shows, dataset.test_indices))
    return measuring_notes(len(dataset.test_indices), total)


def measuring_notes(left: int, total: int) -> list[str]:
    """What the user must know of the views in which quality is measured. left: those that show something."""
    if not left:
        return ["the quality is not measured: no view apart from those that decided shows the splat"]
    if left < total:
        return [f"{total - left} of the {total} views that measure show almost nothing, so they do not count"]
    return []


def percent(share: float) -> str:
    """As in 37%. 100% means all, and 0% none."""
    return f"{min(0.99, max(0.01, share)):.0%}" if 0 < share < 1 else f"{share:.0%}"

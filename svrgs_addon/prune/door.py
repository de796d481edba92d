"""The door: what is checked of a job before any work, once, whatever its recipe.

Files and options are checked before anything is read; the scene and its views as soon as they are known.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ..files.atomic import check_writable, reserved
from ..files.registry import format_to_read, format_to_write, invisible, refuse_input
from ..render.metrics.allowed_loss import MEASURES
from ..render.metrics.evaluate import Renderable, refuse_unseen
from ..render.metrics.lpips import NO_WEIGHTS, weights_file
from ..scene.camera import Camera
from ..scene.gaussians import Scene
from ..system.errors import SceneError
from ..system.option_kinds import SWITCH, default_of, flag_of, options_of
from .options import DatasetOptions, PruneOptions

OF_PHOTOGRAPHS = (  # options
    "images", "masks", "invert_masks", "outside", "exposure", "refine_poses", "mask_distractors",
)  # fmt: skip


def check_files(scene: Path | None, outs: Sequence[Path], further: Sequence[Path] = ()):
    """Raises SplatError unless the splat is there, and every output can be written, in its format, and is not
    the splat itself. scene: None for a training. further: other files that are written."""
    for out in outs:
        format_to_write(out).check_packages(out)
        check_writable(out)
        if scene is not None:
            refuse_input(out, scene)
    for path in further:
        check_writable(path)
    if scene is not None:
        format_to_read(scene)


@contextlib.contextmanager
def outputs(scene: Path | None, outs: Sequence[Path], further: Sequence[Path] = ()) -> Iterator[None]:
    """check_files(); as long as the context lasts, no other job can write to these outputs. Raises
    SplatError."""
    check_files(scene, outs, further)
    with contextlib.ExitStack() as held:
        for out in outs:
            held.enter_context(reserved(out))
        yield


def check_view_options(options: PruneOptions):
    """Raises SceneError for options of views that do not go together."""
    if options.data is not None and (options.cameras or options.seen_from_only):
        raise SceneError(
            "--seen-from and --seen-from-only are for scenes without photographs, and"
            f" {options.data} holds some: leave them out, or --data, or move the splat to another"
            " folder"
        )
    if options.seen_from_only and options.cameras is None:
        raise SceneError("--seen-from-only keeps what given cameras see: name them with --seen-from")
    if options.data is None:
        refuse_without_data(options, OF_PHOTOGRAPHS)


def refuse_without_data(options: DatasetOptions, names: Collection[str]):
    """Raises SceneError for an option of photographs where there are none."""
    if found := [name for name in given(options) if name in names]:
        flag = flag_of(type(options), found[0])
        raise SceneError(f"{flag} is of the photographs of a dataset: give --data, or leave it out")


def check_options(options: Any, takes: Collection[str], way: str):
    """Raises SceneError for an option that is given, but is not one of those that this way takes. options: of
    a dataclass of prune/options.py."""
    others = [name for name in given(options) if name not in takes]
    if others:
        flag = flag_of(type(options), others[0])
        raise SceneError(f"{way} takes no {flag}: leave it out, or leave {way} out")


class Allowed(NamedTuple):
    """A loss of quality that is allowed."""

    loss: float = 0.0  # 0: none
    measure: str = "psnr"  # a key of MEASURES: what it is counted in


SIZES = ("target", "target_count", "target_size")  # options that say how many Gaussians stay


def allowed_loss(options: PruneOptions) -> Allowed:
    """What may be lost. Raises SceneError if the size is given twice, and where the weights of LPIPS that
    would decide are missing, or others are given."""
    losses = {"psnr": options.max_drop, "flip": options.max_flip, "lpips": options.max_lpips}
    asked = [Allowed(loss, measure) for measure, loss in losses.items() if loss]
    given = [f"--{name.replace('_', '-')}" for name in SIZES if getattr(options, name)]
    given += [MEASURES[one.measure].option for one in asked]
    if asked and len(given) > 1:
        raise SceneError(f"{given[0]} and {given[1]} are both given: leave one out")
    if options.max_lpips and options.lpips_weights:
        raise SceneError("--max-lpips takes the weights of `make lpips`: leave --lpips-weights out")
    if options.max_lpips and not weights_file().is_file():
        raise SceneError(f"--max-lpips: {NO_WEIGHTS}")
    return asked[0] if asked else Allowed()


def excess_notes(wanted: int, count: int) -> list[str]:
    """A sentence if more Gaussians are asked for than the scene has."""
    return [f"{wanted:,} Gaussians are asked for, and the scene has {count:,}"] if wanted > count else []


def degree_to_keep(options: PruneOptions) -> int:
    """The highest SH degree of the result: that of --sh-degree, or that of the output's format if it is
    lower."""
    most = format_to_write(options.out).most_degree if options.out else 3
    return most if options.sh_degree is None else min(options.sh_degree, most)


def given(options: Any) -> list[str]:
    """The names of the options that differ from their defaults. A switch that is off asks for nothing."""
    cls, kinds = type(options), options_of(type(options))
    return [
        name
        for name in cls.__dataclass_fields__
        if getattr(options, name) != default_of(cls, name)
        and not (name in kinds and kinds[name].kind is SWITCH and getattr(options, name) == "off")
    ]


def check_visible(scene: Scene, name: str):
    """Raises SceneError if no pixel can show any Gaussian. name: of the scene, for the sentence."""
    if invisible(scene).all():
        raise SceneError(
            f"{name}: all of its Gaussians have an opacity below 1/255, so there is nothing to keep"
        )


def check_views(scene: Renderable, cameras: Sequence[Camera], training: Collection, name: str):
    """Raises SceneError if no view is left to train or decide on, or if no view sees the scene. training:
    those views, or their numbers. name: of the scene, for the sentence."""
    check_training(training)
    refuse_unseen(scene, cameras, name)


def check_training(training: Collection):
    """Raises SceneError if all views are held out for testing. training: the other views, or their
    numbers."""
    if not training:
        raise SceneError(
            "all views of the dataset are held out for testing, none is left for training: use --holdout 0"
        )

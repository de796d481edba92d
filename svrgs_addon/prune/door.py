"""The door: what is checked of a job before any work, once, whatever its recipe."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from ..files.atomic import check_writable
from ..files.registry import format_to_read, format_to_write, refuse_input
from ..render.metrics.evaluate import Renderable, refuse_unseen
from ..scene.camera import Camera
from ..system.errors import SceneError
from ..system.option_kinds import default_of


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


def check_options(options: Any, takes: Collection[str], way: str):
    """Raises SceneError for an option that is given, but is not one of those that this way takes. options: of
    a dataclass of prune/options.py."""
    others = [name for name in given(options) if name not in takes]
    if others:
        raise SceneError(f"{way} takes no --{others[0].replace('_', '-')}: leave it out, or leave {way} out")


def given(options: Any) -> list[str]:
    """The names of the options that differ from their defaults."""
    cls = type(options)
    return [name for name in cls.__dataclass_fields__ if getattr(options, name) != default_of(cls, name)]


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

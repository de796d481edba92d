"""Which views a job decides on, tunes on and is measured in: those of a dataset, given ones, or placed ones.

Each recipe has its own numbers and sizes of views. `scene` is the splat, or of one that is larger than memory
a sample (blocks/sample.py), whose Gaussians are `enlarged`.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, NamedTuple

from ..scene.camera import Camera, evenly, halfway, in_their_unit
from ..scene.gaussians import Scene
from ..system.errors import SceneError
from ..views.camera_files import load_cameras
from ..views.dataset import load_dataset
from ..views.rig import place_rig
from ..views.rig.around import cameras_around
from ..views.rig.place import quick_rig
from .blocks.sample import finer
from .door import check_views
from .options import PruneOptions

# pixels of the longer side of a view; larger ones are reduced, as 3DGS does with photographs
MAX_SIDE_PIXELS = 1_600
MAX_VIEWS = 256  # given views, and by blocks those of a dataset: evenly spread
PLACED_FOR_QUICK = 64  # views that are placed for a quick job by blocks
QUICK_SIDE = 512  # pixels of the longer side of a view of a quick job
QUICK_TRAIN, QUICK_TEST = 32, 16  # its views to decide on, and to measure in
QUICK_MOST = 128  # to decide on, where QUICK_TRAIN of a dataset leave many Gaussians hidden
OWN_PICTURES = "no photographs: the splat's own pictures take their place"
BETWEEN = "from halfway between the cameras, because none is held out"


class Views(NamedTuple):
    """Views to decide and tune on, others that are held out, what the user must know of them, and facts for
    the JSON result."""

    train: list[Camera]
    test: list[Camera]
    notes: list[str]
    facts: dict[str, Any]


def of_dataset(
    options: PruneOptions, scene: Scene, longest: int | None = None
) -> tuple[list[Camera], list[Camera]]:
    """The training and test views of the dataset, without its photographs. longest: pixels of their longer
    side, at most; None: as they are. Raises SceneError, FormatError."""
    assert options.data is not None
    dataset = load_dataset(options.data, options.images or None, holdout=options.holdout, cameras_only=True)
    check_views(scene, dataset.cameras, dataset.train_indices, str(options.scene))
    cameras = [camera.fitted(longest) if longest else camera for camera in dataset.cameras]
    return [cameras[i] for i in dataset.train_indices], [cameras[i] for i in dataset.test_indices]


def quick(options: PruneOptions, scene: Scene, most: int = QUICK_TRAIN) -> Views:
    """Of a quick job: of the dataset, or else from outside. most: views to decide on. Raises SceneError,
    FormatError."""
    if options.data is None:
        return Views(
            cameras_around(scene, QUICK_TRAIN, QUICK_SIDE),
            cameras_around(scene, QUICK_TEST, QUICK_SIDE, turn=1.0, nearer=0.9),
            _measured_from("from outside all around"),
            {},
        )
    train, test = of_dataset(options, scene, QUICK_SIDE)
    where = "from the cameras of the dataset" if test else BETWEEN
    train = evenly(train, most)
    return Views(train, evenly(test or halfway(train), QUICK_TEST), _measured_from(where), {})


def quick_instead(options: PruneOptions, scene: Scene) -> Views | None:
    """Of a quick job whose views leave many Gaussians hidden: more of the dataset, or from inside; None if
    there is no free space inside. Raises SceneError, FormatError."""
    if options.data is not None:
        return quick(options, scene, QUICK_MOST)
    rig = quick_rig(scene, QUICK_TRAIN, held_out=QUICK_TEST, seed=options.seed)
    if not rig.inside_out:
        return None
    where = (
        "from places inside; what is seen only from outside is not measured. To choose the cameras, give"
        " --data"
    )
    train, test = ([camera.fitted(QUICK_SIDE) for camera in some] for some in (rig.cameras, rig.held_out))
    return Views(train, test, _measured_from(where), {})


def without_photographs(
    options: PruneOptions, scene: Scene, enlarged: float = 1.0, placed: int | None = None
) -> Views:
    """Given views, and placed ones unless only those count. What the user must know of them is logged, too.
    placed: number of views to place, as for place_rig(). Raises SceneError, FormatError."""
    train, test, notes = _given(options, scene) if options.cameras else ([], [], [])
    facts: dict[str, Any] = {"given": len(train) + len(test)}
    if options.seen_from_only:
        test = test or halfway(train)
    else:
        rig = place_rig(scene, views=placed, seed=options.seed, enlarged=enlarged)
        train, test, facts = train + rig.cameras, test + rig.held_out, facts | rig.facts()
        inside = "within the scene" if rig.inside_out else "around it"
        notes.append(f"{OWN_PICTURES}, from {len(rig.cameras)} cameras {inside}")
    for note in notes:
        logging.warning("%s", note)
    return Views(train, test, notes, facts)


def by_blocks(options: PruneOptions, scene: Scene, enlarged: float) -> Views:
    """Of `svrgs prune` by blocks. Raises SceneError, FormatError."""
    if options.data is not None:
        train, test = of_dataset(options, scene, MAX_SIDE_PIXELS)
        return Views(evenly(train, MAX_VIEWS), test or halfway(train), [], {})
    placed = PLACED_FOR_QUICK if options.quick else None
    train, test, notes, facts = without_photographs(options, scene, enlarged, placed)
    given = len(train) - facts.get("views", 0)
    return Views(train[:given] + finer(train[given:]), test, notes, facts)


def large(options: PruneOptions, scene: Scene, enlarged: float) -> Views:
    """Of `svrgs large`: all of a dataset or of a file of cameras, or else placed ones. Raises SceneError,
    FormatError."""
    if options.data is not None:
        train, test = of_dataset(options, scene)
        return Views(train, test or halfway(train), [], {})
    if options.cameras is not None:
        cameras = in_their_unit(load_cameras(options.cameras), scene.means)
        train, test = _held_out(cameras, options.holdout)
        if not train:
            raise SceneError("one view is held out for the test, and no other is there: give at least two")
        check_views(scene, cameras, train, str(options.scene))
        return Views(train, test or halfway(train), [], {})
    rig = place_rig(scene, enlarged=enlarged)
    return Views(finer(rig.cameras), rig.held_out, [], {})


def _given(options: PruneOptions, scene: Scene) -> tuple[list[Camera], list[Camera], list[str]]:
    """The given views to train on, those held out, and what the user must know of them."""
    assert options.cameras is not None
    given = in_their_unit(load_cameras(options.cameras), scene.means)
    cameras = [camera.fitted(MAX_SIDE_PIXELS) for camera in evenly(given, MAX_VIEWS)]
    # of few views, all are needed
    train, test = _held_out(cameras, options.holdout if options.holdout <= len(cameras) // 2 else 0)
    check_views(scene, cameras, train, str(options.scene))
    notes = []
    if options.seen_from_only:
        notes.append(
            f"{OWN_PICTURES}, from the {len(cameras)} views of {Path(options.cameras).name} alone: what"
            " they do not see may be removed"
        )
    return train, test, notes


def _held_out(cameras: list[Camera], every: int) -> tuple[list[Camera], list[Camera]]:
    """The other cameras, and every N-th one; with 0 none is held out."""
    held = [every > 0 and k % every == 0 for k in range(len(cameras))]
    train, test = (
        [camera for camera, out in zip(cameras, held, strict=True) if out is which] for which in (False, True)
    )
    return train, test


def _measured_from(where: str) -> list[str]:
    return [f"the quality is measured against the original's own pictures, {where}"]

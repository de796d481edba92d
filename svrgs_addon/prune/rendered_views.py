"""The dataset of a pruning job without photographs: cameras that are given or placed, and the scene's own
pictures."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from ..files.registry import invisible
from ..render.metrics.evaluate import refuse_unseen
from ..scene.camera import Camera, evenly
from ..scene.gaussians import Scene
from ..system.errors import SceneError
from ..views.camera_files import load_cameras
from ..views.rendered import RenderedDataset
from ..views.rig import place_rig
from .options import PruneOptions

# pixels of the longer side of a given view; larger ones are reduced, as 3DGS does with photographs
LONGEST = 1_600
MOST = 256  # given views, evenly spread in the file
OWN = "no photographs: the splat's own pictures take their place"


def rendered_dataset(options: PruneOptions, scene: Scene) -> RenderedDataset:
    """The dataset of options.cameras and of placed cameras; of the first alone with options.seen_from_only.
    Its pictures are those of the scene, which it keeps. Raises SceneError, FormatError."""
    refuse_options(options)
    if invisible(scene).all():
        raise SceneError(
            f"{options.scene}: all of its Gaussians have an opacity below 1/255, so there is nothing to keep"
        )
    train, test, notes, facts = views_of(options, scene)
    budget = int(options.image_memory * 1e9)
    return RenderedDataset.of(
        scene,
        train,
        test,
        background=options.background,
        memory_budget=budget,
        notes=tuple(notes),
        facts=facts,
    )


def views_of(
    options: PruneOptions, scene: Scene, enlarged: float = 1.0, views: int | None = None
) -> tuple[list[Camera], list[Camera], list[str], dict[str, Any]]:
    """The views to train on, those held out, what the user must know of them, which is logged too, and facts
    for the result. enlarged, views: as for place_rig(). Raises SceneError, FormatError."""
    train, test, notes = _given(options, scene) if options.cameras else ([], [], [])
    facts: dict[str, Any] = {"given": len(train) + len(test)}
    if not options.seen_from_only:
        rig = place_rig(scene, views=views, seed=options.seed, enlarged=enlarged)
        train, test, facts = train + rig.cameras, test + rig.held_out, facts | rig.facts()
        inside = "within the scene" if rig.inside_out else "around it"
        notes.append(
            f"{OWN}, from {len(rig.cameras)} cameras {inside} that together show {rig.seen:.1%} of what can"
            " be seen three times"
        )
    for note in notes:
        logging.warning("%s", note)
    return train, test, notes, facts


def refuse_options(options: PruneOptions):
    """Raises SceneError for --seen-from-only without --cameras, and for --images without --colmap."""
    if options.seen_from_only and options.cameras is None:
        raise SceneError("--seen-from-only keeps what given cameras see: name them with --cameras")
    if options.images:
        raise SceneError(
            "--images names a folder of photographs in a dataset: give --colmap, or leave it out"
        )


def _given(options: PruneOptions, scene: Scene) -> tuple[list[Camera], list[Camera], list[str]]:
    """The given views to train on, those held out, and what the user must know of them."""
    assert options.cameras is not None
    cameras = [camera.fitted(LONGEST) for camera in evenly(load_cameras(options.cameras), MOST)]
    refuse_unseen(scene, cameras, str(options.scene))
    every = options.holdout if 0 < options.holdout <= len(cameras) // 2 else 0  # of few views, all are needed
    held_out = [every > 0 and k % every == 0 for k in range(len(cameras))]
    train, test = (
        [camera for camera, out in zip(cameras, held_out, strict=True) if out == which]
        for which in (False, True)
    )
    notes = []
    if options.seen_from_only:
        notes.append(
            f"{OWN}, from the {len(cameras)} views of {Path(options.cameras).name} alone: what they do not"
            " see may be removed"
        )
    return train, test, notes

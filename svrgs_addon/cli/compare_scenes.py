"""`svrgs compare`: two scenes against photographs, or, without them, the second one against the pictures of
the first."""

from __future__ import annotations

import argparse

import numpy as np

from ..files.atomic import check_writable
from ..files.registry import check_readable
from ..prune.blocks.block_rasterizer import opened
from ..prune.blocks.sample import sample_of
from ..prune.door import OF_PHOTOGRAPHS, refuse_without_data
from ..prune.job_views import MAX_SIDE_PIXELS
from ..prune.options import DatasetOptions
from ..prune.plans import dataset_of
from ..prune.report.compare import compare
from ..prune.report.page import refuse_other_page
from ..scene.camera import evenly, in_their_unit
from ..views.camera_files import load_cameras
from ..views.dataset import Dataset
from ..views.rig import place_rig
from .option_parser import options_from
from .render_views import refuse_both_views

MAX_VIEWS = 32  # given views, evenly spread in the file


def compare_scenes(args: argparse.Namespace) -> dict:
    """Writes the report. Returns the result of report.compare.compare(). Raises SplatError."""
    refuse_both_views(args)
    check_writable(args.out / "index.html")  # before cameras are placed
    refuse_other_page(args.out)
    for path in (args.a, args.b):
        check_readable(path)
    dataset = dataset_of(options_from(DatasetOptions, args)) if args.data else _views_alone(args)
    return compare(args.a, args.b, dataset, args.out, opened, args.lpips_weights)


def _views_alone(args: argparse.Namespace) -> Dataset:
    """Given or placed cameras, without photographs. Raises SplatError."""
    refuse_without_data(options_from(DatasetOptions, args), (*OF_PHOTOGRAPHS, "holdout"))
    scene, enlarged = sample_of(args.a)
    if args.cameras:
        given = in_their_unit(load_cameras(args.cameras), scene.means)
        cameras = [camera.fitted(MAX_SIDE_PIXELS) for camera in evenly(given, MAX_VIEWS)]
        where = f"from {args.cameras.name}"
    else:
        cameras, where = place_rig(scene, enlarged=enlarged).held_out, "that were placed"
    note = (
        f"no photographs: {args.b.name} is measured against pictures of {args.a.name}, in {len(cameras)}"
        f" views {where}"
    )
    points, colours = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
    indices, budget = list(range(len(cameras))), int(args.image_memory * 1e9)
    return Dataset(
        cameras, points, colours, [], indices, background=args.background, memory_budget=budget, notes=(note,)
    )

"""Jobs on the tiny dataset: their settings, what they write, and their checkpoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import whole_jobs
from plans import prune_settings, train_settings
from svrgs_addon.finetune.settings import Densify
from svrgs_addon.prune.context import JobContext

# Masks that start undecided, so that pruning events bite within few steps.
SETTINGS = replace(prune_settings("svr", 60, 30, prune_every=20, lambda_f=1e-3), mask_init=0.5, seed=5)
DENSIFY = Densify(start=20, until=100, every=20, reset_every=50, gradient=1e-3)
TRAINING = replace(train_settings("svr", 120, 20, densify=DENSIFY, lambda_f=1e-3), mask_init=1.0)


def prune(tiny, data, out: Path, settings=SETTINGS, **options) -> bytes:
    whole_jobs.prune(tiny.splat, data, settings, JobContext(out, **options))
    return out.read_bytes()


def checkpoints(out: Path) -> list[str]:
    return sorted(path.parent.name for path in out.with_name(out.name + ".job").glob("*/manifest.json"))

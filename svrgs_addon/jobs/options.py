"""The options of each command that works on a dataset: one field an option, with its kind, default and help.

The command line's parser, job folders and the properties of Blender's operators and panels are made from these fields.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..option_kinds import COLOUR, COUNT, DECIBELS, FACTOR, FILE, FLAG, GIGABYTES, PATH, POSITIVE, SH_DEGREE, SHARE, SMALL_SHARE, TEXT, WEIGHT, option

ITERATIONS, PRUNE_ITERATIONS, RECOVERY = 30_000, 3_000, 5_000
MIN_CONTRIBUTION = 0.02
ENGINES = ("native", "torch")


@dataclass(frozen=True, kw_only=True)
class DatasetOptions:
    """Photographs and how they are measured against."""

    colmap: Path | None = option(PATH, None, "COLMAP dataset: photographs and model", metavar="DIR", required=True, in_job=True)
    images: str = option(TEXT, "", "image folder inside the dataset, for example images_4", metavar="NAME", default_help="images", in_job=True)
    holdout: int = option(COUNT, 8, "every N-th view is for testing; 0: none", metavar="N", in_job=True)
    background: tuple[float, float, float] = option(COLOUR, (0.0, 0.0, 0.0), "behind transparent pixels, 0..1 each", metavar="R,G,B", default_help="black")
    image_memory: float = option(GIGABYTES, 4.0, "memory for photographs; beyond it they are read again for each view", metavar="GB")
    lpips_weights: Path | None = option(FILE, None, "VGG LPIPS weights; without them LPIPS is left out", metavar="FILE")
    threads: int = option(COUNT, 0, "threads to use; results do not depend on it", default_help="one per core", in_job=True)


@dataclass(frozen=True, kw_only=True)
class TuningOptions(DatasetOptions):
    """What training and pruning share."""

    method: str = option(TEXT, "", "the method")
    seed: int = option(COUNT, 0, "the same seed gives the same result", in_job=True)
    engine: str = option(TEXT, "native", f"{' or '.join(ENGINES)}")
    lambda_f: float | None = option(WEIGHT, None, "weight of the spatial mask", metavar="L", default_help="1e-4; of saliency 1e-3, of svr-a 1e-2", in_job=True)
    lambda_m: float | None = option(
        WEIGHT, None, "weight of the term of maskgs and compact3dgs, first pressure of gns and pressure", metavar="L", default_help="the method's own"
    )
    paper: bool = option(FLAG, False, "with --method svr: the paper's printed settings to the letter, among them L1 + (1 - SSIM) and no first cut")
    visible_mask: bool = option(FLAG, False, "the spatial mask counts along a ray only up to where the colours stop", in_job=True)
    views_by_loss: bool = option(FLAG, False, "show the photographs that are matched best only every other time", in_job=True)
    schedule: float = option(
        FACTOR, 1.0, "every step count times X, pruning decisions included, but not the spacing of densifications; a quick try is 0.1", metavar="X"
    )
    target: float | None = option(
        SHARE, None, "share of the Gaussians to keep", metavar="SHARE", default_help="what the method decides", size=True, in_job=True
    )
    target_count: int | None = option(
        POSITIVE, None, "number of Gaussians to keep", metavar="N", default_help="what the method decides", size=True, in_job=True
    )
    resume: bool = option(FLAG, False, "go on from the last checkpoint of the same job; without it, a job starts anew and forgets them")
    quiet: bool = option(FLAG, False, "no progress on stderr")


@dataclass(frozen=True, kw_only=True)
class TrainOptions(TuningOptions):
    """`svrgs train`."""

    method: str = option(TEXT, "3dgs", "what trains and prunes: see 'svrgs train --help'")
    iterations: int = option(COUNT, ITERATIONS, "training steps", metavar="N")
    recovery: int | None = option(COUNT, None, "steps after pruning", metavar="N", default_help=f"{RECOVERY} for methods that prune, else 0")
    coarse_until: int = option(COUNT, 0, "train on photographs of half the size until this step", metavar="N")
    densify_until: int | None = option(COUNT, None, "densification ends before this step", metavar="N", default_help="half of the steps, at most 15000")
    sh_degree: int = option(SH_DEGREE, 3, "degree of the spherical harmonics")
    out: Path | None = option(PATH, None, "file to write", metavar="FILE", required=True)


@dataclass(frozen=True, kw_only=True)
class PruneOptions(TuningOptions):
    """`svrgs prune`, of one scene."""

    method: str = option(TEXT, "pressure", "how pruning decides which Gaussians go", in_job=True)
    iterations: int = option(COUNT, PRUNE_ITERATIONS, "steps in which the method learns which Gaussians go", metavar="N", in_job=True)
    recovery: int = option(COUNT, RECOVERY, "steps after pruning, which recover the quality", metavar="N", in_job=True)
    min_contribution: float | None = option(
        SMALL_SHARE, None, "first remove Gaussians that never cover this share of a pixel in a training view", metavar="A",
        default_help=f"{MIN_CONTRIBUTION} where masks are learned, else 0", in_job=True,
    )  # fmt: skip
    max_drop: float = option(
        DECIBELS, 0.0, "keep as few Gaussians as lose about this much PSNR, in dB, on a few training views", metavar="DB", default_help="no such limit",
        size=True, in_job=True,
    )  # fmt: skip
    scene: Path | None = None  # the splat file
    out: Path | None = None
    report: Path | None = None  # folder of an HTML report

"""The options of each command that works on a dataset: one field per option, with its kind, default and help
text.

The parser of the command line, job folders and the properties of Blender's operators and panels are made from
these fields. A help text begins in lower case and has no full stop; Blender's tooltips capitalise it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from ..system.errors import SceneError
from ..system.option_kinds import (
    COLOUR,
    COUNT,
    DECIBELS,
    DENSIFY,
    FACTOR,
    FILE,
    FLAG,
    GIGABYTES,
    LOSS,
    MEGABYTES,
    OUTSIDE,
    PATH,
    POSITIVE,
    SECONDS,
    SH_DEGREE,
    SHARE,
    SHARES,
    SMALL_SHARE,
    SMALLER_SHARE,
    SWITCH,
    TEXT,
    WEIGHT,
    option,
    options_of,
)

# headings of --help
GOAL, INPUT, TIME, OUTPUT = GROUPS = ("Goal", "Input", "Time", "Output")
ITERATIONS, PRUNE_ITERATIONS, RECOVERY = 30_000, 3_000, 5_000
MIN_CONTRIBUTION = 0.02
ENGINES = ("native", "torch")

# Of an option: its kind and default, its help text, then the rest.
# fmt: off


@dataclass(frozen=True, kw_only=True)
class DatasetOptions:
    """Options of commands that measure a scene on photographs."""

    data: Path | None = option(
        PATH, None,
        "folder of the dataset (COLMAP or Nerfstudio): photographs, and a COLMAP model or transforms.json",
        metavar="DIR", required=True, in_job=True, group=INPUT, former="colmap",
    )
    images: str = option(
        TEXT, "",
        "folder of the photographs in the dataset, for example images_4",
        metavar="NAME", default_help="images", in_job=True,
    )
    holdout: int = option(COUNT, 8, "hold out every N-th view for testing; 0: none", in_job=True)
    background: tuple[float, float, float] = option(
        COLOUR, (0.0, 0.0, 0.0), "behind transparent pixels, 0..1 each", default_help="black"
    )
    masks: Path | None = option(
        PATH, None,
        "folder of the masks of the photographs, NAME.png or NAME.jpg.png: what is black counts nowhere",
        metavar="DIR",
        default_help="those that the dataset names, or the folder masks beside the photographs", in_job=True,
    )
    invert_masks: bool = option(
        FLAG, False, "what is black in the masks counts, the rest does not", in_job=True
    )
    outside: str = option(
        OUTSIDE, "auto",
        "what is done with what does not count: ignore leaves it out, also where photographs are"
        " transparent; background paints it, for an object on a turntable; auto leaves out what masks hide,"
        " and paints what is transparent",
        in_job=True,
    )
    image_memory: float = option(
        GIGABYTES, 4.0, "memory for photographs, in GB; if they need more, they are read again for each step"
    )
    lpips_weights: Path | None = option(
        FILE, None,
        "file with the VGG weights of LPIPS; eval, compare and reports take what `make lpips` fetched",
    )
    threads: int = option(
        COUNT, 0,
        "number of threads; the result does not depend on it",
        default_help="one per core", in_job=True,
    )


@dataclass(frozen=True, kw_only=True)
class TuningOptions(DatasetOptions):
    """Options that training and pruning have in common."""

    method: str = option(TEXT, "", "name of the method")
    seed: int = option(
        COUNT, 0, "seed of the random numbers; the same seed gives the same result", in_job=True
    )
    engine: str = option(
        TEXT, "native", "what computes the steps: native (C++), or torch (PyTorch, for comparison)"
    )
    lambda_f: float | None = option(
        WEIGHT, None,
        "with svr methods, weight of the spatial mask; with removal and saliency, the saliency above "
        "which a Gaussian stays; larger values keep fewer",
        metavar="L", default_help="1e-4; svr-a: 1e-2", in_job=True, group=GOAL,
    )
    lambda_m: float | None = option(
        WEIGHT, None,
        "with maskgs, compact3dgs and rdo, weight of their term over all masks; with gns, weight of the "
        "opacity pressure at the start; with reduced3dgs, weight of the mean opacity",
        metavar="L", default_help="that of the method",
    )
    paper: bool = option(
        FLAG, False,
        "with --method svr: the printed settings of the paper to the letter, such as L1 + (1 - SSIM) and no"
        " first cut",
    )
    visible_mask: bool = option(
        FLAG, False,
        "count the Gaussians of a ray for the spatial mask only up to where its colours stop",
        in_job=True,
    )
    views_by_loss: bool = option(
        FLAG, False,
        "show the half of the photographs with the lower loss only in every other epoch",
        in_job=True,
    )
    exposure: str = option(
        SWITCH, "auto",
        "fit a colour matrix to each photograph, whose exposure and white balance may differ: auto does so"
        " where the splat shows that they do; it is written beside the result, which keeps its colours",
        in_job=True,
    )
    refine_poses: str = option(
        SWITCH, "auto",
        "move the cameras of photographs whose poses are slightly off: auto does so where the splat shows"
        " them elsewhere; the cameras are written beside the result",
        in_job=True,
    )
    schedule: float = option(
        FACTOR, 1.0,
        "multiply all step counts, pruning events included, but not the spacing of densifications "
        "and opacity resets; a quick try is 0.1",
        steps=True,
    )
    time: float = option(
        SECONDS, 0.0,
        "seconds that the job may take: measures the speed of this machine, chooses the schedule "
        "that fits, up to 1, and prints it",
        default_help="no limit", in_job=True, group=TIME,
    )
    target: float | None = option(
        SHARE, None,
        "share of the Gaussians to keep, up to 1",
        default_help="the method decides", size=True, in_job=True, group=GOAL,
    )
    target_count: int | None = option(
        POSITIVE, None,
        "number of Gaussians to keep",
        default_help="the method decides", size=True, in_job=True, group=GOAL,
    )
    resume: bool = option(
        FLAG, False,
        "continue from the last checkpoint of the same job; without it, the job starts again and deletes its"
        " checkpoints",
        group=TIME,
    )
    quiet: bool = option(FLAG, False, "print no progress on stderr")


@dataclass(frozen=True, kw_only=True)
class TrainOptions(TuningOptions):
    """Options of `svrgs train`."""

    method: str = option(TEXT, "3dgs", "method that prunes while training", metavar="NAME", group=GOAL)
    iterations: int = option(
        COUNT, ITERATIONS, "number of training steps", steps=True, in_job=True, group=TIME
    )
    recovery: int | None = option(
        COUNT, None,
        "number of recovery steps after the training steps",
        default_help=f"{RECOVERY} for methods that prune, else 0", steps=True,
    )
    coarse_until: int = option(COUNT, 0, "train on photographs of half the size up to this step")
    densify: str = option(
        DENSIFY, "3dgs",
        "how training adds Gaussians: 3dgs clones and splits them, mcmc relocates them and grows up to --cap"
        " (3DGS-MCMC)",
        in_job=True, group=GOAL,
    )
    densify_until: int | None = option(
        COUNT, None,
        "end densification before this step",
        default_help="half of the steps, at most 15000; mcmc: 5/6, at most 25000",
    )
    cap: int | None = option(
        POSITIVE, None,
        "with --densify mcmc, number of Gaussians up to which the scene grows",
        default_help="with --method 3dgs, that of --target-count", in_job=True, group=GOAL,
    )
    sh_degree: int = option(SH_DEGREE, 3, "degree of the spherical harmonics", group=OUTPUT)
    out: Path | None = option(PATH, None, "splat file to write", metavar="FILE", required=True, group=OUTPUT)


@dataclass(frozen=True, kw_only=True)
class PruneOptions(TuningOptions):
    """Options of `svrgs prune` for one scene."""

    method: str = option(
        TEXT, "",
        "method that decides which Gaussians are removed",
        metavar="NAME", default_help="removal; without photographs, to a number, merge", in_job=True,
        group=GOAL,
    )
    iterations: int = option(
        COUNT, PRUNE_ITERATIONS, "steps spent deciding which Gaussians to remove", steps=True, in_job=True
    )
    recovery: int = option(
        COUNT, RECOVERY, "steps after pruning, which recover the quality", steps=True, in_job=True
    )
    mask_distractors: bool = option(
        FLAG, False,
        "find what stands in one photograph and not in the others, such as people who walked by; it does not"
        " count there",
        in_job=True,
    )
    min_contribution: float | None = option(
        SMALL_SHARE, None,
        "first remove the Gaussians that cover less than this share of every pixel in every training view",
        metavar="A", default_help=f"{MIN_CONTRIBUTION} for svr methods, else 0", in_job=True,
    )
    target_size: float | None = option(
        MEGABYTES, None,
        "size of the file in MB: as many Gaussians as fit into it",
        size=True, in_job=True, group=GOAL,
    )
    target_format: str = option(
        TEXT, "",
        "suffix of the file that --target-size is about, such as .spz",
        metavar="SUFFIX", default_help="that of OUT", in_job=True,
    )
    max_drop: float = option(
        DECIBELS, 0.0,
        "lose at most about so many dB of PSNR; the fewest Gaussians that do so on a few test views, "
        "at least 5 %%",
        default_help="no such limit", size=True, in_job=True, group=GOAL,
    )
    max_flip: float = option(
        LOSS, 0.0,
        "as --max-drop, but let FLIP rise at most so much: the difference that is seen when two pictures are "
        "flipped, 0 to 1",
        metavar="FLIP", default_help="no such limit", in_job=True,
    )
    max_lpips: float = option(
        LOSS, 0.0,
        "as --max-drop, but let LPIPS rise at most so much: texture and fine structure, which PSNR hardly "
        "sees; 0.01 is hardly visible; needs the weights of `make lpips`",
        metavar="LPIPS", default_help="no such limit", in_job=True,
    )
    nested: float | None = option(
        SMALLER_SHARE, None,
        "also train smaller numbers of Gaussians, down to this share of the result: its first rows, "
        "any number, are a good splat",
        default_help="only the result as a whole is trained", in_job=True,
    )
    levels: tuple[float, ...] = option(
        SHARES, (),
        "levels of detail, as in 0.5,0.25,0.1: also write these shares of the result, to OUT_50.ply "
        "and so on, or into the streamed SOG "
        "OUT/lod-meta.json (with --quick): the first rows of a nested result; with --quick, each pruned on"
        " its own",
        default_help="none", group=OUTPUT,
    )
    sh_degree: int | None = option(
        SH_DEGREE, None,
        "highest SH degree of the result: a lower one makes smaller files, or leaves room for more Gaussians;"
        " the bands that stay are fitted to what the training views show of all bands",
        default_help="that of the format", in_job=True,
    )
    quick: bool = option(
        FLAG, False,
        "remove and merge within seconds, on the scene's own pictures instead of photographs; needs "
        "--target, --target-count, --max-drop, --max-flip, --max-lpips or "
        "--levels; with --data only the cameras of the dataset are read",
        in_job=True, group=TIME,
    )
    cameras: Path | None = option(
        PATH, None,
        "without photographs, views that matter besides the placed ones: cameras.json of 3DGS, or"
        " transforms.json",
        metavar="JSON", in_job=True, group=INPUT, flag="seen-from", former="cameras",
    )
    seen_from_only: bool = option(
        FLAG, False,
        "with --seen-from, only those views count: what they do not see may be removed",
        in_job=True,
    )
    force: bool = option(
        FLAG, False,
        "prune also where the views see less than half of the Gaussians, or the splat explains less than a"
        " fifth of its photographs",
        in_job=True,
    )
    scene: Path | None = None  # splat file to prune
    out: Path | None = None  # splat file to write
    report: Path | None = None  # folder of the HTML report


# fmt: on
def refuse_time_and_steps(cls: type, given: Collection[str]):
    """Raises SceneError if both a time limit and a number of steps are given. given: names of the options of
    the dataclass that are."""
    steps = [f"--{name}" for name, found in options_of(cls).items() if found.steps and name in given]
    if "time" in given and steps:
        raise SceneError(
            f"--time chooses the number of steps itself: leave out {' and '.join(steps)}, or --time"
        )

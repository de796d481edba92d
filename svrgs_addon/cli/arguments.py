"""The command line's words. What they do is in commands.py; nothing heavy is imported here."""

from __future__ import annotations

import argparse
from pathlib import Path

from .. import __version__

TRAIN_ITERATIONS, PRUNE_ITERATIONS, RECOVERY = 30_000, 3_000, 5_000
MIN_CONTRIBUTION = 0.02
LEARNED = "svr, svr-mask, svr-self, svr-even, svr-worth, svr-a, svr-b, maskgs (also -alpha, -beta, -gamma), compact3dgs, gns"
RANKED = "lightgaussian, pup, contribution, max-contribution, opacity"
METHODS = f"learned: {LEARNED}; by a score, once: {RANKED}; none: 3dgs"


class Parser(argparse.ArgumentParser):
    def error(self, message: str):
        self.exit(2, f"{self.prog}: {message}\n")


def parser() -> argparse.ArgumentParser:
    root = Parser(prog="svrgs", description="Makes 3D Gaussian splat scenes several times smaller, and says what it cost.")
    root.add_argument("--version", action="version", version=__version__)
    commands = root.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for add in (_info, _render, _train, _prune, _eval, _compare, _bench):
        add(commands)
    return root


def _command(commands, name: str, help_: str) -> argparse.ArgumentParser:
    command = commands.add_parser(name, help=help_, description=help_)
    command.add_argument("--json", action="store_true", help="print one JSON object on stdout and nothing else there")
    command.add_argument("--threads", type=_count, default=0, help="threads to use (default: one per core); results do not depend on it")
    return command


def _info(commands):
    command = _command(commands, "info", "Says what is in a splat file.")
    command.add_argument("scene", type=Path)


def _render(commands):
    command = _command(commands, "render", "Renders a scene from its cameras: colours, spatial mask, depth, alpha.")
    command.add_argument("scene", type=Path)
    cameras = command.add_mutually_exclusive_group(required=True)
    cameras.add_argument("--colmap", type=Path, metavar="DIR", help="COLMAP dataset or model; photographs are not needed")
    cameras.add_argument(
        "--cameras", type=Path, metavar="JSON", help='cameras.json of a 3DGS run; with "orthographic": true in a view, fx and fy are pixels per unit'
    )
    command.add_argument("--views", default="all", help="all, train, test, or image names and positions, comma-separated (default: all)")
    command.add_argument("--outputs", default="rgb", help="any of rgb,mask,depth,alpha (default: rgb)")
    command.add_argument("--format", choices=("png", "exr", "npy"), default="png")
    command.add_argument("--background", type=_colour, default=(0.0, 0.0, 0.0), metavar="R,G,B", help="0..1 each (default: black)")
    command.add_argument("--out", type=Path, required=True, metavar="DIR")


def _dataset(command, required: bool = True):
    command.add_argument("--colmap", type=Path, required=required, metavar="DIR", help="COLMAP dataset: photographs and model")
    command.add_argument("--images", metavar="NAME", help="image folder inside the dataset, e.g. images_4 (default: images)")
    command.add_argument("--holdout", type=_count, default=8, metavar="N", help="every N-th view is for testing; 0: none (default: 8)")
    command.add_argument("--background", type=_colour, default=(0.0, 0.0, 0.0), metavar="R,G,B", help="behind transparent pixels, 0..1 each (default: black)")
    command.add_argument("--image-memory", type=_gigabytes, default=4.0, metavar="GB", help="photographs beyond this are read anew for each view (default: 4)")
    command.add_argument("--lpips-weights", type=_weights_file, metavar="FILE", help="VGG LPIPS weights; without them LPIPS is left out")


def _run(command):
    command.add_argument("--seed", type=_count, default=0)
    command.add_argument("--engine", choices=("native", "torch"), default="native")
    command.add_argument("--lambda-f", type=_weight, metavar="L", help="weight of the spatial mask (default: 1e-4; of svr-worth 1e-3, of svr-a 1e-2)")
    command.add_argument(
        "--lambda-m",
        type=_weight,
        metavar="L",
        help="weight of the term of maskgs and compact3dgs, pressure of gns and svr at first (default: the method's own)",
    )
    command.add_argument("--paper", action="store_true", help="with --method svr: the paper's own form, whatever the default is")
    command.add_argument("--visible-mask", action="store_true", help="F stops with the colours instead of walking each ray to its end")
    command.add_argument("--views-by-loss", action="store_true", help="look at the half of the views with the lower loss every other time")
    command.add_argument(
        "--schedule",
        type=_schedule,
        default=1.0,
        metavar="X",
        help="every step count times X, pruning decisions included, but not the spacing of densifications; a quick try is 0.1 (default: 1)",
    )
    command.add_argument("--resume", action="store_true", help="go on from the last checkpoint of the same job; without it, a job starts anew and forgets them")
    command.add_argument("--quiet", action="store_true", help="no progress on stderr")


def _size(command, whole: str) -> argparse._MutuallyExclusiveGroup:
    size = command.add_mutually_exclusive_group()
    size.add_argument("--target", type=_share, metavar="SHARE", help=f"share of {whole} to keep (lightgaussian: 0.34, gns: 0.25)")
    size.add_argument("--target-count", type=_positive, metavar="N", help="number of Gaussians to keep")
    return size


def _train(commands):
    command = _command(commands, "train", "Trains a scene from photographs and COLMAP's sparse points.")
    _dataset(command)
    _run(command)
    command.add_argument("--method", default="3dgs", help=f"{METHODS} (default: 3dgs)")
    command.add_argument("--iterations", type=_count, default=TRAIN_ITERATIONS, help=f"default: {TRAIN_ITERATIONS}")
    command.add_argument("--recovery", type=_count, metavar="N", help=f"steps after pruning (default: {RECOVERY} for methods that prune, else 0)")
    command.add_argument("--coarse-until", type=_count, default=0, metavar="N", help="look at photographs of half the size until this iteration (default: 0)")
    command.add_argument(
        "--densify-until", type=_count, metavar="N", help="densification ends before this iteration (default: half of the iterations, at most 15000)"
    )
    _size(command, "the Gaussians there are when densification ends")
    command.add_argument("--sh-degree", type=int, choices=range(4), default=3)
    command.add_argument("--out", type=Path, required=True, metavar="FILE")


def _prune(commands):
    command = _command(commands, "prune", "Prunes trained scenes and recovers their quality.")
    command.add_argument("scenes", type=Path, nargs="+", metavar="SCENE", help="splat files, folders of a splat and its COLMAP dataset, or folders of such")
    _dataset(command, required=False)
    _run(command)
    command.add_argument("--method", default="svr", help=f"{METHODS} (default: svr)")
    command.add_argument(
        "--iterations", type=_count, default=PRUNE_ITERATIONS, metavar="N", help=f"steps in which the method learns what to prune (default: {PRUNE_ITERATIONS})"
    )
    command.add_argument("--recovery", type=_count, default=RECOVERY, metavar="N", help=f"steps after it (default: {RECOVERY})")
    command.add_argument(
        "--min-contribution", type=_small_share, metavar="A",
        help=f"first drop what never covers this much of a pixel in a training view (default: {MIN_CONTRIBUTION} where masks are learned, else 0)",
    )  # fmt: skip
    _size(command, "the Gaussians").add_argument(
        "--max-drop", type=_decibels, default=0.0, metavar="DB",
        help="as few Gaussians as lose about this much on a few training views in the end; of methods that learn what to prune",
    )  # fmt: skip
    command.add_argument("--out", type=Path, metavar="FILE|DIR", help="a file for one scene, a folder for several (default: beside each scene)")
    command.add_argument("--report", type=Path, metavar="DIR", help="write an HTML page there (one folder a scene if there are several)")
    command.add_argument("--overwrite", action="store_true", help="with several scenes: also those whose output exists")
    command.add_argument("--batch", action="store_true", help="treat a single scene like several: a JSON line each, finished ones skipped")


def _eval(commands):
    command = _command(commands, "eval", "Measures a scene against photographs.")
    command.add_argument("scene", type=Path)
    _dataset(command)
    command.add_argument("--split", choices=("test", "train", "all"), default="test")


def _compare(commands):
    command = _command(commands, "compare", "Two scenes side by side: pictures, differences, spatial masks, figures.")
    command.add_argument("a", type=Path, metavar="A")
    command.add_argument("b", type=Path, metavar="B")
    _dataset(command)
    command.add_argument("--out", type=Path, required=True, metavar="DIR")


def _bench(commands):
    command = _command(commands, "bench", "Measures run time against error, on generated scenes or a given one.")
    command.add_argument("--scene", type=Path, metavar="FILE", help="a splat file instead of the generated scenes")
    cameras = command.add_mutually_exclusive_group()
    cameras.add_argument("--colmap", type=Path, metavar="DIR", help="look at the scene from this model's first view")
    cameras.add_argument("--cameras", type=Path, metavar="JSON", help="look at it from the first camera of a 3DGS cameras.json")
    command.add_argument("--repeat", type=_positive, metavar="N", help="times each stage is run (default: 9)")
    command.add_argument("--quick", action="store_true", help="the smallest cases only, 3 times each")
    command.add_argument("--knobs", action="store_true", help="also run time against error for every constant that trades one for the other; needs a compiler")
    command.add_argument("--skips", action="store_true", help="also what each kind of work left undone saves")
    command.add_argument("--scaling", action="store_true", help="also forward time against pixels and Gaussians, up to 4K and 5 million")
    command.add_argument("--interactive", action="store_true", help="also pictures a second of a million Gaussians under an orbiting camera")
    command.add_argument("--stress", action="store_true", help="instead: errors of hostile scenes, and the drift of 1,000 steps, against float64")
    command.add_argument("--plots", type=Path, metavar="DIR", help="measure knobs and skips (unless --stress), and draw the charts there")


def _count(text: str) -> int:
    return _parsed(int, text, lambda value: value >= 0, "a whole number of 0 or more")


def _positive(text: str) -> int:
    return _parsed(int, text, lambda value: value > 0, "a whole number of 1 or more")


def _weight(text: str) -> float:
    return _parsed(float, text, lambda value: 0 <= value < float("inf"), "a weight of 0 or more")


def _gigabytes(text: str) -> float:
    return _parsed(float, text, lambda value: 0 <= value < float("inf"), "a number of gigabytes")


def _decibels(text: str) -> float:
    return _parsed(float, text, lambda value: 0 < value < float("inf"), "a number of dB above 0")


def _share(text: str) -> float:
    return _parsed(float, text, lambda value: 0 < value <= 1, "a share above 0 and up to 1")


def _schedule(text: str) -> float:
    return _parsed(float, text, lambda value: 0.001 <= value <= 10, "a factor of 0.001 to 10")


def _small_share(text: str) -> float:
    return _parsed(float, text, lambda value: 0 <= value < 1, "a share of 0 or more, below 1")


def _colour(text: str) -> tuple[float, float, float]:
    def three(text: str) -> tuple[float, ...]:
        return tuple(float(part) for part in text.split(","))

    return _parsed(three, text, lambda parts: len(parts) == 3 and all(0 <= part <= 1 for part in parts), "three numbers of 0..1 with commas between")


def _weights_file(text: str) -> Path:
    return _parsed(Path, text, Path.is_file, "a file that exists")


def _parsed(kind, text: str, good, wanted: str):
    """kind(text), or a usage error that says what was wanted."""
    try:
        value = kind(text)
    except ValueError:
        value = None
    if value is None or not good(value):
        raise argparse.ArgumentTypeError(f"'{text}' is not {wanted}")
    return value

"""The parser of the command line. Options of datasets, training and pruning come from prune/options.py."""

from __future__ import annotations

from .. import __version__
from ..native.outputs import PICTURES
from ..prune.options import OUTPUT, DatasetOptions, PruneOptions, TrainOptions
from ..prune.selection.options import SelectOptions
from ..system.option_kinds import COLOUR, PATH, POSITIVE
from .convert_options import ConvertOptions
from .farm_arguments import farm, large
from .option_parser import (
    Parser,
    add_flags,
    add_options,
    add_some,
    add_value,
    command_of,
    data_of,
    threads_of,
)


def parser() -> Parser:
    """The parser of `svrgs` with all its commands."""
    root = Parser(
        prog="svrgs",
        description="Makes 3D Gaussian splat scenes several times smaller, and measures the loss of quality.",
    )
    root.add_argument("--version", action="version", version=__version__)
    commands = root.add_subparsers(dest="command", required=True, metavar="COMMAND")
    adders = (
        _info, _render, _train, _prune, _select, _convert, _rig, _eval, _compare, _view, _methods, farm,
        large, _bench,
    )  # fmt: skip
    for add in adders:
        add(commands)
    return root


def _info(commands):
    text = "Describes a splat file: format, number of Gaussians, degree of the spherical harmonics."
    command = command_of(commands, "info", text)
    threads_of(command)
    add_value(command, "scene", PATH, "splat file")


def _render(commands):
    text = "Renders a scene from its cameras: colours, spatial mask, depth, alpha."
    command = command_of(commands, "render", text)
    threads_of(command)
    add_value(command, "scene", PATH, "splat file")
    cameras = command.add_mutually_exclusive_group(required=True)
    data_of(command, cameras, "dataset, COLMAP model or transforms.json; photographs are not needed")
    help_ = (
        'cameras.json of a 3DGS run, or transforms.json; in a view of the first with "orthographic": true, fx'
        " and fy are pixels per unit of length"
    )
    add_value(cameras, "--cameras", PATH, help_, metavar="JSON")
    command.add_argument(
        "--views",
        default="all",
        help="all, train, test, or names and numbers of views with commas between (default: all)",
    )
    command.add_argument(
        "--outputs", default="rgb", help=f"one or more of {','.join(PICTURES)} (default: rgb)"
    )
    command.add_argument(
        "--format",
        choices=("png", "exr", "npy"),
        default="png",
        help="file format; exr and npy hold exact values (default: png)",
    )
    help_ = "background colour, 0..1 each (default: black)"
    add_value(command, "--background", COLOUR, help_, default=(0.0, 0.0, 0.0))
    add_value(command, "--out", PATH, "folder to write the images to", metavar="DIR", required=True)


def _train(commands):
    text = "Trains a scene from photographs and the sparse points of their dataset."
    add_options(command_of(commands, "train", text, grouped=True), TrainOptions)


def _prune(commands):
    command = command_of(commands, "prune", "Prunes trained scenes and recovers their quality.", grouped=True)
    help_ = "splat file, or folder that holds a splat and its dataset, or folder that holds such folders"
    add_value(command, "scenes", PATH, help_, metavar="SCENE", nargs="+")
    add_options(command, PruneOptions, data=False)
    output = command.place(OUTPUT)
    help_ = "file for one scene, folder for several (default: SCENE_pruned.spz; a .ply keeps every value)"
    add_value(output, "--out", PATH, help_, metavar="FILE|DIR")
    help_ = "folder to write an HTML report to; with several scenes, one folder per scene in it"
    add_value(output, "--report", PATH, help_, metavar="DIR")
    add_flags(
        command.place(""),
        overwrite="with several scenes: prune those again whose output exists",
        batch=(
            "treat one scene like several: print one JSON line per scene and skip those whose output exists"
        ),
    )


def _select(commands):
    text = "Selects the Gaussians that fulfil all given criteria, counts them, and writes them to a file."
    command = command_of(commands, "select", text)
    add_value(command, "scene", PATH, "splat file")
    add_options(command, SelectOptions)


def _convert(commands):
    text = "Writes splats in another format; with --json, one JSON object for each."
    command = command_of(commands, "convert", text)
    help_ = "splat files, folders of them, or patterns such as 'captures/*.ply'"
    add_value(command, "inputs", PATH, help_, metavar="IN", nargs="+")
    help_ = (
        "file to write; with several inputs, a folder, and --to says the format, or the lod-meta.json of a"
        " streamed SOG, whose levels they become"
    )
    add_value(command, "out", PATH, help_, metavar="OUT")
    add_options(command, ConvertOptions)


def _rig(commands):
    text = "Places the cameras that prune uses for a scene without photographs."
    command = command_of(commands, "rig", text)
    threads_of(command)
    add_value(command, "scene", PATH, "splat file")
    help_ = "number of cameras, each chosen by what it sees (default: 192, those of prune)"
    add_value(command, "--views", POSITIVE, help_)
    add_some(command, PruneOptions, "seed")
    help_ = "cameras.json to write; those held out for testing come last"
    add_value(command, "--out", PATH, help_, metavar="JSON", required=True)
    add_value(command, "--preview", PATH, "picture of the cameras to write", metavar="PNG")


def _eval(commands):
    text = "Measures the quality of a scene on photographs: PSNR, SSIM, LPIPS, FLIP."
    command = command_of(commands, "eval", text)
    add_value(command, "scene", PATH, "splat file")
    add_options(command, DatasetOptions, leave_out=("image_memory",))  # it reads each photograph once
    command.add_argument(
        "--split",
        choices=("test", "train", "all"),
        default="test",
        help="views to measure on (default: test)",
    )
    add_flags(
        command,
        lpips_authors=(
            "measure LPIPS also with colours in [-1, 1], as its authors say; others give it [0, 1]"
        ),
        matched=(
            "measure PSNR also in the colours of the photographs, so that exposure does not count (cc-PSNR)"
        ),
        aligned="measure PSNR also after each view was moved to where the scene shows its photograph",
    )


def _compare(commands):
    text = "Compares two scenes: pictures, differences, spatial masks and figures of quality."
    command = command_of(commands, "compare", text)
    add_value(command, "a", PATH, "first splat file", metavar="A")
    add_value(command, "b", PATH, "second splat file", metavar="B")
    add_options(command, DatasetOptions, data=False)
    help_ = (
        "without --data: cameras.json of 3DGS, or transforms.json; B is measured against pictures of A"
        " (default: views that are placed)"
    )
    add_value(command, "--cameras", PATH, help_, metavar="JSON")
    help_ = "folder to write the pictures and the HTML page to"
    add_value(command, "--out", PATH, help_, metavar="DIR", required=True)


def _view(commands):
    text = "Shows one scene, or the original and the pruned one, in the browser, until Ctrl-C."
    command = command_of(commands, "view", text)
    add_value(
        command, "scenes", PATH, "splat file; a second one is wiped against it", metavar="SCENE", nargs="+"
    )
    add_options(command, DatasetOptions, leave_out=("image_memory", "lpips_weights"), data=False)
    help_ = "without --data: cameras.json of 3DGS, or transforms.json (default: one view that is placed)"
    add_value(command, "--cameras", PATH, help_, metavar="JSON")
    add_flags(
        command,
        nested="the last scene is a nested result (prune --nested): a slider shows fewer of its Gaussians",
        force="show scenes also where they explain little of the photographs",
    )
    add_value(command, "--port", POSITIVE, "port, or the next free one (default: 8080)", default=8080)
    add_flags(command, no_browser="only say the address")
    help_ = "instead, write a page into this folder that any web server shows"
    add_value(command, "--export", PATH, help_, metavar="DIR")


def _methods(commands):
    text = "Lists the methods: what each does, its paper, and what λ_F and λ_m mean for it."
    command_of(commands, "methods", text)


def _bench(commands):
    text = "Measures run time and numerical error, on generated scenes or a given one."
    command = command_of(commands, "bench", text)
    threads_of(command)
    help_ = "splat file to measure instead of the generated scenes"
    add_value(command, "--scene", PATH, help_, metavar="FILE")
    cameras = command.add_mutually_exclusive_group()
    data_of(command, cameras, "with --scene: use the first view of this COLMAP model or transforms.json")
    help_ = "with --scene: use the first camera of this 3DGS cameras.json"
    add_value(cameras, "--cameras", PATH, help_, metavar="JSON")
    add_value(command, "--repeat", POSITIVE, "number of times that each stage is measured (default: 9)")
    add_flags(
        command,
        quick="measure the smallest cases only, 3 times each",
        knobs="also measure other values of the constants that trade time for error; needs a C++ compiler",
        skips="also measure how much time each kind of skipped work saves",
        scaling="also measure forward time over image size, up to 4K, and over Gaussians, up to 5 million",
        cores=(
            "also measure the serial part of a picture and of a step, the speed-up of more threads, and"
            " foresee it for up to 64"
        ),
        interactive="also measure frames per second under an orbiting camera, and of a viewport",
        stress=(
            "instead: measure errors of extreme scenes, and the drift over 1,000 steps, against float64; with"
            " --scene: of this scene with extremes put into it"
        ),
    )
    help_ = "folder to write charts to; measures knobs and skips (unless --stress is given)"
    add_value(command, "--plots", PATH, help_, metavar="DIR")

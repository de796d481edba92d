"""The parser of the command line. Options of datasets, training and pruning come from prune/options.py."""

from __future__ import annotations

from .. import __version__
from ..native.outputs import PICTURES
from ..prune.options import OUTPUT, DatasetOptions, PruneOptions, TrainOptions
from ..prune.selection.options import SelectOptions
from ..system.file_names import extended
from ..system.option_kinds import COLOUR, POSITIVE, options_of
from .convert_options import ConvertOptions
from .farm_arguments import farm, large
from .option_parser import Parser, add_option, add_options, command_of, data_of, reader, threads_of


def parser() -> Parser:
    """The parser of `svrgs` with all its commands."""
    root = Parser(
        prog="svrgs",
        description="Makes 3D Gaussian splat scenes several times smaller, and measures the loss of quality.",
    )
    root.add_argument("--version", action="version", version=__version__)
    commands = root.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for add in (
        _info,
        _render,
        _train,
        _prune,
        _select,
        _convert,
        _rig,
        _eval,
        _compare,
        _view,
        _methods,
        farm,
        large,
        _bench,
    ):
        add(commands)
    return root


def _info(commands):
    command = command_of(
        commands,
        "info",
        "Describes a splat file: format, number of Gaussians, degree of the spherical harmonics.",
    )
    threads_of(command)
    command.add_argument("scene", type=extended, help="splat file")


def _render(commands):
    command = command_of(
        commands, "render", "Renders a scene from its cameras: colours, spatial mask, depth, alpha."
    )
    threads_of(command)
    command.add_argument("scene", type=extended, help="splat file")
    cameras = command.add_mutually_exclusive_group(required=True)
    data_of(command, cameras, "dataset, COLMAP model or transforms.json; photographs are not needed")
    cameras.add_argument(
        "--cameras",
        type=extended,
        metavar="JSON",
        help=(
            'cameras.json of a 3DGS run, or transforms.json; in a view of the first with "orthographic":'
            " true, fx and fy are pixels per unit of length"
        ),
    )
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
    command.add_argument(
        "--background",
        type=reader(COLOUR),
        default=(0.0, 0.0, 0.0),
        metavar="R,G,B",
        help="background colour, 0..1 each (default: black)",
    )
    command.add_argument(
        "--out", type=extended, required=True, metavar="DIR", help="folder to write the images to"
    )


def _train(commands):
    add_options(
        command_of(
            commands, "train", "Trains a scene from photographs and the sparse points of their dataset.", True
        ),
        TrainOptions,
    )


def _prune(commands):
    command = command_of(commands, "prune", "Prunes trained scenes and recovers their quality.", grouped=True)
    command.add_argument(
        "scenes", type=extended, nargs="+", metavar="SCENE",
        help="splat file, or folder that holds a splat and its dataset, or folder that holds such folders",
    )  # fmt: skip
    add_options(command, PruneOptions, data=False)
    command.place(OUTPUT).add_argument(
        "--out",
        type=extended,
        metavar="FILE|DIR",
        help="file for one scene, folder for several (default: SCENE_pruned.spz; a .ply keeps every value)",
    )
    command.place(OUTPUT).add_argument(
        "--report",
        type=extended,
        metavar="DIR",
        help="folder to write an HTML report to; with several scenes, one folder per scene in it",
    )
    command.place("").add_argument(
        "--overwrite", action="store_true", help="with several scenes: prune those again whose output exists"
    )
    command.place("").add_argument(
        "--batch",
        action="store_true",
        help="treat one scene like several: print one JSON line per scene and skip those whose output exists",
    )


def _select(commands):
    command = command_of(
        commands,
        "select",
        "Selects the Gaussians that fulfil all given criteria, counts them, and writes them to a file.",
    )
    command.add_argument("scene", type=extended, help="splat file")
    add_options(command, SelectOptions)


def _convert(commands):
    command = command_of(
        commands, "convert", "Writes splats in another format; with --json, one JSON object for each."
    )
    command.add_argument(
        "inputs",
        type=extended,
        nargs="+",
        metavar="IN",
        help="splat files, folders of them, or patterns such as 'captures/*.ply'",
    )
    command.add_argument(
        "out",
        type=extended,
        metavar="OUT",
        help=(
            "file to write; with several inputs, a folder, and --to says the format, or the lod-meta.json of"
            " a streamed SOG, whose levels they become"
        ),
    )
    add_options(command, ConvertOptions)


def _rig(commands):
    command = command_of(
        commands, "rig", "Places the cameras that prune uses for a scene without photographs."
    )
    threads_of(command)
    command.add_argument("scene", type=extended, help="splat file")
    command.add_argument(
        "--views",
        type=reader(POSITIVE),
        metavar="N",
        help="number of cameras, each chosen by what it sees (default: 192, those of prune)",
    )
    add_option(command, command, "seed", options_of(PruneOptions)["seed"], 0)
    command.add_argument(
        "--out",
        type=extended,
        required=True,
        metavar="JSON",
        help="cameras.json to write; those held out for testing come last",
    )
    command.add_argument("--preview", type=extended, metavar="PNG", help="picture of the cameras to write")


def _eval(commands):
    command = command_of(
        commands, "eval", "Measures the quality of a scene on photographs: PSNR, SSIM, LPIPS, FLIP."
    )
    command.add_argument("scene", type=extended, help="splat file")
    add_options(command, DatasetOptions, leave_out=("image_memory",))  # it reads each photograph once
    command.add_argument(
        "--split",
        choices=("test", "train", "all"),
        default="test",
        help="views to measure on (default: test)",
    )
    command.add_argument(
        "--lpips-authors",
        action="store_true",
        help="measure LPIPS also with colours in [-1, 1], as its authors say; others give it [0, 1]",
    )
    command.add_argument(
        "--matched",
        action="store_true",
        help="measure PSNR also in the colours of the photographs, so that exposure does not count (cc-PSNR)",
    )
    command.add_argument(
        "--aligned",
        action="store_true",
        help="measure PSNR also after each view was moved to where the scene shows its photograph",
    )


def _compare(commands):
    command = command_of(
        commands,
        "compare",
        "Compares two scenes: pictures, differences, spatial masks and figures of quality.",
    )
    command.add_argument("a", type=extended, metavar="A", help="first splat file")
    command.add_argument("b", type=extended, metavar="B", help="second splat file")
    add_options(command, DatasetOptions, data=False)
    help_ = (
        "without --data: cameras.json of 3DGS, or transforms.json; B is measured against pictures of A"
        " (default: views that are placed)"
    )
    command.add_argument("--cameras", type=extended, metavar="JSON", help=help_)
    command.add_argument(
        "--out",
        type=extended,
        required=True,
        metavar="DIR",
        help="folder to write the pictures and the HTML page to",
    )


def _view(commands):
    command = command_of(
        commands, "view", "Shows one scene, or the original and the pruned one, in the browser, until Ctrl-C."
    )
    command.add_argument(
        "scenes",
        type=extended,
        nargs="+",
        metavar="SCENE",
        help="splat file; a second one is wiped against it",
    )
    add_options(command, DatasetOptions, leave_out=("image_memory", "lpips_weights"), data=False)
    command.add_argument(
        "--cameras",
        type=extended,
        metavar="JSON",
        help="without --data: cameras.json of 3DGS, or transforms.json (default: one view that is placed)",
    )
    command.add_argument(
        "--nested",
        action="store_true",
        help="the last scene is a nested result (prune --nested): a slider shows fewer of its Gaussians",
    )
    command.add_argument(
        "--force", action="store_true", help="show scenes also where they explain little of the photographs"
    )
    command.add_argument(
        "--port",
        type=reader(POSITIVE),
        default=8080,
        metavar="N",
        help="port, or the next free one (default: 8080)",
    )
    command.add_argument("--no-browser", action="store_true", help="only say the address")
    command.add_argument(
        "--export",
        type=extended,
        metavar="DIR",
        help="instead, write a page into this folder that any web server shows",
    )


def _methods(commands):
    command_of(
        commands, "methods", "Lists the methods: what each does, its paper, and what λ_F and λ_m mean for it."
    )


def _bench(commands):
    command = command_of(
        commands, "bench", "Measures run time and numerical error, on generated scenes or a given one."
    )
    threads_of(command)
    command.add_argument(
        "--scene", type=extended, metavar="FILE", help="splat file to measure instead of the generated scenes"
    )
    cameras = command.add_mutually_exclusive_group()
    data_of(command, cameras, "with --scene: use the first view of this COLMAP model or transforms.json")
    cameras.add_argument(
        "--cameras",
        type=extended,
        metavar="JSON",
        help="with --scene: use the first camera of this 3DGS cameras.json",
    )
    command.add_argument(
        "--repeat",
        type=reader(POSITIVE),
        metavar="N",
        help="number of times that each stage is measured (default: 9)",
    )
    command.add_argument("--quick", action="store_true", help="measure the smallest cases only, 3 times each")
    command.add_argument(
        "--knobs",
        action="store_true",
        help="also measure other values of the constants that trade time for error; needs a C++ compiler",
    )
    command.add_argument(
        "--skips", action="store_true", help="also measure how much time each kind of skipped work saves"
    )
    command.add_argument(
        "--scaling",
        action="store_true",
        help="also measure forward time over image size, up to 4K, and over Gaussians, up to 5 million",
    )
    help_ = (
        "also measure the serial part of a picture and of a step, the speed-up of more threads, and foresee"
        " it for up to 64"
    )
    command.add_argument("--cores", action="store_true", help=help_)
    command.add_argument(
        "--interactive",
        action="store_true",
        help="also measure frames per second under an orbiting camera, and of a viewport",
    )
    command.add_argument(
        "--stress",
        action="store_true",
        help=(
            "instead: measure errors of extreme scenes, and the drift over 1,000 steps, against float64;"
            " with --scene: of this scene with extremes put into it"
        ),
    )
    command.add_argument(
        "--plots",
        type=extended,
        metavar="DIR",
        help="folder to write charts to; measures knobs and skips (unless --stress is given)",
    )

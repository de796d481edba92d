"""Photographs with troubles, on a generated scene whose truth is known: what a remedy wins back; and real
ones as they are, which no remedy may harm.

    .venv/bin/python benchmarks/photographs.py people|exposure|poses|turntable [--scene demo=DIR] [--shrink 2]
    .venv/bin/python benchmarks/photographs.py auto --scene NAME=DIR --targets 0.25 --seeds 3

people: a person stands in every other photograph, somewhere else in each. exposure: each photograph has
another exposure, ±0.3 EV, and another white balance, about ±300 K. poses: each training camera is turned by
0.2 degrees and moved by 0.3 % of the scene's extent, in random directions. turntable: the middle of the scene
turns, and the wall behind it looks the same in every photograph. A scene that was trained on the clean
photographs is pruned on these, with and without the remedy, and on the clean ones. Each row is measured on
the clean test views. auto: the same without a trouble, with exposure and poses off and auto. Figures are
means over seeds, and half their range; processor seconds are those of a prune.
"""

from __future__ import annotations

import argparse
import itertools
import math
import resource
from pathlib import Path
from statistics import fmean

import numpy as np

from cost import svrgs
from method_report import half_range
from method_scenes import prepared
from svrgs_addon.files.images import linear_to_srgb, read_image, read_pixels, srgb_to_linear, write_image
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.scene.camera import Camera
from svrgs_addon.views.dataset import load_dataset

ROOT = Path(__file__).resolve().parents[1]
TARGETS = ("1", "0.25", "0.1")


def person(height: int, width: int, rng: np.random.Generator) -> np.ndarray:
    """Where a person stands, (H, W) bool: a head above a body, a twelfth of the picture."""
    y, x = np.mgrid[0.5:height, 0.5:width] / height
    middle, top = rng.uniform(0.15, 0.85) * width / height, rng.uniform(0.2, 0.4)
    body = ((x - middle) / 0.09) ** 2 + ((y - top - 0.35) / 0.28) ** 2 < 1
    return body | (((x - middle) / 0.05) ** 2 + ((y - top) / 0.07) ** 2 < 1)


def crowd(images: Path, troubled: Path, masks: Path):
    """Copies of the photographs in which a person stands in every other one, and the masks."""
    rng = np.random.default_rng(0)
    for number, photo in enumerate(sorted(images.rglob("*.*"))):
        pixels = read_pixels(photo)
        there = person(*pixels.shape[:2], rng) if number % 2 else np.zeros(pixels.shape[:2], bool)
        cloth = rng.integers(0, 256, 3) + rng.normal(0, 12, pixels.shape)
        pixels = np.where(there[..., None], cloth.clip(0, 255).astype(np.uint8), pixels)
        name = photo.relative_to(images)
        write_image((troubled / name).with_suffix(".png"), pixels)
        write_image((masks / name).with_suffix(".png"), np.where(there, 0, 255).astype(np.uint8))


def drift(images: Path, troubled: Path):
    """Copies of the photographs, each with gains of its own in linear light."""
    rng = np.random.default_rng(0)
    for photo in sorted(images.rglob("*.*")):
        exposure, warmth = 2 ** rng.uniform(-0.3, 0.3), rng.uniform(-0.06, 0.06)
        gains = exposure * np.array([1 + warmth, 1, 1 - warmth], np.float32)
        pixels = linear_to_srgb(srgb_to_linear(read_image(photo)) * gains)
        write_image((troubled / photo.relative_to(images)).with_suffix(".png"), pixels)


def shake(data: Path, shaken: Path):
    """A copy of a COLMAP model whose training cameras are off."""
    import pycolmap

    model = pycolmap.Reconstruction(next(path.parent for path in sorted(data.rglob("images.*"))))
    dataset, rng = load_dataset(data), np.random.default_rng(0)
    places = {camera.name: place for place, camera in enumerate(dataset.cameras)}
    for image in model.images.values():
        if places[image.name] not in dataset.train_indices:
            continue
        turn, move = (motion / np.linalg.norm(motion) for motion in rng.normal(size=(2, 3)))
        motion = np.concatenate([np.radians(0.2) * turn, 0.003 * dataset.extent * move])
        viewmat = dataset.cameras[places[image.name]].displaced(motion).viewmat
        image.frame.rig_from_world = pycolmap.Rigid3d(viewmat[:3])
    (shaken / "sparse" / "0").mkdir(parents=True, exist_ok=True)
    model.write(shaken / "sparse" / "0")


def turn(trained: Path, clean: list[str], work: Path) -> tuple[list[str], list[str], Path]:
    """What is near the middle of a trained scene, and photographs of it alone and before a wall. Returns the
    flags of the former, with which it is measured on its own pixels alone, and the file of the splat."""
    dataset, scene = load_dataset(*clean[1::2]), read_scene(trained)
    middle, reach = gaze(dataset.cameras)
    splat, r = work / "object.ply", Rasterizer()
    thing = scene.select(np.flatnonzero(np.linalg.norm(scene.means - middle, axis=1) < 0.5 * reach))
    write_scene(splat, thing)
    wall = dataset.image(0) / np.float32(255)
    for camera in dataset.cameras:
        shown = r.forward(thing, camera, render_options(thing), outputs=("rgb", "alpha"))
        name, alpha = Path(camera.name).with_suffix(".png"), shown["alpha"][..., None]
        solid, colours = alpha > 0.5, (shown["rgb"] / np.maximum(alpha, 0.5)).clip(0, 1)
        behind = wall[: camera.height, : camera.width]
        write_image(work / "object" / name, np.where(solid, colours, np.float32(0)))
        write_image(work / "turntable" / name, np.where(solid, colours, behind))
        write_image(work / "turntable-masks" / name, np.where(solid[..., 0], 255, 0).astype(np.uint8))
    alone = [*clean[:2], "--images", str(work / "object")]
    return alone, [*alone, "--masks", str(work / "turntable-masks")], splat


def gaze(cameras: list[Camera]) -> tuple[np.ndarray, float]:
    """The point to which cameras look, nearest to all of their axes, and their mean distance from it."""
    axes = np.array([camera.viewmat[2, :3] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None]
    places = np.array([camera.position for camera in cameras])
    middle = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, places))
    return middle, float(np.linalg.norm(places - middle, axis=1).mean())


def ways_of(trouble: str, images: Path, work: Path, data: list[str]) -> dict[str, list]:
    """The flags of svrgs prune for each way to prune, by its name. data: the flag --data."""
    if trouble == "auto":
        photographs = [*data, "--images", images]
        return {"off": [*photographs, "--exposure", "off", "--refine-poses", "off"], "auto": photographs}
    troubled = [*data, "--images", work / trouble]
    if trouble == "poses":
        shake(Path(data[1]), work / "shaken")
        shaken = ["--data", work / "shaken", "--images", images]
        return {"shaken": [*shaken, "--refine-poses", "off"], "shaken, poses refined": shaken}
    if trouble == "turntable":
        troubled, masks = [*data, "--images", work / trouble], ["--masks", work / "turntable-masks"]
        return {
            "turntable": troubled,
            "turntable, masks": [*troubled, *masks],
            "turntable, masked out painted": [*troubled, *masks, "--outside", "background"],
        }
    if trouble == "people":
        crowd(images, work / trouble, work / "people-masks")
        return {
            "people": troubled,
            "people, distractors masked": [*troubled, "--mask-distractors"],
            "people, masks": [*troubled, "--masks", work / "people-masks"],
        }
    drift(images, work / trouble)
    return {"drift": [*troubled, "--exposure", "off"], "drift, exposure fitted": troubled}


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("trouble", choices=("people", "exposure", "poses", "turntable", "auto"))
    parser.add_argument("--scene", default="demo", metavar="NAME=DIR")
    parser.add_argument("--shrink", type=int, default=2)
    parser.add_argument("--schedule", default="0.1")
    parser.add_argument("--targets", nargs="+", default=TARGETS)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "photographs")
    options = parser.parse_args()
    name, _, folder = options.scene.partition("=")
    work = options.work.resolve() / name
    clean = prepared(name, Path(folder) if folder else None, work, options.shrink)
    trained, images = work / "trained.ply", Path(clean[-1])
    images = images if len(clean) > 2 else images / "images"
    if not trained.exists():
        svrgs("train", *clean, "--schedule", options.schedule, "--out", trained, "--quiet")
    truth = clean
    if options.trouble == "turntable":
        clean, truth, trained = turn(trained, clean, work)
    ways = {} if options.trouble == "auto" else {"clean photographs": clean}
    ways |= ways_of(options.trouble, images, work, clean[:2])
    before = svrgs("eval", trained, *truth)["psnr"] or math.inf
    print(f"{name}: {before:.2f} dB before\n\n| kept | {' | '.join(ways)} |\n|---|" + "---|" * len(ways))
    seconds = {way: list[float]() for way in ways}
    for target in options.targets:
        found = {way: list[float]() for way in ways}
        for seed, (way, data) in itertools.product(range(options.seeds), ways.items()):
            out, started = work / f"{way}-{target}.ply", processor_seconds()
            words = ["--target", target, "--schedule", options.schedule, "--seed", seed, "--out", out]
            svrgs("prune", trained, *data, *words, "--quiet", "--force", "--overwrite")
            seconds[way].append(processor_seconds() - started)
            found[way].append(svrgs("eval", out, *truth)["psnr"])
        print(f"| {float(target):.1%} | {' | '.join(map(in_words, found.values()))} |", flush=True)
    print(f"| processor seconds | {' | '.join(f'{fmean(values):.0f}' for values in seconds.values())} |")


def processor_seconds() -> float:
    """Of all commands that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def in_words(values: list[float]) -> str:
    """The mean of PSNR; of several seeds also half their range."""
    return f"{fmean(values):.2f}" + (f" ± {half_range(values):.2f}" if len(values) > 1 else "")


if __name__ == "__main__":
    main()

"""The figures of docs/rendering.md: errors, steps and time of panoramas, and time of meshes. Prints Markdown.

    .venv/bin/python benchmarks/rendering.py            # a generated room of 150,000 Gaussians
    .venv/bin/python benchmarks/rendering.py --scene SPLAT --data DATASET --view 10   # from one camera

error   |rgb - reference| in levels of 255 at 400 pixels; reference: the middle of a view of 50 degrees in
that direction, in float64 step    change of a pixel, in levels, if it is drawn with the shares that the views
have in the next pixel
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from svrgs_addon.files.registry import load_scene
from svrgs_addon.native.library import set_threads
from svrgs_addon.native.pictures import add_view
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.render.composite import composite
from svrgs_addon.render.meshes import Triangles, surface
from svrgs_addon.render.panorama import Panorama, composite_panorama, directions, patches
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import PARAMETERS
from svrgs_addon.views.colmap import find_model, read_model
from svrgs_bench.scenes import orbit_camera, room

PIXELS = 400
CUBE = (6, 52.0, 45.0)  # views, half of their angle, angle from which they fade
MORE = (26, 32.0, 22.0)


def facing(forward: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) to a view of this unit direction."""
    up = np.array([0, -1.0, 0]) if abs(forward[1]) < 0.9 else np.array([0, 0, 1.0])
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    return np.stack([right, np.cross(forward, right), forward])


def view(panorama: Panorama, turn: np.ndarray, side: int) -> Camera:
    """A square view with pixels of the panorama's size."""
    viewmat = np.eye(4)
    viewmat[:3] = turn @ panorama.viewmat[:3]
    return Camera(
        viewmat,
        np.array([[panorama.focal, 0, side / 2], [0, panorama.focal, side / 2], [0, 0, 1]]),
        side,
        side,
    )


def reference(scene, panorama: Panorama, rays: np.ndarray) -> np.ndarray:
    """Colours (P, 3) of directions (P, 3)."""
    rasterizer, side = Rasterizer("float64"), 2 * int(np.tan(np.radians(25)) * panorama.focal) + 1
    exact = SimpleNamespace(
        **{name: np.array(getattr(scene, name), np.float64, order="C") for name in PARAMETERS}
    )
    options = RenderOptions(antialiased=scene.antialiased)
    return np.stack(
        [
            rasterizer.forward(exact, view(panorama, facing(ray), side), options)["rgb"][side // 2, side // 2]
            for ray in rays
        ]
    )


def blended(scene, panorama: Panorama, rays: np.ndarray, kind: tuple[int, float, float]) -> np.ndarray:
    """Colours (P, 3) of directions from views along the axes, edges and corners of a cube, faded between two
    angles (nearest pixels)."""
    count, half, inner = kind
    grid = np.array(
        [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1.0, 0, 1) if (x, y, z) != (0, 0, 0)]
    )
    axes = grid[np.abs(grid).sum(axis=1) <= (1 if count == 6 else 3)]
    edge, fade, sums = np.tan(np.radians(half - 1)), np.tan(np.radians(inner)), np.zeros((len(rays), 4))
    for axis in axes:
        turn, side = facing(axis / np.linalg.norm(axis)), int(2 * np.tan(np.radians(half)) * panorama.focal)
        rgb = composite(Rasterizer(), scene, view(panorama, turn, side)).rgb
        x, y, z = (rays @ turn.T).T
        apart = np.where(z > 0, np.maximum(abs(x), abs(y)) / np.maximum(z, 1e-9), np.inf)
        seen = apart < edge
        column, row = (
            np.floor(panorama.focal * value[seen] / z[seen] + side / 2).astype(int) for value in (x, y)
        )
        weight = np.clip((edge - apart[seen]) / (edge - fade), 0, 1)[:, None]
        sums[seen] += weight * np.concatenate([rgb[row, column], np.ones((seen.sum(), 1))], axis=1)
    return sums[:, :3] / sums[:, 3:]


def largest_step(panorama: Panorama, draw: Callable) -> float:
    """In levels of 255, to the next column and to the next row."""
    sums = np.zeros((3, panorama.height, panorama.width, 4), np.float32)
    for patch in patches(panorama):
        rgb = draw(patch.camera).rgb
        image = np.concatenate([rgb, np.ones_like(rgb[..., :1])], axis=2)
        rows, columns = patch.row_weights, patch.column_weights
        below, beside = (np.where(weights > 0, np.append(weights[1:], 0), 0) for weights in (rows, columns))
        for number, weights in enumerate(((rows, columns), (below, columns), (rows, beside))):
            add_view(
                image,
                patch.turn,
                patch.camera.K,
                -1,
                sums[number],
                panorama.latitudes,
                panorama.longitudes,
                *weights,
            )
    plain, below, beside = (part[..., :3] / np.maximum(part[..., 3:], 1e-6) for part in sums)
    return 255 * max(np.abs(below - plain)[:-1].max(), np.abs(beside - plain)[:, :-1].max())


def panorama_rows(scene, viewmat: np.ndarray) -> Iterator[str]:
    def draw(camera: Camera):
        return composite(rasterizer, scene, camera)

    rasterizer, rng = Rasterizer(), np.random.default_rng(0)
    small, large = (Panorama(viewmat, width, width // 2) for width in (1024, 4096))
    rows, columns = rng.integers(51, 461, PIXELS), rng.integers(0, 1024, PIXELS)
    rays = directions(small.latitudes[rows], small.longitudes[columns])
    known, found = reference(scene, small, rays), composite_panorama(draw, small).rgb[rows, columns]
    errors = [
        255 * np.abs(colors - known).mean()
        for colors in (blended(scene, small, rays, CUBE), blended(scene, small, rays, MORE), found)
    ]
    started = time.process_time()
    composite_panorama(draw, large)
    seconds = time.process_time() - started
    steps = [largest_step(panorama, draw) for panorama in (small, large)]
    yield (
        "| Gaussians | error, 6 views | error, 26 views | error, here | step at 1024 | step at 4096 | CPU"
        " seconds at 4096 x 2048 |"
    )
    yield "|---|---|---|---|---|---|---|"
    yield (
        f"| {scene.count:,} | {errors[0]:.1f} | {errors[1]:.1f} | {errors[2]:.1f} | {steps[0]:.1f} |"
        f" {steps[1]:.1f} | {seconds:.0f} |"
    )


def ball(rings: int) -> Triangles:
    """A sphere of 4 rings^2 triangles."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 2 * rings + 1), np.linspace(0, np.pi, rings + 1))
    points = 1.2 * np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], -1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    corners = np.concatenate(
        [np.stack([a, b, c], 2).reshape(-1, 3, 3), np.stack([a, c, d], 2).reshape(-1, 3, 3)]
    ).astype(np.float32)
    count = len(corners)
    arrays = (
        corners,
        np.full((count, 3, 3), 0.5, np.float32),
        np.zeros((count, 3, 2), np.float32),
        np.full(count, -1, np.int32),
        np.zeros(count, bool),
    )
    return Triangles(arrays[0], *arrays)


def mesh_rows() -> Iterator[str]:
    yield "| triangles at 1920 x 1080 | CPU seconds on one thread |"
    yield "|---|---|"
    for rings in (55, 500):
        mesh = ball(rings)
        started = time.process_time()
        surface(mesh, orbit_camera(1920, 1080))
        yield f"| {len(mesh.corners):,} | {time.process_time() - started:.2f} |"


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", type=Path)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--view", type=int, default=0, help="number of the camera, in name order")
    options = parser.parse_args()
    scene, viewmat = room(150_000), np.eye(4)
    viewmat[:3, 3] = 0.3, 0.2, 0.5
    if options.scene:
        scene = load_scene(options.scene)
        viewmat = read_model(find_model(options.data)).views[options.view].viewmat
    print(*panorama_rows(scene, viewmat), "", sep="\n")
    set_threads(1)
    print(*mesh_rows(), sep="\n")


if __name__ == "__main__":
    main()

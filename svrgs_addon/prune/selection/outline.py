"""Gaussians inside an outline that was drawn over a view: a polygon, or the stroke of a round brush."""

from __future__ import annotations

import os
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np

from ...native.library import near_depth
from ...native.rasterizer import Rasterizer
from ...render.metrics.evaluate import render_options
from ...scene.camera import Camera
from ...scene.gaussians import Scene
from ...system.errors import Cancelled

CHUNK = 1 << 14  # centres that a thread judges at a time
SHOWN = 0.1  # alpha T in a pixel, from which on the pixel shows the Gaussian


def polygon(points: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W) bool: the pixels whose centres are inside a polygon with these corners (P, 2) in pixels, x to
    the right and y down; where it overlaps itself, by the even-odd rule."""
    crossings = np.zeros((height, width + 1), np.uint8)  # their parity
    for (x0, y0), (x1, y1) in zip(points, np.roll(points, -1, axis=0), strict=True):
        first, last = (int(np.clip(np.ceil(y - 0.5), 0, height)) for y in sorted((y0, y1)))
        if first < last:
            rows = np.arange(first, last)
            x = x0 + (rows + 0.5 - y0) * (x1 - x0) / (y1 - y0)
            crossings[rows, np.clip(np.ceil(x - 0.5), 0, width).astype(int)] ^= 1
    return np.bitwise_xor.accumulate(crossings[:, :-1], axis=1).astype(bool)


def brush(path: np.ndarray, radius: float, width: int, height: int) -> np.ndarray:
    """(H, W) bool: the pixels whose centres are within the radius of a path (P, 2) of straight lines."""
    mask = np.zeros((height, width), bool)
    for start, end in zip(path, path[1:] if len(path) > 1 else path, strict=False):
        low = np.clip(np.floor(np.minimum(start, end) - radius), 0, (width, height)).astype(int)
        high = np.clip(np.ceil(np.maximum(start, end) + radius), 0, (width, height)).astype(int)
        y, x = np.mgrid[low[1] : high[1], low[0] : high[0]] + 0.5
        along = end - start
        share = ((x - start[0]) * along[0] + (y - start[1]) * along[1]) / max(1e-12, along @ along)
        share = np.clip(share, 0, 1)
        away = np.hypot(x - start[0] - share * along[0], y - start[1] - share * along[1])
        mask[low[1] : high[1], low[0] : high[0]] |= away <= radius
    return mask


def centres_in(means: np.ndarray, camera: Camera, pixels: np.ndarray, matrix=np.eye(4)) -> np.ndarray:
    """(N,) bool: the Gaussians whose centres (N, 3) are in one of the pixels (H, W) bool of the camera, and
    in front of it.

    matrix: (4, 4), from the coordinates of the means to those of the camera, whose unit is in the latter.
    """
    # in float32, from a point near the camera (at it, unless the matrix is flat): half the time of float64
    moved = camera.viewmat @ matrix
    moved[:2] = camera.K[:2, :2] @ moved[:2]
    origin = np.linalg.lstsq(moved[:3, :3], -moved[:3, 3], rcond=None)[0].astype(np.float32)
    turned, shift = moved[:3, :3].astype(np.float32), (moved[:3] @ (*origin, 1)).astype(np.float32)[:, None]
    near = near_depth(camera.unit)
    centre, inside, shown = camera.K[:2, 2:].astype(np.float32), np.empty(len(means), bool), pixels.ravel()

    def judge(rows: slice):
        places = turned @ (means[rows] - origin).T + shift
        front = places[2] > near
        with np.errstate(all="ignore"):  # of those that are not in front
            places = places[:2] if camera.orthographic else places[:2] / places[2]
            # as unsigned numbers, negative ones are larger than any side of the picture
            column, row = np.floor(places + centre).astype(np.int32).view(np.uint32)
        front &= (column < camera.width) & (row < camera.height)
        inside[rows] = front & shown.take(row * np.uint32(camera.width) + column, mode="clip")

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(judge, (slice(k, k + CHUNK) for k in range(0, len(means), CHUNK))))
    return inside


class RenderedView:
    """A view of a scene, and which Gaussians its pixels show."""

    def __init__(self, scene: Scene, camera: Camera):
        self._scene, self._camera = scene, camera
        self._begun: Future | None = None

    def begin(self):
        """Renders the view in a thread, while an outline is still drawn. The scene must stay unchanged until
        shown_in(), which then takes less time."""
        self._begun = _thread().submit(self._render)

    def shown_in(self, pixels: np.ndarray) -> np.ndarray:
        """(N,) bool: the Gaussians that one of the pixels (H, W) bool of the camera shows. Raises
        SplatError."""
        if self._begun:
            if not self._begun.done():  # it is quicker to stop it, and to render these pixels alone
                _rasterizer().cancel[0] = 1
            with suppress(Cancelled):
                self._begun.result()
            _rasterizer().cancel[0] = 0
        return _thread().submit(self._shown, pixels).result()

    def _render(self):
        self._forward(self._camera)
        _rasterizer().add_scores(max_=np.zeros(self._scene.count, np.float32))  # kept for whole tiles
        _last[:] = [self]

    def _forward(self, camera: Camera):
        _last.clear()
        options = replace(render_options(self._scene), sh_degree=0, stop=SHOWN)
        _rasterizer().forward(self._scene, camera, options, outputs=())

    def _shown(self, pixels: np.ndarray) -> np.ndarray:
        largest = np.zeros(self._scene.count, np.float32)
        if _last == [self]:
            _rasterizer().add_scores(max_=largest, pixels=pixels.astype(np.uint8))
        else:
            self._forward(self._camera.masked(pixels))
            _rasterizer().add_scores(max_=largest)
        return largest >= SHOWN


@cache
def _rasterizer() -> Rasterizer:
    """One for all views: to get its memory takes as long as the picture."""
    return Rasterizer()


@cache
def _thread() -> ThreadPoolExecutor:
    """That of _rasterizer(), which only one may use at a time."""
    return ThreadPoolExecutor(1, "svrgs-select")


_last: list[RenderedView] = []  # the one that was rendered last, if it was rendered whole

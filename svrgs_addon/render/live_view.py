"""Pictures of a view, drawn by a thread, for the viewports of Blender. No bpy.

It draws the newest view: first coarse (every 4th pixel in x and y), then exact. The main thread takes
finished pictures and never waits.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..native.rasterizer import Rasterizer
from ..system.errors import Cancelled

COARSE = 4  # a pixel of the coarse picture covers 4 x 4 pixels of the view


@dataclass(frozen=True)
class Picture:
    """The result of a request, or its error."""

    key: Any  # of the request
    reduction: int  # 1: exact; else a pixel covers reduction x reduction pixels of the view
    result: Any = None
    error: Exception | None = None


class LiveView:
    """A thread that draws the newest request. The main thread requests views and takes pictures; it never
    waits.

    draw: called in the thread as draw(rasterizer, job, reduction); its result becomes Picture.result. It must
    raise Cancelled when rasterizer.cancel[0] is set. reductions: the pictures that are drawn for each
    request, in this order; the last one is 1.
    """

    def __init__(
        self, draw: Callable[[Rasterizer, Any, int], Any], reductions: tuple[int, ...] = (COARSE, 1)
    ):
        self._draw, self._reductions = draw, reductions
        self._rasterizer = Rasterizer()
        self._changed = threading.Condition()
        self._wanted: tuple[object, Any] | None = None  # key, job
        self._started: object = None  # key of the request that is being drawn or was drawn last
        self._reduction = 0  # of the picture that is being drawn
        self._picture: Picture | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="svrgs-view", daemon=True)
        self._thread.start()

    def request(self, key: object, job: Any):
        """Requests a view. Requests with equal keys have the same picture, so a repeated one is ignored. An
        exact picture of an older view is cancelled. A coarse one is finished and shown."""
        with self._changed:
            if self._wanted is not None and self._wanted[0] == key:
                return
            self._wanted = key, job
            if self._reduction == 1:
                self._rasterizer.cancel[0] = 1
            self._changed.notify_all()

    def cancel(self):
        """Gives up the picture that is being drawn. Until the next request nothing is drawn."""
        with self._changed:
            self._wanted = self._started = None
            self._rasterizer.cancel[0] = 1

    def picture(self) -> Picture | None:
        """The newest finished picture; None before the first one."""
        with self._changed:
            return self._picture

    @property
    def busy(self) -> bool:
        """Whether the exact picture of the newest request, or its error, is still missing."""
        with self._changed:
            done = self._picture
            return self._wanted is not None and not (
                done is not None and done.key == self._wanted[0] and done.reduction == 1
            )

    def close(self):
        """Cancels the running picture, ends the thread and waits until it has ended."""
        with self._changed:
            self._closed = True
            self._rasterizer.cancel[0] = 1
            self._changed.notify_all()
        self._thread.join()

    def _run(self):
        """The thread: waits for a new request and draws its pictures, until close()."""
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._closed or (self._wanted is not None and self._wanted[0] != self._started)
                )
                if self._closed:
                    return
                assert self._wanted is not None
                key, job = self._wanted
                self._started = key
            for reduction in self._reductions:
                if not self._attempt(key, job, reduction):
                    break

    def _attempt(self, key, job, reduction: int) -> bool:
        """Draws one picture. Returns False, to skip the others, after an error or a newer request."""
        with self._changed:
            if reduction == 1 and not self._wants(key):
                self._started = None  # it may be wanted again
                return False
            self._rasterizer.cancel[0], self._reduction = self._closed, reduction
        try:
            picture = Picture(key, reduction, self._draw(self._rasterizer, job, reduction))
        except Cancelled:
            with self._changed:
                self._started = None
            return False
        except Exception as error:  # noqa: BLE001 - the viewport shows every error; the thread must not end
            picture = Picture(key, 1, error=error)
        with self._changed:
            self._picture = picture
            if not self._wants(key):
                self._started = None
                return False
            return picture.error is None

    def _wants(self, key: object) -> bool:
        return self._wanted is not None and self._wanted[0] == key

"""Pictures of a view that may move on before they are done: a coarse one at once, the exact one when it rests."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from ..errors import Cancelled
from ..native import Rasterizer

COARSE = 4  # x 4 pixels in one of a coarse picture


@dataclass(frozen=True)
class Picture:
    """What a request came to."""

    key: object  # of the request
    reduction: int  # COARSE, or 1: exact
    result: object = None
    error: Exception | None = None


class LiveView:
    """One thread that draws the newest request; the main thread asks for pictures and never waits.

    draw: (rasterizer, job, reduction) to what a picture holds; it runs in that thread and must stop with Cancelled once
    rasterizer.cancel[0] is set. reductions: of the pictures of a request, the last one being 1.
    """

    def __init__(self, draw: Callable[[Rasterizer, object, int], object], reductions: tuple[int, ...] = (COARSE, 1)):
        self._draw, self._reductions = draw, reductions
        self._rasterizer = Rasterizer()
        self._changed = threading.Condition()
        self._wanted: tuple[object, object] | None = None  # key, job
        self._started: object = None  # key of the request that is being drawn or was drawn last
        self._reduction = 0  # of the picture that is being drawn
        self._picture: Picture | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="svrgs-view", daemon=True)
        self._thread.start()

    def request(self, key: object, job: object):
        """Asks for a view; the exact picture of another one is given up, a coarse one still shown. Equal keys: the same picture."""
        with self._changed:
            if self._wanted is not None and self._wanted[0] == key:
                return
            self._wanted = key, job
            if self._reduction == 1:
                self._rasterizer.cancel[0] = 1
            self._changed.notify_all()

    def picture(self) -> Picture | None:
        """The newest one; None before the first."""
        with self._changed:
            return self._picture

    @property
    def busy(self) -> bool:
        """Whether a better picture of what was asked for last is to come."""
        with self._changed:
            done = self._picture
            return self._wanted is not None and not (done is not None and done.key == self._wanted[0] and done.reduction == 1)

    def close(self):
        """Ends the thread, and waits for that."""
        with self._changed:
            self._closed = True
            self._rasterizer.cancel[0] = 1
            self._changed.notify_all()
        self._thread.join()

    def _run(self):
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or (self._wanted is not None and self._wanted[0] != self._started))
                if self._closed:
                    return
                assert self._wanted is not None
                key, job = self._wanted
                self._started = key
            for reduction in self._reductions:
                if not self._attempt(key, job, reduction):
                    break

    def _attempt(self, key, job, reduction: int) -> bool:
        """Draws; False if the view has moved on meanwhile, or nothing can be drawn."""
        with self._changed:
            if reduction == 1 and not self._wants(key):
                return False
            self._rasterizer.cancel[0], self._reduction = self._closed, reduction
        try:
            picture = Picture(key, reduction, self._draw(self._rasterizer, job, reduction))
        except Cancelled:
            return False
        except Exception as error:  # noqa: BLE001 - whatever it is, the viewport says so instead of stopping for ever
            picture = Picture(key, 1, error=error)
        with self._changed:
            self._picture = picture
            return picture.error is None and self._wants(key)

    def _wants(self, key: object) -> bool:
        return self._wanted is not None and self._wanted[0] == key

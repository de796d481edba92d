"""Short work of a child process that a thread waits for, so that Blender stays usable. A timer then goes on
in the main thread."""

from __future__ import annotations

import threading
from collections.abc import Callable

import bpy

INTERVAL = 0.1  # seconds between two looks whether it is done


class ChildWork:
    """The threads of one kind of work. They must not use bpy.

    done: called in the main thread after one or several of them have ended. looked: called at each look.
    detached: the threads end with Blender, and close() does not wait for them.
    """

    def __init__(
        self,
        done: Callable[[], None],
        looked: Callable[[], None] | None = None,
        interval: float = INTERVAL,
        detached: bool = False,
    ):
        self._done, self._looked, self._interval, self._detached = done, looked, interval, detached
        self._threads: list[threading.Thread] = []
        self.waits = bpy.app.background  # without a window there are no timers, so start() waits
        # Blender knows a timer by its object, and self.tick is another one each time
        self._timer = self.tick

    def start(self, work: Callable, *words):
        """Calls work(*words) in a thread. In background mode, it returns after done()."""
        thread = threading.Thread(target=work, args=words, daemon=self._detached)
        self._threads.append(thread)
        thread.start()
        if self.waits:
            thread.join()
            self.tick()
        elif not bpy.app.timers.is_registered(self._timer):
            # another file may be opened meanwhile
            bpy.app.timers.register(self._timer, first_interval=self._interval, persistent=True)

    def close(self):
        """Ends the waiting, without calling done()."""
        if bpy.app.timers.is_registered(self._timer):
            bpy.app.timers.unregister(self._timer)
        for thread in self._threads if not self._detached else ():
            thread.join()
        self._threads.clear()

    def tick(self) -> float | None:
        """A look whether threads have ended. Returns the seconds until the next one; None: none is left."""
        running = [thread for thread in self._threads if thread.is_alive()]
        if len(running) < len(self._threads):
            self._threads = running
            self._done()
        if self._looked is not None:
            self._looked()
        return self._interval if running else None


def redraw_panels():
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()

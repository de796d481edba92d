"""Short work of a child process that a thread waits for, so that Blender stays usable. A timer then goes on
in the main thread."""

from __future__ import annotations

import threading
from collections.abc import Callable

import bpy

INTERVAL = 0.1  # seconds between two looks whether it is done


class ChildWork:
    """The threads of one kind of work. They must not use bpy. done: called in the main thread after one or
    several of them have ended."""

    def __init__(self, done: Callable[[], None]):
        self._done, self._threads = done, list[threading.Thread]()
        # Blender knows a timer by its object, and self._tick is another one each time
        self._timer = self._tick

    def start(self, work: Callable, *words):
        """Calls work(*words) in a thread. In background mode, it returns after done()."""
        thread = threading.Thread(target=work, args=words)
        self._threads.append(thread)
        thread.start()
        if bpy.app.background:
            thread.join()
            self._tick()
        elif not bpy.app.timers.is_registered(self._timer):
            # another file may be opened meanwhile
            bpy.app.timers.register(self._timer, first_interval=INTERVAL, persistent=True)

    def close(self):
        """Waits for all threads, without calling done()."""
        if bpy.app.timers.is_registered(self._timer):
            bpy.app.timers.unregister(self._timer)
        for thread in self._threads:
            thread.join()
        self._threads.clear()

    def _tick(self) -> float | None:
        running = [thread for thread in self._threads if thread.is_alive()]
        if len(running) < len(self._threads):
            self._threads = running
            self._done()
        return INTERVAL if running else None


def redraw_panels():
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()

"""Work outside Blender's main thread, and what waits for it.

bpy is touched in the main thread alone. There, one timer calls whatever watches work until that has ended.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import bpy

from ...svrgs_addon.system.errors import NativeError, SplatError

INTERVAL = 0.2  # seconds between two calls of the timer

waits = bpy.app.background  # without a window there are no timers, so run() waits
_watching: list[Callable[[], bool]] = []
_threads: list[threading.Thread] = []  # for which the end of the extension waits
_stale = threading.Event()


def run(
    work: Callable[[], Any], done: Callable[[Any, str], object] | None = None, detached: bool = False
) -> Future:
    """Calls work() in a thread, where it must not use bpy. Then calls done() in the main thread with its
    outcome(). Without a window, both are done before this returns.

    detached: the thread ends with Blender, which does not wait for it. Returns a Future, whose result() is
    what work() returned, or raises what it raised.
    """
    answer: Future = Future()

    def call():
        try:
            answer.set_result(work())
        except BaseException as error:  # whoever asks for the result gets it
            answer.set_exception(error)

    def poll() -> bool:
        if not answer.done():
            return True
        if done is not None:
            done(*outcome(answer))
        redraw_panels()
        return False

    thread = threading.Thread(target=call, daemon=detached)
    thread.start()
    _threads[:] = [one for one in (*_threads, thread) if one.is_alive() and not one.daemon]
    if waits:
        thread.join()
        poll()
    else:
        watch(poll)
    return answer


def outcome(answer: Future) -> tuple[Any, str]:
    """What the work returned, and ''; or None, and why it failed, in a sentence."""
    error = answer.exception()
    if error is None:
        return answer.result(), ""
    if not isinstance(error, (SplatError, NativeError, OSError)):
        traceback.print_exception(error)
    return None, str(error) or type(error).__name__


def watch(poll: Callable[[], bool]):
    """Calls poll() again and again in the main thread, until it returns False. Without a window: never."""
    if waits:
        return
    if poll not in _watching:
        _watching.append(poll)
    if not bpy.app.timers.is_registered(tick):
        # persistent: another file may be opened meanwhile
        bpy.app.timers.register(tick, first_interval=INTERVAL, persistent=True)


def tick() -> float | None:
    """The timer. Returns the seconds until the next call; None: there is nothing left to watch."""
    if _stale.is_set():
        _stale.clear()
        redraw_panels()
    for poll in list(_watching):
        try:
            goes_on = poll()
        except Exception:  # Blender removes a timer that raises; others still wait for it
            traceback.print_exc()
            goes_on = False
        if not goes_on:
            _watching.remove(poll)
    return INTERVAL if _watching else None


def redraw_soon():
    """Panels are redrawn at the next call of the timer. A thread may call this."""
    _stale.set()


def redraw_panels():
    for area in areas():
        if area.type in ("VIEW_3D", "IMAGE_EDITOR"):
            area.tag_redraw()


def areas() -> list[bpy.types.Area]:
    """The areas of all windows."""
    return [area for window in bpy.context.window_manager.windows for area in window.screen.areas]


TIMERS = (tick,)


def unregister():
    _watching.clear()
    for thread in _threads:
        thread.join()
    _threads.clear()

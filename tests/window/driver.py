"""Runs inside Blender's window: a script as a generator of pauses, with the mouse, the keyboard and
screenshots.

Blender is started with --enable-event-simulate, so that events come from here alone. Coordinates: pixels from
the top left of a window of SIZE. Whatever goes wrong ends Blender with status 1, and a last picture.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy

SIZE = (1280, 1120)
first_is_open = True  # of the panels of the tab
# the first header of the sidebar's tab; from one header to the next where all panels are closed
HEADER, HEADER_HEIGHT = (825, 97), 28
# the steps below the header of their panel, while the ones before are closed
STEPS, FIRST_STEP, STEP_HEIGHT = ("Train", "Prune", "Compare", "Export"), 31, 21
DATA, OUT = (Path(word) for word in sys.argv[sys.argv.index("--") + 1 :])


def window() -> bpy.types.Window:
    return bpy.context.window_manager.windows[0]


def area(kind: str) -> bpy.types.Area:
    return next(area for area in window().screen.areas if area.type == kind)


def click(x: int, y: int, **modifiers: bool) -> Iterator[float]:
    """Left click."""
    for dx in (-9, -3, 0):
        window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x + dx, y=SIZE[1] - y)
        yield 0.1
    for value in ("PRESS", "RELEASE"):
        window().event_simulate(type="LEFTMOUSE", value=value, x=x, y=SIZE[1] - y, **modifiers)
        yield 0.1
    yield 0.2


def drag(x: int, y: int, to_x: int, to_y: int) -> Iterator[float]:
    """Left drag in ten moves."""
    window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x - 5, y=SIZE[1] - y)
    yield 0.2
    window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=SIZE[1] - y)
    yield 0.2
    window().event_simulate(type="LEFTMOUSE", value="PRESS", x=x, y=SIZE[1] - y)
    for step in range(1, 11):
        yield 0.1
        window().event_simulate(
            type="MOUSEMOVE",
            value="NOTHING",
            x=x + (to_x - x) * step // 10,
            y=SIZE[1] - (y + (to_y - y) * step // 10),
        )
    yield 0.2
    window().event_simulate(type="LEFTMOUSE", value="RELEASE", x=to_x, y=SIZE[1] - to_y)
    yield 0.3


def key(letter: str, x: int, y: int, **modifiers: bool) -> Iterator[float]:
    """A key, with the pointer over (x, y)."""
    window().event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=SIZE[1] - y)
    yield 0.1
    for value in ("PRESS", "RELEASE"):
        window().event_simulate(type=letter, value=value, x=x, y=SIZE[1] - y, **modifiers)
        yield 0.1
    yield 0.3


def until(condition: Callable[[], object], what: str, seconds: float = 30) -> Iterator[float]:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"not within {seconds:.0f} s: {what}")
        yield 0.05


def sidebar(tab: str) -> Iterator[float]:
    """Opens the 3D view's sidebar at a tab."""
    area("VIEW_3D").spaces.active.show_region_ui = True
    region = next(region for region in area("VIEW_3D").regions if region.type == "UI")

    def there() -> bool:  # tabs exist once the sidebar has been drawn
        region.tag_redraw()
        try:
            region.active_panel_category = tab
        except (AttributeError, TypeError):
            return False
        return region.active_panel_category == tab

    yield from until(there, f"the tab {tab}")
    yield 0.5


def open_panel(title: str) -> Iterator[float]:
    """Opens one panel or step of the sidebar's tab SVR-GS and closes all others."""
    global first_is_open
    if title in STEPS:
        yield from open_panel("Steps")
        if not getattr(bpy.context.window_manager.svrgs_steps, title.lower()):
            yield from close_step()
            yield from click(HEADER[0] + 15, header_height(title))
        yield 0.7
        return
    if not first_is_open:
        yield from click(*HEADER)
    yield from close_all()
    yield from click(HEADER[0], header_height(title))
    first_is_open = title == titles()[0]
    yield 0.7


def close_all() -> Iterator[float]:
    """Draws a line down from the first header, whose panel is open: it closes, and so do all that the line
    then meets."""
    x, y = HEADER
    send = lambda kind, value, below: window().event_simulate(
        type=kind, value=value, x=x, y=SIZE[1] - y - below
    )
    send("MOUSEMOVE", "NOTHING", -2)
    yield 0.2
    send("LEFTMOUSE", "PRESS", 0)
    for step in range(1, 2 * len(titles()) + 1):
        yield 0.15
        send("MOUSEMOVE", "NOTHING", step * HEADER_HEIGHT // 2)
    yield 0.2
    send("LEFTMOUSE", "RELEASE", len(titles()) * HEADER_HEIGHT)
    yield 0.5


def close_step() -> Iterator[float]:
    """Closes the step that is open, with a click on its header."""
    steps = bpy.context.window_manager.svrgs_steps
    for title in STEPS:
        if getattr(steps, title.lower()):
            yield from click(HEADER[0] + 15, header_height(title))
            yield 0.3


def titles() -> list[str]:
    """Of the panels of the tab, from top to bottom."""
    panels = [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if getattr(panel, "bl_category", "") == "SVR-GS" and not hasattr(panel, "bl_parent_id")
    ]
    shown = [
        panel
        for panel in panels
        if panel.bl_space_type == "VIEW_3D" and (not hasattr(panel, "poll") or panel.poll(bpy.context))
    ]
    return [
        panel.bl_label.lstrip("0123456789 ")
        for panel in sorted(shown, key=lambda panel: getattr(panel, "bl_order", 0))
    ]


def header_height(title: str) -> int:
    """Height of the header of a panel where all panels are closed, or of a step where those before are."""
    if title in STEPS:
        return header_height("Steps") + FIRST_STEP + STEP_HEIGHT * STEPS.index(title)
    return HEADER[1] + HEADER_HEIGHT * titles().index(title)


def shot(name: str):
    """A picture of the screen, where ImageMagick can take one: Blender's own screenshots are black without a
    real screen."""
    if shutil.which("import"):
        subprocess.run(["import", "-silent", "-window", "root", str(OUT / f"{name}.png")], check=True)


def run(steps: Iterator[float]):
    """Lets Blender draw for as long as the script yields; then quits."""
    bpy.context.preferences.view.show_splash = False

    def tick() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            sys.stdout.flush()
            os._exit(0)  # not through a question about unsaved changes
        except BaseException:
            traceback.print_exc()
            shot("failed")
            sys.stderr.flush()
            os._exit(1)

    bpy.app.timers.register(tick, first_interval=1.5, persistent=True)

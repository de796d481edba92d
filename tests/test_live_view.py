"""Pictures of views that move on: which are drawn, which are given up, and that nothing is lost."""

from __future__ import annotations

import threading
import time

import pytest

from svrgs_addon.render.live_view import COARSE, LiveView
from svrgs_addon.system.errors import Cancelled


class Painter:
    """Draws when it is allowed to, and notes what it was asked."""

    def __init__(self):
        self.asked, self.allowed = [], threading.Semaphore(0)

    def __call__(self, rasterizer, job, reduction):
        self.asked.append((job, reduction))
        while not self.allowed.acquire(timeout=0.005):
            if rasterizer.cancel[0]:
                raise Cancelled
        return f"{job} / {reduction}"


@pytest.fixture
def painter():
    return Painter()


@pytest.fixture
def live(painter):
    view = LiveView(painter)
    yield view
    view.close()


def until(condition):
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline, "it did not come to pass"
        time.sleep(0.002)


def test_a_coarse_picture_then_the_exact_one(live, painter):
    assert live.picture() is None and not live.busy
    live.request("a", "job")
    assert live.busy
    painter.allowed.release()
    until(lambda: live.picture())
    assert (live.picture().result, live.picture().reduction) == (f"job / {COARSE}", COARSE) and live.busy
    painter.allowed.release()
    until(lambda: not live.busy)
    assert (live.picture().result, live.picture().reduction) == ("job / 1", 1)


def test_a_view_that_is_wanted_again_before_it_was_given_up_is_drawn(live, painter):
    """Else it would stay coarse."""
    live.request("a", "a")
    painter.allowed.release()
    until(lambda: ("a", 1) in painter.asked)
    with live._changed:  # the thread has not noticed yet
        live._wanted, live._rasterizer.cancel[0] = ("b", "b"), 1
        live._wanted = ("a", "a")
    until(lambda: len(painter.asked) > 2)
    for _ in range(2):
        painter.allowed.release()
    until(lambda: not live.busy)
    assert live.picture().reduction == 1


def test_the_same_view_is_drawn_once(live, painter):
    for _ in range(2):
        live.request("a", "job")
        painter.allowed.release(2)
        until(lambda: not live.busy)
    assert painter.asked == [("job", COARSE), ("job", 1)]


def test_an_exact_picture_of_a_view_that_moved_on_is_given_up(live, painter):
    live.request("a", "a")
    painter.allowed.release()
    until(lambda: ("a", 1) in painter.asked)
    live.request("b", "b")
    until(lambda: ("b", COARSE) in painter.asked)
    assert live.picture().key == "a", "the last picture is shown until there is a newer one"
    painter.allowed.release(2)
    until(lambda: not live.busy)
    assert live.picture().result == "b / 1"


def test_coarse_pictures_are_finished_so_that_a_moving_view_shows_something(live, painter):
    live.request("a", "a")
    until(lambda: painter.asked)
    for key in "bcd":
        live.request(key, key)
    painter.allowed.release()
    until(lambda: live.picture())
    assert live.picture().key == "a"
    painter.allowed.release(2)
    until(lambda: not live.busy)
    assert painter.asked == [("a", COARSE), ("d", COARSE), ("d", 1)], "views passed by are skipped"


def test_an_error_is_a_picture_of_its_own_and_ends_nothing():
    def draw(rasterizer, job, reduction):
        if job == "bad":
            raise ValueError("no such job")
        return job

    live = LiveView(draw)
    live.request("a", "bad")
    until(lambda: not live.busy)
    assert str(live.picture().error) == "no such job"
    live.request("b", "good")
    until(lambda: not live.busy)
    assert live.picture().result == "good" and live.picture().error is None
    live.close()


def test_closing_stops_a_drawing(painter):
    live = LiveView(painter)
    live.request("a", "job")
    until(lambda: painter.asked)
    live.close()
    assert not live._thread.is_alive()

"""The slow part of an export is done in a thread when it was called from the window."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import bpy
import pytest
from extension import part


class Calls(list):
    """A window manager that records its calls."""

    def event_timer_add(self, interval, window):
        self.append("timer")
        return "timer"

    def event_timer_remove(self, timer):
        self.remove(timer)

    def modal_handler_add(self, operator):
        self.append("handler")


@pytest.fixture
def called(monkeypatch):
    """called(slow): an operator with this slow part, as the window calls it, and its context. Its reports are
    listed."""
    monkeypatch.setattr(part("operators.data.background_work"), "waits", False)
    reporting = part("operators.data.reporting")

    def steps(self, context):
        answer = yield self.slow
        return f"the answer is {answer}"

    own = {
        name: vars(reporting.BackgroundOperator)[name]
        for name in ("execute", "begin", "modal", "cancel", "_wait_no_more", "_timer")
    }
    own |= {"ended": reporting.ReportingOperator.ended, "steps": steps, "bl_label": "Export Web Page"}
    own["report"] = lambda self, kind, text: self.said.append((*kind, text))

    def made(slow):
        context = SimpleNamespace(window_manager=Calls(), window=None, workspace=bpy.data.workspaces[0])
        operator = type("Operator", (), own)()
        operator.slow, operator.said, operator.in_window = slow, [], True
        return operator, context

    return made


def after(operator, context) -> set:
    """What modal() says in the end."""
    operator._answer.exception(timeout=10)
    return operator.modal(context, SimpleNamespace(type="TIMER"))


def test_the_window_goes_on_until_the_slow_part_has_ended(called):
    held = threading.Event()
    operator, context = called(lambda: held.wait(10) and 42)
    assert operator.execute(context) == {"RUNNING_MODAL"}
    assert sorted(context.window_manager) == ["handler", "timer"]
    for kind in ("TIMER", "MOUSEMOVE"):
        assert operator.modal(context, SimpleNamespace(type=kind)) == {"PASS_THROUGH"}
    held.set()
    assert after(operator, context) == {"FINISHED"}
    assert operator.said == [("INFO", "the answer is 42")] and context.window_manager == ["handler"]


def test_an_error_of_the_slow_part_is_a_sentence(called):
    def slow():
        raise OSError("the disk is full")

    operator, context = called(slow)
    operator.execute(context)
    assert after(operator, context) == {"CANCELLED"}
    assert operator.said == [("ERROR", "the disk is full")] and "timer" not in context.window_manager


@pytest.mark.parametrize("error", ["", "the disk is full"])
def test_when_another_file_is_opened_the_slow_part_goes_on_and_its_error_is_shown(called, monkeypatch, error):
    held, shown, work = threading.Event(), [], part("operators.data.background_work")
    monkeypatch.setattr(part("operators.data.reporting"), "popup", lambda *texts: shown.append(texts))

    def slow():
        held.wait(10)
        if error:
            raise OSError(error)

    operator, context = called(slow)
    operator.execute(context)
    operator.cancel(context)
    assert "timer" not in context.window_manager and work.tick() and not shown
    held.set()
    operator._answer.exception(timeout=10)
    assert work.tick() is None and shown == ([("Export Web Page", error)] if error else [])


def test_a_file_browser_that_is_closed_leaves_nothing_to_end(called):
    operator, context = called(lambda: 42)
    operator.cancel(context)
    assert context.window_manager == [] and operator.said == []

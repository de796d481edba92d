"""Operators that say what they did, or in a sentence why not."""

from __future__ import annotations

from collections.abc import Callable, Generator
from concurrent.futures import Future
from functools import partial
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, StringProperty

from ...svrgs_addon.system.errors import NativeError, SplatError
from . import background_work

Steps = Generator[Callable[[], Any], Any, str]


class ReportingOperator(bpy.types.Operator):
    """An operator whose work() returns what it did, in a sentence, or '' if it has reported that itself. An
    error is reported as a sentence. It is a step of undo, unless it says otherwise."""

    bl_options = {"REGISTER", "UNDO"}

    def __init_subclass__(cls):
        """Its name for Blender: SVRGS_OT_my_verb is svrgs.my_verb."""
        cls.bl_idname = cls.__name__.replace("SVRGS_OT_", "svrgs.")

    @classmethod
    def problem(cls, context) -> str:
        """Why it cannot be done now, in a sentence; '' if it can."""
        return ""

    @classmethod
    def poll(cls, context):
        problem = cls.problem(context)
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def execute(self, context):
        return self.ended(lambda: self.work(context))

    def ended(self, work: Callable[[], str]) -> set:
        """What Blender is told after work(), whose sentence or error is reported."""
        try:
            message = work()
        except (SplatError, NativeError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if message:
            self.report({"INFO"}, message)
        return {"FINISHED"}


def menu(operator: type[ReportingOperator], **shown) -> Callable:
    """A function that draws the operator in one of Blender's menus."""
    return lambda self, _: self.layout.operator(operator.bl_idname, **shown)


class FolderOperator(ReportingOperator):
    """An operator that asks for a folder, unless a script gives its `directory`."""

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context, event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


class BackgroundOperator(ReportingOperator):
    """An operator with a slow part. The window goes on meanwhile, if the operator was called from there.

    steps(context) is a generator. It yields the slow part, a function that must not use bpy. It is sent the
    result of this function, and returns the message, as work() does.
    """

    in_window = False  # set by invoke()
    _timer = None  # while the slow part is waited for

    def work(self, context) -> str:
        steps = self.steps(context)
        return _last(steps, next(steps)())

    def execute(self, context):
        if not self.in_window:
            return super().execute(context)
        outcome = self.ended(lambda: self.begin(context))
        return {"RUNNING_MODAL"} if outcome == {"FINISHED"} else outcome

    def begin(self, context) -> str:
        self._steps = self.steps(context)
        self._answer = background_work.run(next(self._steps))
        manager, self._workspace = context.window_manager, context.workspace.name
        self._timer = manager.event_timer_add(background_work.INTERVAL, window=context.window)
        manager.modal_handler_add(self)
        context.workspace.status_text_set(f"{tr(self.bl_label)} …")
        return ""

    def modal(self, context, event):
        if event.type != "TIMER" or not self._answer.done():
            return {"PASS_THROUGH"}
        self._wait_no_more(context)
        return self.ended(lambda: _last(self._steps, self._answer.result()))

    def cancel(self, context):
        """Blender calls it when its file browser is closed, and when another file is opened, where the slow
        part goes on: its error is shown later."""
        if self._timer is not None:
            self._wait_no_more(context)
            background_work.watch(partial(_show_error, self._answer, self.bl_label))

    def _wait_no_more(self, context):
        context.window_manager.event_timer_remove(self._timer)
        if workspace := bpy.data.workspaces.get(self._workspace):
            workspace.status_text_set(None)


def _show_error(answer: Future, label: str) -> bool:
    """Shows the error of an operator that is gone, once it has ended. Returns whether it goes on."""
    if not answer.done():
        return True
    if error := background_work.outcome(answer)[1]:
        popup(tr(label), error)
    return False


def popup(title: str, text: str):
    """Shows a sentence at the mouse, in the first window."""
    manager = bpy.context.window_manager
    with bpy.context.temp_override(window=manager.windows[0]):
        manager.popup_menu(lambda menu, _: menu.layout.label(text=text), title=title, icon="ERROR")


def _last(steps: Steps, result: Any) -> str:
    """What the generator returns that is sent the result of its slow part."""
    try:
        steps.send(result)
    except StopIteration as stop:
        return stop.value
    raise AssertionError(steps)  # it yields once

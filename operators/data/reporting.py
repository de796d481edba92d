"""Operators that say what they did, or in a sentence why not."""

from __future__ import annotations

import bpy

from ...svrgs_addon.system.errors import NativeError, SplatError


class ReportingOperator(bpy.types.Operator):
    """An operator whose work() returns what it did, in a sentence, or '' if it has reported that itself. An
    error is reported as a sentence."""

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
        try:
            message = self.work(context)
        except (SplatError, NativeError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if message:
            self.report({"INFO"}, message)
        return {"FINISHED"}

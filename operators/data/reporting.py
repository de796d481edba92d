"""Operators that say what they did, or in a sentence why not."""

from __future__ import annotations

import bpy

from ...svrgs_addon.system.errors import NativeError, SplatError


class ReportingOperator(bpy.types.Operator):
    """An operator whose work() returns what it did. An error is reported as a sentence."""

    def execute(self, context):
        try:
            message = self.work(context)
        except (SplatError, NativeError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, message)
        return {"FINISHED"}

"""For the tests of jobs: settings, the timer, what is marked as removed, and what a panel says."""

from __future__ import annotations

import operator
import time
from types import SimpleNamespace

import bpy
import numpy as np
from extension import part

SHORT = {"method": "svr", "iterations": 40, "recovery": 20, "goal": "SHARE", "share": 50}
LONG = {"iterations": 20_000, "recovery": 0, "goal": "LAMBDA", "lambda_f": 1e-5, "min_contribution": 0.0}
COUNT = 250  # Gaussians of the tiny splat


def set_up(options: dict):
    """Settings of the prune panel."""
    for name, value in options.items():
        setattr(bpy.context.scene.svrgs_prune, name, value)


def follow(watch, until, seconds: float = 60):
    """Calls the timer's function, as Blender would, until the condition holds."""
    end = time.monotonic() + seconds
    while not until():
        watch.tick()
        assert time.monotonic() < end, [(job.facts, job.folder.log_tail()) for job in watch.jobs.values()]
        time.sleep(0.02)


def end_all(watch):
    """Kills the jobs that run."""
    part("operators.jobs.job_queue")._queue.clear()
    for job in watch.jobs.values():
        if job.running:
            job.kill()
            follow(watch, lambda job=job: not job.running)


def ended(job) -> bool:
    """Whether its process ended well, and its result was loaded where that is possible."""
    return job.state == "done" and not job.running


def marked(bridge, obj) -> np.ndarray:
    return bridge.values(obj, "removed")


def evaluated_count(obj) -> int:
    """Number of points of the object with its modifiers."""
    data = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    return len(data.vertices if obj.type == "MESH" else data.points)


def delete(obj):
    """As with the key X."""
    bpy.ops.object.select_all(action="DESELECT")
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.delete()
    bpy.context.view_layer.update()


class Layout:
    """Notes what a panel draws. Operators and properties that a panel names must exist."""

    def __init__(self, notes=None):
        self.__dict__["notes"] = [] if notes is None else notes

    def __getattr__(self, name):
        def draw(*words, **options):
            if name == "operator":
                # raises KeyError where there is no such operator
                operator.attrgetter(words[0])(bpy.ops).get_rna_type()
            if name == "prop":
                assert words[1] in words[0].bl_rna.properties, words[1]
            self.notes.append((name, *words, *options.values()))
            if name in ("panel", "panel_prop"):
                return Layout(self.notes), Layout(self.notes)
            return Layout(self.notes) if name in ("row", "column", "box", "grid_flow") else SimpleNamespace()

        return draw

    def __setattr__(self, name, value):
        pass

    @property
    def text(self) -> str:
        """The labels, one after the other; then all else."""
        labels = [note[1] for note in self.notes if note[0] == "label"]
        return " ".join([*labels, *(str(word) for note in self.notes if note[0] != "label" for word in note)])


def drawn(panel: str) -> str:
    layout = Layout()
    draw_panel(part(f"panels.{panel}"), layout)
    return layout.text


def draw_panel(module, layout):
    """Draws a step, or the panel that has the name of its module."""
    if hasattr(module, "has_something"):
        module.draw(layout, bpy.context)
    else:
        panel = getattr(module, f"SVRGS_PT_{module.__name__.rpartition('.')[2]}")
        panel.draw(SimpleNamespace(layout=layout), bpy.context)


def said() -> str:
    """What the prune panel says, one sentence a line."""
    own, estimate = part("operators.jobs.prune_state"), part("operators.jobs.estimate")
    return "\n".join([*own.sentences(bpy.context), *estimate.sentences(bpy.context.object)])

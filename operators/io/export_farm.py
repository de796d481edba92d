"""Export Farm Job: the selected splats and the settings of step 2 as a folder, whose tasks the machines of a
farm do (`svrgs farm`)."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files.registry import FORMATS, write_scene
from ...svrgs_addon.jobs.farm.farm_job import (
    CAPTURES,
    INSIDE,
    OWN,
    FarmJob,
    Task,
    common_folder,
    refuse_folder,
    refuse_same_names,
    relative,
)
from ...svrgs_addon.jobs.job_folder import CAMERAS
from ...svrgs_addon.system import subprocess_python
from ...svrgs_addon.system.errors import SceneError
from ...svrgs_addon.system.memory import size_text
from ...svrgs_addon.views.cameras_json import write_cameras_json
from ..data import background_work, splat_object
from ..data.native_check import native_problem
from ..data.reporting import FolderOperator
from ..jobs import efforts, goals
from ..jobs.job import given_views, options_of
from ..scene.splat_transforms import selected_splats

_lines: list[str] = []  # what the panel says on the last export


def lines() -> list[str]:
    """The lines of the panel on the last export."""
    return list(_lines)


class SVRGS_OT_export_farm_job(FolderOperator):
    bl_idname = "svrgs.export_farm_job"
    bl_label = "Export Farm Job"
    bl_description = (
        "Write the selected splats and the settings of step 2 into a folder, as a job for a farm: for Open"
        " Job Description, Deadline Cloud and Flamenco. Photographs stay where they are"
    )
    bl_options = {"REGISTER"}

    @classmethod
    def problem(cls, context) -> str:
        problem = native_problem() or efforts.problem(context) or goals.problem(context.scene.svrgs_prune)
        return problem or ("" if selected_splats(context) else tr("Select a Gaussian splat first"))

    def work(self, context) -> str:
        folder = Path(bpy.path.abspath(self.directory))
        refuse_folder(folder)
        if context.scene.svrgs_prune.use_time:
            raise SceneError(
                tr("A time limit is for one machine: switch it off under Advanced, and set the steps")
            )
        # before one is written over another
        refuse_same_names([bpy.path.clean_name(obj.name) for obj in selected_splats(context)])
        tasks = [_task(context, obj, folder / CAPTURES) for obj in selected_splats(context)]
        _job(folder, tasks).write()
        _lines[:] = [tr("Exporting a farm job to {folder} …").format(folder=folder)]
        # a child process reads the datasets, to know what a task needs
        words = ["farm", "files", str(folder), "--json"]
        background_work.run(partial(subprocess_python.ask, words), partial(_finished, folder))
        background_work.redraw_panels()
        return "; ".join(_lines)


def _task(context, obj: bpy.types.Object, captures: Path) -> Task:
    """Writes the splat, and the cameras of the file that count, into the folder. Returns the task that prunes
    it."""
    name = bpy.path.clean_name(obj.name)
    with context.temp_override(object=obj, active_object=obj):  # its own dataset and effort
        options, cameras = options_of(bpy.context, obj), given_views(bpy.context, obj)
    options.pop("threads")
    splat, beside = (f"{name}{end}" for end in (FORMATS[0].suffixes[0], f"_{CAMERAS}"))
    write_scene(captures / splat, splat_object.scene_from_object(obj))
    if cameras:
        write_cameras_json(captures / beside, cameras)
        options["cameras"] = f"{OWN}{CAPTURES}/{beside}"
    return Task(name, f"{OWN}{CAPTURES}/{splat}", options)


def _job(folder: Path, tasks: list[Task]) -> FarmJob:
    """The job, with datasets relative to the folder that holds all of them: that of a worker may have another
    name."""
    root = (
        common_folder([Path(task.options["data"]) for task in tasks if task.options.get("data")])
        or folder / CAPTURES
    )
    return FarmJob(folder, root, tuple(replace(task, options=_within(root, task.options)) for task in tasks))


def _within(root: Path, options: dict[str, Any]) -> dict[str, Any]:
    return options | {name: relative(root, Path(options[name])) for name in INSIDE if options.get(name)}


def _finished(folder: Path, answer: Future):
    result, error = background_work.outcome(answer)
    if error:
        _lines[:] = [error]
        return
    text = tr("Tasks: {count:,}. Memory of each: up to {memory}. Folder: {folder}")
    _lines[:] = [text.format(count=result["tasks"], memory=size_text(result["memory"]), folder=folder)]


def forget(*_):
    """What was said belongs to the file before."""
    _lines.clear()


def menu(self, context):
    self.layout.operator(SVRGS_OT_export_farm_job.bl_idname, text="Splat Farm Job (folder)")


CLASSES = (SVRGS_OT_export_farm_job,)
MENUS = {"TOPBAR_MT_file_export": menu}

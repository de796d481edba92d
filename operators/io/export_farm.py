"""Export Farm Job: the selected splats and the settings of step 2 as a folder, whose tasks the machines of a
farm do (`svrgs farm`)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files.registry import FORMATS, write_scene
from ...svrgs_addon.jobs.farm import farm_job
from ...svrgs_addon.jobs.job_folder import CAMERAS
from ...svrgs_addon.system import subprocess_python
from ...svrgs_addon.system.errors import SceneError
from ...svrgs_addon.system.memory import size_text
from ...svrgs_addon.views.cameras_json import write_cameras_json
from ..data import background_work, splat_object
from ..data.extension import native_problem
from ..data.reporting import FolderOperator, menu, popup
from ..jobs import efforts, goals
from ..jobs.job import given_views, options_of
from ..scene.splat_transforms import selected_splats

_lines: list[str] = []  # what the panel says on the last export


def lines() -> list[str]:
    """The lines of the panel on the last export."""
    return list(_lines)


class SVRGS_OT_export_farm_job(FolderOperator):
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
        farm_job.refuse_folder(folder)
        if context.scene.svrgs_prune.use_time:
            raise SceneError(
                tr("A time limit is for one machine: switch it off under Advanced, and set the steps")
            )
        splats = selected_splats(context)
        # before one is written over another
        farm_job.refuse_same_names([bpy.path.clean_name(obj.name) for obj in splats])
        tasks = [_task(context, obj, folder / farm_job.CAPTURES) for obj in splats]
        _job(folder, tasks).write()
        _lines[:] = [tr("Exporting a farm job to {folder} …").format(folder=folder)]
        # a child process reads the datasets, to know what a task needs
        words = ["farm", "files", str(folder), "--json"]
        problems: list[str] = []  # at once in background mode
        background_work.run(partial(subprocess_python.ask, words), partial(_finished, folder, problems))
        background_work.redraw_panels()
        if problems:
            raise SceneError("; ".join(_lines))
        return "; ".join(_lines)


def _task(context, obj: bpy.types.Object, captures: Path) -> farm_job.Task:
    """Writes the splat, and the cameras of the file that count, into the folder. Returns the task that prunes
    it."""
    name = bpy.path.clean_name(obj.name)
    with context.temp_override(object=obj, active_object=obj):  # its own dataset and effort
        if problem := efforts.problem(bpy.context):
            raise SceneError(f"{obj.name}: {problem}")
        options, cameras = options_of(bpy.context, obj), given_views(bpy.context, obj)
    options.pop("threads")
    splat, beside = (f"{name}{end}" for end in (FORMATS[0].suffixes[0], f"_{CAMERAS}"))
    write_scene(captures / splat, splat_object.scene_from_object(obj))
    if cameras:
        write_cameras_json(captures / beside, cameras)
        options["cameras"] = f"{farm_job.OWN}{farm_job.CAPTURES}/{beside}"
    return farm_job.Task(name, f"{farm_job.OWN}{farm_job.CAPTURES}/{splat}", options)


def _job(folder: Path, tasks: list[farm_job.Task]) -> farm_job.FarmJob:
    """The job, with datasets relative to the folder that holds all of them: that of a worker may have another
    name."""
    datasets = [Path(task.options["data"]) for task in tasks if task.options.get("data")]
    root = farm_job.common_folder(datasets) or folder / farm_job.CAPTURES

    def within(options: dict[str, Any]) -> dict[str, Any]:
        paths = [name for name in farm_job.INSIDE if options.get(name)]
        return options | {name: farm_job.relative(root, Path(options[name])) for name in paths}

    placed = tuple(replace(task, options=within(task.options)) for task in tasks)
    return farm_job.FarmJob(folder, root, placed)


def _finished(folder: Path, problems: list[str], result: dict, error: str):
    if error:
        _lines[:] = problems[:] = [error]
        if not background_work.waits:  # the panel may be closed, or another file be open
            popup(tr(SVRGS_OT_export_farm_job.bl_label), error)
        return
    text = tr("Tasks: {count:,}. Memory of each: up to {memory}. Folder: {folder}")
    _lines[:] = [text.format(count=result["tasks"], memory=size_text(result["memory"]), folder=folder)]


def forget(*_):
    """What was said belongs to the file before."""
    _lines.clear()


MENUS = {"TOPBAR_MT_file_export": menu(SVRGS_OT_export_farm_job, text="Splat Farm Job (folder)")}

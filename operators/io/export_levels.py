"""Export Levels of Detail: writes every selected splat, and smaller ones of each, into a folder. A child
process prunes them (`svrgs prune --quick`)."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ...svrgs_addon.files.level_files import level_files
from ...svrgs_addon.files.registry import FORMATS, size_on_disk, write_scene
from ...svrgs_addon.system import subprocess_python
from ...svrgs_addon.system.errors import SceneError
from ...svrgs_addon.system.memory import size_text
from ..data.child_work import ChildWork, redraw_panels
from ..data.native_check import native_problem
from ..data.preferences import threads
from ..data.reporting import ReportingOperator
from .export_space import KINDS, WHAT_FOR, ExportSpace, selected_splats

STREAMED = next(one for one in FORMATS if one.index == "lod-meta.json")
_running: list[str] = []  # names of the splats whose levels are being made
_lines: list[str] = []  # what the panel says on the last export
# name of a splat, exit status and result of `svrgs prune`, which have come since
_answers: list[tuple[str, int, dict]] = []


def lines() -> list[str]:
    """The lines of the panel: one for each splat that is being exported now, then one for each splat of the
    last export."""
    return [tr("Exporting levels of '{name}' …").format(name=name) for name in _running] + _lines


class SVRGS_OT_export_levels(ReportingOperator, ExportSpace):
    bl_idname = "svrgs.export_levels"
    bl_label = "Export Levels of Detail"
    bl_description = (
        "Write the selected splats into a folder, and smaller ones of each for the web, for headsets and for"
        " far away. Each is pruned without photographs, and its quality is measured"
    )
    bl_options = {"REGISTER", "PRESET"}

    directory: StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE"})
    filter_folder: BoolProperty(default=True, options={"HIDDEN"})
    kind: EnumProperty(
        name="Format",
        description="Format of the files",
        items=[*KINDS, (STREAMED.name, STREAMED.label, WHAT_FOR[STREAMED.name])],
    )
    shares: StringProperty(
        name="Levels, %",
        default="50, 25, 12",
        description="Shares of the Gaussians of the smaller splats. Empty: only the splats themselves",
    )
    overwrite: BoolProperty(name="Overwrite", description="Replace files that are there already")

    @classmethod
    def poll(cls, context):
        problem = native_problem() or (
            "" if selected_splats(context) else tr("Select a Gaussian splat first")
        )
        if problem or _running:
            cls.poll_message_set(problem or lines()[0])
        return not problem and not _running

    def invoke(self, context, event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def draw(self, context):
        self.layout.use_property_split = True
        for name in ("kind", "shares", "overwrite"):
            self.layout.prop(self, name)
        self.draw_space(self.layout)

    def work(self, context) -> str:
        shares, folder = self.parsed(), Path(bpy.path.abspath(self.directory))
        outs = {obj: self.path_of(folder, obj) for obj in selected_splats(context)}
        there = [
            path
            for out in outs.values()
            for path in (out, *level_files(out, shares).values())
            if path.exists()
        ]
        if there and not self.overwrite:
            raise SceneError(
                tr("{file} exists already: choose another folder, or Overwrite").format(file=there[0])
            )
        _lines.clear()
        for obj, out in outs.items():
            scene, _ = self.chosen(context, obj)
            if not shares:
                write_scene(out, scene)
                _lines.append(f"{obj.name}: {size_text(size_on_disk(out))}")
                continue
            temporary = tempfile.TemporaryDirectory(dir=bpy.app.tempdir)
            write_scene(Path(temporary.name) / "scene.ply", scene)
            levels = ",".join(f"{share:g}" for share in shares)
            _running.append(obj.name)
            _child_work.start(
                _export,
                obj.name,
                temporary,
                out,
                ["--levels", levels, "--threads", str(threads(context)), "--json", "--quiet"],
            )
        redraw_panels()
        return "; ".join(lines())

    def parsed(self) -> list[float]:
        """The shares, 0 to 1. Raises SceneError."""
        try:
            shares = [float(word) / 100 for word in self.shares.replace("%", " ").replace(",", " ").split()]
        except ValueError:
            shares = [0.0]
        if not all(0 < share < 1 for share in shares):
            raise SceneError(tr("Levels are numbers between 0 and 100, as in 50, 25, 12"))
        return sorted(set(shares), reverse=True)

    def path_of(self, folder: Path, obj: bpy.types.Object) -> Path:
        name = bpy.path.clean_name(obj.name)
        if self.kind == STREAMED.name:
            return folder / name / STREAMED.index
        (suffix,) = (one.suffixes[0] for one in FORMATS if one.name == self.kind)
        return folder / f"{name}{suffix}"


def _export(name: str, temporary: tempfile.TemporaryDirectory, out: Path, words: list[str]):
    """In a thread, which must not use bpy."""
    with temporary:
        status, result = subprocess_python.run(
            ["prune", str(Path(temporary.name) / "scene.ply"), "--quick", "--out", str(out), *words]
        )
    _answers.append((name, status, result))


def _finished():
    """Says what has been written since."""
    while _answers:
        name, status, result = _answers.pop()
        _running.remove(name)
        if status:
            _lines.append(
                f"{name}:"
                f" {result.get('error') or tr('the export ended with status {status}').format(status=status)}"
            )
            continue
        found = [{"share": 1, **result}, *result.get("levels", ())]
        texts = [
            tr("{share:g} %: {size}, {psnr:.1f} dB").format(
                share=100 * one["share"], size=size_text(one["bytes"]), psnr=one["psnr"]
            )
            for one in found
        ]
        _lines.append(f"{name}: {'; '.join(texts)}")
    redraw_panels()


_child_work = ChildWork(done=_finished)


@persistent
def _after_load(*_):
    """What was said belongs to the file before."""
    _lines.clear()


CLASSES = (SVRGS_OT_export_levels,)
HANDLERS = {"load_post": _after_load}


def unregister():
    _child_work.close()
    for found in (_running, _lines, _answers):
        found.clear()

"""Export Levels of Detail: writes every selected splat, and smaller ones of each, into a folder. A child
process prunes them (`svrgs prune --quick`)."""

from __future__ import annotations

import tempfile
import threading
from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, EnumProperty, StringProperty

from ...svrgs_addon.files.level_files import level_files
from ...svrgs_addon.files.registry import FORMATS, USUAL, size_on_disk, write_scene
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.system import subprocess_python
from ...svrgs_addon.system.errors import SceneError
from ...svrgs_addon.system.memory import size_text
from ..data import background_work
from ..data.extension import native_problem, threads
from ..data.file_kinds import KINDS, WHAT_FOR, format_of
from ..data.reporting import FolderOperator, menu, popup
from ..scene.splat_transforms import selected_splats
from .export_space import ExportSpace

STREAMED = next(one for one in FORMATS if one.index == "lod-meta.json")
_running: list[str] = []  # names of the splats whose levels are being made
_lines: list[str] = []  # what the panel says on the last export; its splats may be gone
_one_at_a_time = threading.Lock()  # several splats at once would take the memory of all


def lines() -> list[str]:
    """The lines of the panel: one for each splat that is being exported now, then one for each splat of the
    last export."""
    return [tr("Exporting levels of '{name}' …").format(name=name) for name in _running] + _lines


class SVRGS_OT_export_levels(FolderOperator, ExportSpace):
    bl_label = "Export Levels of Detail"
    bl_description = (
        "Write the selected splats into a folder, and smaller ones of each for the web, for headsets and for"
        " far away. Each is pruned without photographs, and its quality is measured"
    )
    bl_options = {"REGISTER", "PRESET"}

    kind: EnumProperty(
        name="Format",
        description="Format of the files",
        items=[*KINDS, (STREAMED.name, STREAMED.label, WHAT_FOR[STREAMED.name])],
        default=USUAL.name,
    )
    shares: StringProperty(
        name="Levels, %",
        default="50, 25, 12",
        description="Shares of the Gaussians of the smaller splats. Empty: only the splats themselves",
    )
    overwrite: BoolProperty(name="Overwrite", description="Replace files that are there already")

    @classmethod
    def problem(cls, context) -> str:
        if problem := native_problem():
            return problem
        if not selected_splats(context):
            return tr("Select a Gaussian splat first")
        return lines()[0] if _running else ""

    def draw(self, context):
        self.layout.use_property_split = True
        for name in ("kind", "shares", "overwrite"):
            self.layout.prop(self, name)
        self.draw_space(self.layout)

    def work(self, context) -> str:
        shares, folder = self.parsed(), Path(bpy.path.abspath(self.directory))
        outs = {obj: self.path_of(folder, obj) for obj in selected_splats(context)}
        files = [file for out in outs.values() for file in (out, *level_files(out, shares).values())]
        lower = [str(file).lower() for file in files]  # some systems do not tell upper and lower case apart
        if same := next((file for file in files if lower.count(str(file).lower()) > 1), None):
            raise SceneError(tr("{file}: two splats would be written into it: rename one").format(file=same))
        there = [file for file in files if file.exists()]
        if there and not self.overwrite:
            text = tr("{file} exists already: choose another folder, or Overwrite")
            raise SceneError(text.format(file=there[0]))
        _lines.clear()
        problems: list[str] = []  # at once in background mode
        for obj, out in outs.items():
            scene, _ = self.chosen(context, obj)
            work = partial(_export, scene, out, shares, threads(context), bpy.app.tempdir)
            _running.append(obj.name)
            background_work.run(work, partial(_finished, obj.name, problems))
        background_work.redraw_panels()
        if problems:
            raise SceneError("; ".join(lines()))
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
        suffix = format_of(self.kind).suffixes[0]
        return folder / f"{name}{suffix}"


def _export(scene: Scene, out: Path, shares: list[float], threads: int, folder: str) -> dict:
    """Writes a splat and its levels; what `svrgs prune --json` says of them. folder: for temporary files. In
    a thread, which must not use bpy."""
    Path(folder).mkdir(parents=True, exist_ok=True)  # systems may delete old temporary files
    with _one_at_a_time, tempfile.TemporaryDirectory(dir=folder) as temporary:
        if not shares:
            write_scene(out, scene)
            return {"bytes": size_on_disk(out)}
        source, levels = Path(temporary) / "scene.ply", ",".join(f"{share:g}" for share in shares)
        write_scene(source, scene)
        words = ["prune", str(source), "--quick", "--out", str(out), "--levels", levels]
        return subprocess_python.ask([*words, "--threads", str(threads), "--json", "--quiet"])


def _finished(name: str, problems: list[str], result: dict, error: str):
    _running.remove(name)
    if error:
        _lines.append(f"{name}: {error}")
        problems.append(error)
        if not background_work.waits:  # the panel may be closed, or another file be open
            popup(tr(SVRGS_OT_export_levels.bl_label), _lines[-1])
        return
    if "psnr" not in result:
        _lines.append(f"{name}: {size_text(result['bytes'])}")
        return
    text = tr("{share:g} %: {size}, {psnr:.1f} dB")
    texts = [
        text.format(share=100 * one["share"], size=size_text(one["bytes"]), psnr=one["psnr"])
        for one in ({"share": 1, **result}, *result.get("levels", ()))
    ]
    _lines.append(f"{name}: {'; '.join(texts)}")


def forget(*_):
    """What was said belongs to the file before."""
    _lines.clear()


MENUS = {"TOPBAR_MT_file_export": menu(SVRGS_OT_export_levels, text="Splat Levels of Detail (folder)")}


def unregister():
    _running.clear()

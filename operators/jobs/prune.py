"""The operator svrgs.prune, for scripts: runs `svrgs prune` in a child process and waits for it.

With a window the result appears in the scene. Without one (`blender -b`) it is also written into a file:
Blender does not save the scene. The button Prune of the panel is svrgs.job_start in job.py, which does not
wait.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, StringProperty

from ...svrgs_addon.cli.batch_list import default_output
from ...svrgs_addon.files.registry import format_to_write, read_scene, write_scene
from ...svrgs_addon.system import subprocess_python
from ...svrgs_addon.system.errors import SplatError
from ..data import edit_guard, pairs, selection, splat_object
from ..data.extension import threads
from ..data.job_paths import absolute
from ..data.option_properties import RELATIVE, option_property
from ..data.reporting import ReportingOperator
from ..data.select import open_collection, select
from . import job_result
from .job_options import JobOptions

BACKGROUND = bpy.app.background
# options of the command line by the kind of their property; 0 and "auto" are those of the command line itself
NUMBERS = (
    "lambda_f", "target", "target_count", "target_size", "max_drop", "max_flip", "max_lpips", "time"
)  # fmt: skip
CHOICES = ("outside", "exposure", "refine_poses")
FLAGS = ("quick", "mask_distractors", "invert_masks", "seen_from_only", "force")


class SVRGS_OT_prune(JobOptions, ReportingOperator):
    bl_label = "Prune Splat"
    bl_description = (
        "Remove the Gaussians that the photographs do not need, then recover the quality. Without"
        " photographs, the splat's own pictures take their place. The original stays, hidden"
    )

    scene: StringProperty(
        name="Scene",
        subtype="FILE_PATH",
        options=RELATIVE,
        description="Splat file to prune. Empty: the active splat",
    )
    out: StringProperty(
        name="Output",
        subtype="FILE_PATH",
        options=RELATIVE,
        description=(
            "File for the pruned splat, which is also added to the scene. Empty: no file, or NAME_pruned.spz"
            " in background mode"
        ),
    )
    overwrite: BoolProperty(name="Overwrite", description="Replace the output if it exists")
    report_folder: StringProperty(
        name="Report",
        subtype="DIR_PATH",
        options=RELATIVE,
        description="Folder for an HTML report. Empty: no report",
    )
    lambda_f: option_property(
        "lambda_f",
        name="λ_F",
        soft_min=1e-5,
        soft_max=1e-3,
        precision=5,
        description="Strength of pruning; a higher λ_F keeps fewer Gaussians. 0: the method's default",
    )
    target: option_property(
        "target", subtype="FACTOR", description="Share of the Gaussians to keep. 0: the method decides"
    )
    target_count: option_property(
        "target_count", min=0, description="Number of Gaussians to keep. 0: the method decides"
    )
    target_size: option_property(
        "target_size", description="Size of the output in MB, instead of a number. 0: no such goal"
    )
    max_drop: option_property(
        "max_drop",
        precision=2,
        description="PSNR in dB that may be lost, instead of a target. 0: no such limit",
    )
    max_flip: option_property(
        "max_flip",
        name="Max FLIP",
        precision=3,
        description="By how much FLIP may rise, instead of a target. 0: no such limit",
    )
    max_lpips: option_property(
        "max_lpips",
        name="Max LPIPS",
        precision=3,
        description=(
            "By how much LPIPS may rise, instead of a target; it needs the weights of LPIPS. 0: no such limit"
        ),
    )
    time: option_property(
        "time", description="Seconds that the job may take, in place of numbers of steps. 0: no limit"
    )
    iterations: option_property("iterations")
    recovery: option_property("recovery")
    quick: option_property(
        "quick",
        description=(
            "Remove and merge within seconds, on the splat's own pictures instead of photographs. It needs a"
            " target"
        ),
    )
    cameras: option_property(
        "cameras",
        subtype="FILE_PATH",
        options=RELATIVE,
        description=(
            "Without photographs, a file of views that matter besides the placed ones: cameras.json of 3DGS,"
            " or transforms.json"
        ),
    )
    seen_from_only: option_property(
        "seen_from_only",
        description="Only what the views of Cameras show counts: what they do not see may be removed",
    )

    @classmethod
    def problem(cls, context) -> str:
        return "" if context.mode == "OBJECT" else tr("Leave Edit Mode first")

    def work(self, context) -> str:
        source = None if self.scene else context.object
        with tempfile.TemporaryDirectory(dir=bpy.app.tempdir) as temp_dir:
            result, pruned = self.prune(source, Path(temp_dir), threads(context))
        if source is not None:
            job_result.make_room(source)
            obj = splat_object.copy_with(source, f"{source.name} pruned", pruned)
            pairs.join(source, obj)
            pairs.set_hidden(source, True)
            pairs.set_hidden(obj, False)
        else:
            name = f"{Path(self.scene).stem} pruned"
            obj = splat_object.object_from_scene(name, pruned, open_collection(context))
        select(context, [obj])
        total, before, after = result["before"]["count"], result["before"].get("psnr"), result.get("psnr")
        texts = [tr("Kept {kept:,} of {count:,} Gaussians").format(kept=result["count"], count=total)]
        if before is not None and after is not None:  # null: identical images
            texts.append(tr("PSNR changed by {difference:+.2f} dB").format(difference=after - before))
        return ". ".join([*texts, *result["notes"]])

    def prune(self, source: bpy.types.Object | None, temp_dir: Path, threads: int):
        """(the JSON result, the pruned scene). Prints the result as one line, as `svrgs prune --json` does.

        In it, `scene` is the .blend if the active splat was pruned, and `out` is null if no file was written.
        """
        scene = origin = absolute(self.scene)
        if not self.scene:
            gaussians = splat_object.scene_from_object(source)  # raises SceneError if there is no splat
            if problem := edit_guard.problem(bpy.context, source):
                raise SplatError(problem)
            gaussians = gaussians.select(~selection.hidden(source))  # those stay hidden
            scene, origin = str(temp_dir / "scene.ply"), bpy.data.filepath
        out = self.output(source)
        if source is not None:
            write_scene(scene, gaussians)
        written = out or temp_dir / "pruned.ply"
        words = ["prune", scene, "--out", str(written), *self.arguments(source), "--threads", str(threads)]
        result = subprocess_python.ask(words)
        print(json.dumps(result | {"scene": origin or None, "out": str(out) if out else None}), flush=True)
        return result, read_scene(written)

    def output(self, source: bpy.types.Object | None) -> Path | None:
        """The file to write; None: none. Raises SplatError if there is no place for it, and if it exists and
        may not be replaced."""
        if self.out:
            out = Path(absolute(self.out))
            if out.is_dir():
                raise SplatError(tr("{file}: is a folder; give the name of a file").format(file=out))
            format_to_write(out)
        elif not BACKGROUND:
            return None
        elif source is None:
            out = default_output(Path(absolute(self.scene)), "out=")
        elif bpy.data.filepath:
            out = default_output(Path(bpy.data.filepath).with_name(bpy.path.clean_name(source.name)), "out=")
        else:
            text = tr(
                "name a file for the result with out=: in background mode it lies beside the .blend, and this"
                " one has not been saved"
            )
            raise SplatError(text)
        if out.exists() and not self.overwrite:
            text = tr("{file}: exists; name another output with out=, or replace it with overwrite=True")
            raise SplatError(text.format(file=out))
        return out

    def arguments(self, source: bpy.types.Object | None) -> list[str]:
        """The options of `svrgs prune`: those of the operator, and the dataset that was imported with the
        splat."""
        # a quick job takes the splat's own pictures
        root = {} if self.quick else splat_object.root_of(source) or {}
        data, images = self.data, self.images
        if not data:
            data, images = root.get(splat_object.DATASET, ""), images or root.get(splat_object.IMAGES, "")
        given = {
            "data": absolute(data), "images": images, "report": absolute(self.report_folder),
            "seen-from": absolute(self.cameras), "masks": absolute(self.masks),
            **{name: getattr(self, name) for name in NUMBERS},
            **{name: choice for name in CHOICES if (choice := getattr(self, name)) != "auto"},
        }  # fmt: skip
        words = [f"{_flag(name)}={value}" for name, value in given.items() if value]
        words += [_flag(name) for name in FLAGS if getattr(self, name)]
        is_set, planned = self.properties.is_property_set, self.time or self.quick
        exact = [name for name in ("iterations", "recovery") if not planned or is_set(name)]
        exact += ["method"] if is_set("method") or (data and not self.quick) else []
        exact += ["sh_degree"] if is_set("sh_degree") else []
        words += [f"{_flag(name)}={getattr(self, name)}" for name in (*exact, "seed")]
        return [*words, "--quiet", "--json"]


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"

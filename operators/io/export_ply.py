"""File > Export: writes the active splat into a file: what is seen of it, or all that is stored.

A splat that was neither edited nor moved since its import is exported byte for byte.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty
from bpy_extras.io_utils import ExportHelper

from ...svrgs_addon.files import registry
from ...svrgs_addon.native.rasterizer import Rasterizer
from ...svrgs_addon.prune.belonging import MIN_SEEN, seen_of
from ...svrgs_addon.prune.likeness import Likeness
from ...svrgs_addon.prune.seen import fewer_bands, seen_from
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.system.errors import SceneError
from ..data import quick_order, splat_object, visible_splats
from ..data.extension import native_problem, use_threads
from ..data.file_kinds import KINDS, default_kind, format_of
from ..data.option_properties import sh_degree_property
from ..data.reporting import BackgroundOperator, Steps, menu
from ..data.splat_size import size_in
from ..jobs import job_result
from .export_space import ExportSpace, camera_objects, imported_cameras, shows_original


class SVRGS_OT_export_ply(BackgroundOperator, ExportHelper, ExportSpace):
    bl_label = "Export 3D Gaussian Splat"
    bl_description = "Write the active splat into a 3DGS file, as it is seen"
    bl_options = {"REGISTER", "PRESET"}

    filename_ext = registry.USUAL.suffixes[0]
    kind: EnumProperty(
        name="Format",
        description="Format of the file. It gives the name its suffix",
        items=KINDS,
        default=registry.USUAL.name,
    )
    version: EnumProperty(
        name="Version",
        description="Version of the format",
        items=[
            ("0", "Automatic", "4, and 3 without spherical harmonics, which Blender 5.3 does not read as 4"),
            ("4", "4", "The newest version"),
            ("3", "3", "For programs that do not read version 4 yet"),
            ("2", "2", "For programs that do not read version 3 yet"),
        ],
    )
    sh_degree: sh_degree_property(
        description=(
            "Highest degree of the spherical harmonics in the file. Those that stay take up what the imported"
            " cameras see of the others, if By Cameras is on"
        )
    )
    quantise: FloatProperty(
        name="SH Error",
        description=(
            "Factor on the error in colours that depend on the view. Above 1 for smaller files, below 1 for"
            " more exact ones"
        ),
        default=1.0,
        min=0.1,
        max=10.0,
    )
    by_views: BoolProperty(
        name="By Cameras",
        default=True,
        description=(
            "Round spherical harmonics, and leave them out, by where the imported cameras see each Gaussian"
            " from: a smaller file that loses less. Takes some seconds for each million Gaussians"
        ),
    )
    filter_glob: StringProperty(
        default=";".join(f"*{suffix}" for suffix in registry.suffixes(written=True)), options={"HIDDEN"}
    )

    @classmethod
    def problem(cls, context) -> str:
        return "" if splat_object.is_splat(context.object) else tr("Select a Gaussian splat first")

    def invoke(self, context, event):
        self.in_window = True
        if not self.properties.is_property_set("kind"):
            self.kind = default_kind(context.object)
        if not self.properties.is_property_set("filepath"):
            self.filepath = str(default_path(context.object))
        self.check(context)
        return super().invoke(context, event)

    def check(self, context):
        """Gives the name the suffix of the format. Returns whether it had another one."""
        wanted = format_of(self.kind).suffixes[0]
        path = Path(self.filepath)
        name, suffix = registry.split_name(path)
        if suffix.lower() == wanted:
            return False
        stem = name if suffix.lower() in registry.suffixes() else path.name
        self.filepath = str(path.with_name(stem + wanted))
        return True

    def draw(self, context):
        self.layout.use_property_split = True
        self.layout.prop(self, "kind")
        obj = context.object
        splat_format = format_of(self.kind)
        if splat_format.versions:
            self.layout.prop(self, "version")
        if degree := splat_object.sh_degree(obj):
            if splat_format.most_degree:
                self.layout.prop(self, "sh_degree")
            if splat_format.quantises:
                self.layout.prop(self, "quantise")
            rounds = splat_format.quantises or degree > min(self.sh_degree, splat_format.most_degree)
            if rounds and camera_objects(context, obj):
                self.layout.prop(self, "by_views")
        if foreseen := size_in(obj, self.count(obj), self.kind, self.quantise, self.sh_degree):
            self.layout.label(text=foreseen)
        self.draw_space(self.layout)

    def count(self, obj: bpy.types.Object) -> int:
        """How many Gaussians the file will have, but for what modifiers add."""
        if self.what == "STORED":
            return splat_object.count(obj)
        if quick_order.is_shown(obj):
            return quick_order.count(obj)
        if shows_original(obj):
            return job_result.Shown(obj).seen
        return splat_object.count(obj) - visible_splats.marked_count(obj)

    def steps(self, context) -> Steps:
        obj, path = context.object, Path(bpy.path.abspath(self.filepath))
        if not path.parent.is_dir():
            raise SceneError(tr("{folder}: there is no such folder").format(folder=path.parent))
        if self.properties.is_property_set("kind") and registry.format_to_write(path) != format_of(self.kind):
            text = tr("{file}: is not the name of a file in the format '{format}'")
            raise SceneError(text.format(file=path.name, format=self.kind))
        scene, dropped = self.chosen(context, obj)
        splat_format = registry.format_to_write(path)
        version = int(self.version) if splat_format.versions else 0
        quantise = self.quantise if splat_format.quantises else 1.0
        lost = registry.left_out(scene, splat_format)
        left, views = [*self.left_out(obj, dropped), *lost], self.views(context, obj)
        own = splat_object.root_of(obj) is not None
        work = partial(written, path, scene, version, quantise, self.sh_degree, *views, own)
        size, psnr, counted = yield work
        if not counted:
            left.append(tr("the imported cameras see little of it, so they do not count"))
        text = tr("Exported {count:,} Gaussians to {file}, {size:.1f} MB").format(
            count=scene.count, file=path, size=size / 1e6
        )
        if psnr is not None:
            text = tr("{text}, PSNR {psnr:.1f} dB against the splat").format(text=text, psnr=psnr)
        self.report({"WARNING" if lost else "INFO"}, "; ".join([text, *left]))
        return ""

    def views(self, context, obj: bpy.types.Object) -> tuple[list[Camera], list[Camera]]:
        """Those by which the file is rounded, and those in which it is compared with the splat, in its
        coordinates."""
        if native_problem():
            return [], []
        use_threads(context)
        deciding, held_out = imported_cameras(context, obj)
        return self.in_space(obj, deciding if self.by_views else []), self.in_space(obj, held_out)


def written(
    path: Path,
    scene: Scene,
    version: int,
    quantise: float,
    degree: int,
    deciding: list[Camera],
    held_out: list[Camera],
    own: bool,
) -> tuple[int, float | None, bool]:
    """Writes the file with SH up to this degree, rounded by the views that decide. Its bytes; its PSNR in dB
    against the scene in those held out (None: of a file with all values, or without a view that sees the
    scene); and whether the views counted: if they are not the splat's own, they must see half of it."""
    counted = own or not deciding or seen_of(scene, deciding).share >= MIN_SEEN
    if not counted:
        deciding, held_out = [], []
    splat_format = registry.format_to_write(path)
    banded = fewer_bands(scene, min(degree, splat_format.most_degree), deciding)
    registry.write_scene(path, banded, version, quantise, seen_from(banded, deciding, path))
    likeness, psnr = Likeness(scene, held_out, Rasterizer), None
    if held_out and not (splat_format.lossless and banded is scene) and likeness.views:
        psnr = likeness.psnr(registry.read_back(path, banded))
    return path.stat().st_size, psnr, counted


def default_path(obj: bpy.types.Object) -> Path:
    """A file beside the .blend file, with the name of the splat, in the format of its file."""
    folder = Path(bpy.data.filepath).parent if bpy.data.filepath else Path()
    return folder / (bpy.path.clean_name(obj.name) + format_of(default_kind(obj)).suffixes[0])


MENUS = {"TOPBAR_MT_file_export": menu(SVRGS_OT_export_ply, text=registry.menu_label(written=True))}

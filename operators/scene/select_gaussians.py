"""Select Gaussians by a criterion, delete the selected or all others, and clear the selection.

The selection is an attribute of the splat (selection.py), so undo, copies and saved files keep it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, StringProperty

from ...svrgs_addon.prune.belonging import MIN_SEEN, Seen, percent, seen_of
from ...svrgs_addon.prune.selection.options import Criteria
from ...svrgs_addon.system.errors import SceneError
from ..data import edit_guard, quick_order, selection, splat_object
from ..data.extension import use_threads
from ..data.reporting import ReportingOperator
from ..translation import OWN
from .contribution import cameras_property, chosen_cameras, views

MOST_VIEWS = 64  # views that are rendered, evenly spaced in the list


class Criterion(NamedTuple):
    """What can decide which Gaussians are selected."""

    name: str
    description: str
    shown: tuple[str, ...]  # the properties of the operator that it uses
    wanted: Callable[[SVRGS_OT_select_gaussians], dict]  # Criteria; of Edit Mode none


CRITERIA = {
    "BOX": Criterion("Box",
        "Centres inside the bounding box of an object, turned with it; an empty counts as a cube of its size",
        ("volume",), lambda _: {"box": selection.UNIT_BOX}),
    "SPHERE": Criterion("Sphere",
        "Centres inside the sphere or ellipsoid that fills the bounding box of an object; an empty counts as"
        " a sphere of its size", ("volume",), lambda _: {"sphere": selection.UNIT_SPHERE}),
    "OPACITY": Criterion("Opacity", "Opacity in a range", ("opacity_low", "opacity_high"),
        lambda chosen: {"opacity": (chosen.opacity_low, chosen.opacity_high)}),
    "SIZE": Criterion("Size", "Largest standard deviation in a range", ("size_low", "size_high"),
        lambda chosen: {"size": (chosen.size_low, chosen.size_high or math.inf)}),
    "COLOR": Criterion("Color", "Base colour, without what depends on the view, near a colour",
        ("color", "tolerance"), lambda chosen: {"color": (*chosen.color, chosen.tolerance)}),
    "CONTRIBUTION": Criterion("Contribution", "Those that add least to the images of the cameras",
        ("cameras", "share"), lambda chosen: {"lowest_contribution": chosen.share / 100}),
    "REMOVAL_ERROR": Criterion("Removal Error",
        "Those whose removal would change the images of the cameras least",
        ("cameras", "share"), lambda chosen: {"lowest_removal_error": chosen.share / 100}),
    "SEEN": Criterion("Seen by Camera", "Those that a camera shows, in front of or through others",
        ("cameras",), lambda _: {"seen_by": "all"}),
    "FLOATERS": Criterion("Floaters",
        "Small groups apart from all others and, with at least 8 cameras, haze in front of the cameras",
        ("cameras",), lambda _: {"floaters": True}),
    "EDIT_MODE": Criterion("Edit Mode", "The points that are selected in Edit Mode", (), lambda _: {}),
}  # fmt: skip
MODES = [
    ("SET", "Set", "Select these only", "SELECT_SET", 0),
    ("EXTEND", "Extend", "Add these to the selection", "SELECT_EXTEND", 1),
    ("SUBTRACT", "Subtract", "Remove these from the selection", "SELECT_SUBTRACT", 2),
    ("INTERSECT", "Intersect", "Keep only these of the selection", "SELECT_INTERSECT", 3),
]
CHANGES = [
    ("INVERT", "Invert", "Select the Gaussians that are not selected"),
    ("GROW", "Grow", "Select also the nearest Gaussians around those that are selected"),
    ("SHRINK", "Shrink", "Keep those whose nearest Gaussians are all selected"),
]
RANKED = ("CONTRIBUTION", "REMOVAL_ERROR")  # criteria that also rank the Gaussians that no camera sees


def mode_property():
    """The menu of MODES."""
    text = "What happens with the Gaussians that are selected already"
    return EnumProperty(name="Mode", items=MODES, translation_context=OWN, description=text)


class SplatOperator(ReportingOperator):
    """An operator on the active splat."""

    @classmethod
    def problem(cls, context) -> str:
        if not splat_object.is_splat(context.object):
            return tr("Make a splat the active object first")
        return cls.problem_of(context, context.object)

    @classmethod
    def problem_of(cls, context, obj: bpy.types.Object) -> str:
        """As problem(), of a splat."""
        if quick_order.is_shown(obj):
            return tr("Apply or discard the result first")
        return edit_guard.problem(context, obj)


class SVRGS_OT_select_gaussians(SplatOperator):
    bl_label = "Select Gaussians"
    bl_description = (
        "Select Gaussians of the active splat by a criterion. The selection is stored as the attribute"
        " 'svrgs:selected'"
    )

    criterion: EnumProperty(
        name="Criterion",
        items=[(key, one.name, one.description) for key, one in CRITERIA.items()],
        default="FLOATERS",
        description="What decides which Gaussians are selected",
    )
    mode: mode_property()
    invert: BoolProperty(name="Invert", description="Take all Gaussians that do not fulfil the criterion")
    volume: StringProperty(
        name="Object",
        options={"SKIP_SAVE"},
        description="The object that bounds the box or sphere. Empty: the other selected object",
    )
    opacity_low: FloatProperty(name="From", min=0, max=1, subtype="FACTOR", description="Lowest opacity")
    opacity_high: FloatProperty(
        name="To", min=0, max=1, default=0.1, subtype="FACTOR", description="Highest opacity"
    )
    size_low: FloatProperty(
        name="From", min=0, default=0.1, precision=4, subtype="DISTANCE", description="Smallest size"
    )
    size_high: FloatProperty(
        name="To", min=0, precision=4, subtype="DISTANCE", description="Largest size. 0: no limit"
    )
    share: FloatProperty(
        name="Lowest",
        min=0.01,
        max=100,
        default=20,
        subtype="PERCENTAGE",
        description="Percentage of the Gaussians, those with the lowest values",
    )
    color: FloatVectorProperty(
        name="Color", subtype="COLOR_GAMMA", min=0, max=1, description="Pick it in the viewport"
    )
    tolerance: FloatProperty(
        name="Tolerance",
        min=0,
        max=2,
        default=0.15,
        description="Largest distance from the colour; from black to white it is 1.7",
    )
    cameras: cameras_property()

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "criterion")
        for name in CRITERIA[self.criterion].shown:
            if name == "volume":
                layout.prop_search(self, name, context.scene, "objects")
            else:
                layout.prop(self, name)
        layout.row().prop(self, "mode", expand=True)
        layout.prop(self, "invert")

    def work(self, context) -> str:
        obj = context.object
        use_threads(context)
        seen: list[Seen] = []
        if self.criterion == "EDIT_MODE":
            mask = selection.found_in_edit_mode(obj)
        else:
            wanted = Criteria(**CRITERIA[self.criterion].wanted(self))
            volume = self.volume_object(context) if wanted.box or wanted.sphere else None
            views = lambda placed, named: self.views(context, placed, named, seen)
            mask = selection.find(obj, wanted, views, volume)
        text = changed(context, obj, mask, self.mode, self.invert)
        if not seen:
            return text
        return tr(
            "{selected}; {views} views see only {share} of the Gaussians, and those they do not see come"
            " first"
        ).format(selected=text, views=seen[0].views, share=percent(seen[0].share))

    def volume_object(self, context) -> bpy.types.Object:
        """The object that bounds the box or sphere. Raises SceneError if none is chosen."""
        others = [obj for obj in context.selected_objects if obj != context.object]
        found = others[0] if len(others) == 1 else None
        if self.volume:
            found = context.scene.objects.get(self.volume)
        if found is None:
            raise SceneError(
                tr("choose the object that bounds the box or sphere, such as a cube around the Gaussians")
            )
        self.volume = found.name
        return found

    def views(self, context, placed, named: str, seen: list[Seen]) -> list:
        """The views of the chosen cameras. named: empty if none is needed. seen: a list to which Seen is
        added if the criterion ranks all Gaussians and the views see less than MIN_SEEN of them. Raises
        SceneError."""
        cameras = chosen_cameras(context, self.cameras)
        if not (named or cameras):
            return []
        found = views(context, cameras[:: max(1, -(-len(cameras) // MOST_VIEWS))], placed)
        if self.criterion in RANKED and (part := seen_of(placed.scene, found)).share < MIN_SEEN:
            seen.append(part)
        return found


class SVRGS_OT_delete_gaussians(SplatOperator):
    bl_label = "Delete Gaussians"
    bl_description = "Delete the selected Gaussians of the active splat, or all others"

    what: EnumProperty(
        name="What", description="The Gaussians to delete",
        items=[("SELECTED", "Selected", "Delete the selected Gaussians"), ("OTHERS", "All Others",
        "Keep only the selected Gaussians")],
    )  # fmt: skip

    @classmethod
    def problem_of(cls, context, obj: bpy.types.Object) -> str:
        if problem := edit_guard.change_problem(context, [obj]):
            return problem
        return "" if selection.SELECTED in obj.data.attributes else tr("Select Gaussians first")

    def work(self, context) -> str:
        obj = context.object
        before = splat_object.count(obj)
        selection.delete(obj, self.what == "OTHERS")
        show_selection(context, False)
        text = tr("Deleted {deleted:,} of {count:,} Gaussians")
        return text.format(deleted=before - splat_object.count(obj), count=before)


class SVRGS_OT_hide_gaussians(SplatOperator):
    bl_label = "Hide Selected"
    bl_description = (
        "Hide the selected Gaussians of the active splat: no view, picture or file shows them. Pruning takes"
        " them along"
    )

    problem_of = SVRGS_OT_delete_gaussians.problem_of

    def work(self, context) -> str:
        count = selection.hide(context.object)
        show_selection(context, False)
        return tr("Hid {count:,} Gaussians").format(count=count)


class SVRGS_OT_show_gaussians(SplatOperator):
    bl_label = "Show Hidden"
    bl_description = "Show the Gaussians of the active splat that were hidden"

    @classmethod
    def problem_of(cls, context, obj: bpy.types.Object) -> str:
        if problem := edit_guard.change_problem(context, [obj]):
            return problem
        return "" if selection.hidden_count(obj) else tr("No Gaussian is hidden")

    def work(self, context) -> str:
        count = selection.hidden_count(context.object)
        selection.show_all(context.object)
        return tr("{count:,} Gaussians are shown again").format(count=count)


class SVRGS_OT_separate_gaussians(SplatOperator):
    bl_label = "Separate Gaussians"
    bl_description = "Make the selected Gaussians of the active splat a splat of their own, in the same place"

    problem_of = SVRGS_OT_delete_gaussians.problem_of

    def work(self, context) -> str:
        before = splat_object.count(context.object)
        other = selection.separate(context.object)
        show_selection(context, False)
        text = tr("Separated {count:,} of {before:,} Gaussians as '{name}'")
        return text.format(count=splat_object.count(other), before=before, name=other.name)


class SVRGS_OT_change_selection(SplatOperator):
    bl_label = "Change Selection"
    bl_description = "Invert, grow or shrink the selection of the active splat"

    how: EnumProperty(name="How", description="What becomes of the selection", items=CHANGES)

    @classmethod
    def description(cls, context, properties):
        return tr(next(text for how, _, text in CHANGES if how == properties.how))

    def work(self, context) -> str:
        obj = context.object
        found = {"INVERT": selection.read, "GROW": selection.grown, "SHRINK": selection.shrunk}[self.how](obj)
        return changed(context, obj, found, "SET", self.how == "INVERT")


class SVRGS_OT_clear_selection(SplatOperator):
    bl_label = "Clear Selection"
    bl_description = "Select no Gaussian of the active splat"

    @classmethod
    def problem_of(cls, context, obj: bpy.types.Object) -> str:
        if problem := edit_guard.problem(context, obj):
            return problem
        return "" if selection.SELECTED in obj.data.attributes else tr("No Gaussian is selected")

    def work(self, context) -> str:
        selection.clear(context.object)
        show_selection(context, False)
        return tr("No Gaussian is selected")


def changed(context, obj: bpy.types.Object, mask, mode: str, invert: bool = False) -> str:
    """Changes the selection of a splat as selection.change() does, and shows it. Returns what is selected, in
    words."""
    count = selection.change(obj, mask, mode, invert)
    show_selection(context, count > 0)
    text = tr("Selected {selected:,} of {count:,} Gaussians")
    return text.format(selected=count, count=splat_object.count(obj))


def show_selection(context, shown: bool):
    """Solid viewports show the selection, or the colours again. Other values that they show stay."""
    view, colors = context.scene.svrgs_view, ("COLOR", selection.SELECTED)
    if view.overlay_shown in colors:
        view.overlay_shown = colors[shown]

"""File > Import > Cameras and Photographs: cameras with their photographs, and the sparse points.

Cameras and points become children of an empty, the root, together with the splat that is active. The root
takes the place of the splat, so moving the root moves all. It is turned until the photographs stand upright;
the numbers of splat and cameras stay.

A camera stores the size and the pixel aspect of its photograph and gives them to the scene when it becomes
the scene's camera (active_camera.py).
"""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, StringProperty
from mathutils import Matrix

from ...svrgs_addon.system.errors import SceneError
from ...svrgs_addon.views.posed_photos import PosedPhotos, read_in_child
from ..data import camera_object, edit_guard, splat_object, views_of_file
from ..data.framing import level
from ..data.reporting import FolderOperator, menu
from ..data.select import open_collection, select
from ..data.world_matrix import world_matrix
from ..scene import dataset_paths
from ..scene.frame import frame
from ..translation import OWN
from . import undistort


class SVRGS_OT_import_colmap(FolderOperator):
    bl_label = "Import Cameras"
    bl_description = (
        "Import the cameras, photographs and sparse points of a dataset of COLMAP or transforms.json. They"
        " are placed with the active splat"
    )
    bl_options = {"REGISTER", "UNDO", "PRESET"}

    directory: StringProperty(
        name="Dataset",
        subtype="DIR_PATH",
        description="Folder of the dataset. It holds the photographs, and a COLMAP model or transforms.json",
    )
    images: StringProperty(
        name="Images", description="Name of the image folder in the dataset, such as images_4. Empty: images"
    )
    photographs: BoolProperty(
        name="Photographs", default=True, description="Show each photograph as the background of its camera"
    )
    undistorted: StringProperty(
        name="Undistorted",
        description=(
            "Folder for undistorted copies of photographs with lens distortion. Empty: images_undistorted in"
            " the dataset"
        ),
    )
    points: BoolProperty(
        name="Sparse Points",
        default=True,
        description="Import the sparse points as a mesh. It is hidden at first",
    )
    level: BoolProperty(
        name="Level",
        translation_context=OWN,
        default=True,
        description=(
            "Turn cameras and splat upright, as the photographs say. What you have moved already stays as"
            " it is"
        ),
    )
    frame: BoolProperty(
        name="Frame",
        translation_context=OWN,
        default=True,
        description="Turn the 3D viewports to the splat, or to the cameras if there is none",
    )

    def work(self, context) -> str:
        folder = Path(bpy.path.abspath(self.directory))
        active = context.object if splat_object.is_splat(context.object) else None
        if active is not None and splat_object.root_of(active) is None:
            if problem := edit_guard.problem(context, active) or edit_guard.animated([active]):
                raise SceneError(problem)
            views_of_file.refuse_stretched(active)
        photos = read_in_child(folder, self.images)
        root, cameras = self.add_objects(context, folder.absolute(), photos)
        levelled = level(root, photos.cameras) if self.level else ""
        splat = active if splat_object.root_of(active) == root else None
        select(context, [splat or root])
        if self.frame:
            frame(context, [splat or root])
        undistort.begin(photos.warnings, root)
        if self.photographs:
            self.show_photographs(folder, root, cameras, photos)
        if problems := undistort.problems():
            self.report({"WARNING"}, problems)
        texts = [*self.done(context, cameras, photos), joined(active, splat), levelled]
        return "; ".join(filter(None, texts))

    def done(self, context, cameras: list[bpy.types.Object], photos: PosedPhotos) -> list[str]:
        """What was imported, in words."""
        shown = sum(bool(camera_object.backgrounds(obj)) for obj in cameras)
        done, total = undistort.progress()
        text = tr("Imported {cameras:,} cameras and {photographs:,} photographs")
        parts = [text.format(cameras=len(cameras), photographs=shown)]
        if total > done:
            text = tr("{count:,} photographs are being undistorted first")
            parts.append(text.format(count=total - done))
        if self.points:
            parts.append(tr("{count:,} sparse points, hidden").format(count=len(photos.points)))
        render, text = context.scene.render, tr("the scene's camera is now '{name}', {width} x {height}")
        size = {"width": render.resolution_x, "height": render.resolution_y}
        return [*parts, text.format(name=context.scene.camera.name, **size)]

    def show_photographs(
        self, folder: Path, root: bpy.types.Object, cameras: list[bpy.types.Object], photos: PosedPhotos
    ):
        """Gives cameras their photographs as backgrounds; starts undistorting where that is needed."""
        for obj, file in zip(cameras, photos.files, strict=True):
            undistort.show(obj, file)
        if photos.distorted:
            chosen = Path(bpy.path.abspath(self.undistorted))
            target = chosen if self.undistorted else folder / dataset_paths.UNDISTORTED
            undistort.start(cameras, root, folder, self.images, target, photos.distorted)

    def add_objects(
        self, context, folder: Path, photos: PosedPhotos
    ) -> tuple[bpy.types.Object, list[bpy.types.Object]]:
        """Adds points and cameras below a root, in place of cameras of the same photographs. Returns root and
        cameras; the first becomes the scene's camera."""
        name = folder.name
        collection = bpy.data.collections.new(name)
        open_collection(context).children.link(collection)
        root, points = root_for(context.object, folder, collection), []
        cameras = camera_object.photographs(root.children)
        former = {obj.name: obj for obj in cameras if _is_as_imported(obj)}
        if self.points:
            for obj in [obj for obj in root.children if _are_points_as_imported(obj, root)]:
                splat_object.delete(obj)
        root[splat_object.DATASET], root[splat_object.IMAGES] = dataset_paths.stored(str(folder)), self.images
        root[splat_object.POINTS] = len(photos.points)
        if self.points and len(photos.points):
            found = photos.points, photos.point_colors
            points.append(splat_object.points_object(f"{name} points", *found, collection))
        extent = photos.extent or 1.0
        cameras = [camera_object.new_camera(camera, extent, collection) for camera in photos.cameras]
        for obj in points + cameras:
            obj.parent = root
        context.scene.camera = cameras[0]
        for obj, camera in zip(cameras, photos.cameras, strict=True):
            if camera.name in former:
                former[camera.name].user_remap(obj)
                bpy.data.cameras.remove(former[camera.name].data)
            obj.name = obj.data.name = camera.name
        camera_object.apply_camera_size(context.scene)
        context.view_layer.update()
        for obj in points:
            obj.hide_set(True)  # they would cover the splat, and without one they are black
        return root, cameras


def _is_as_imported(obj: bpy.types.Object) -> bool:
    """Whether the user has made nothing else of the camera of a photograph."""
    untouched = obj.animation_data is None and obj.data.animation_data is None
    return obj.name == obj.data[camera_object.IMAGE] and obj.data.users == 1 and untouched


def _are_points_as_imported(obj: bpy.types.Object, root: bpy.types.Object) -> bool:
    """Whether they are the sparse points of the root's dataset, of which the user has made nothing else."""
    name = Path(dataset_paths.dataset_of_root(root)).name
    if obj.name != f"{name} points" or not splat_object.has_its_points(obj) or obj.matrix_basis != Matrix():
        return False
    used = obj.modifiers or obj.children or obj.data.materials or obj.animation_data
    return not used and obj.data.users == 1


def joined(active: bpy.types.Object | None, splat: bpy.types.Object | None) -> str:
    """What became of the active splat, in words. splat: the one that the cameras were joined to."""
    if splat is not None:
        return tr("joined to '{name}'").format(name=splat.name)
    if active is not None:
        return tr("'{name}' keeps the cameras of another dataset").format(name=active.name)
    return ""


def root_for(
    obj: bpy.types.Object | None, folder: Path, collection: bpy.types.Collection
) -> bpy.types.Object:
    """The root above the object, if it has no cameras of another dataset; a new root in its place if it is a
    splat without one; else a new root with z up."""
    root = splat_object.root_of(obj)
    if root is not None and dataset_paths.dataset_of_root(root) in ("", dataset_paths.absolute(str(folder))):
        return root
    if root is not None or not splat_object.is_splat(obj):
        return splat_object.new_root(folder.name, collection)
    splat_object.in_file_coordinates(obj)
    root = splat_object.new_root(folder.name, collection, world_matrix(obj))
    splat_object.parent_to_root(obj, root)
    return root


MENUS = {
    "TOPBAR_MT_file_import": menu(
        SVRGS_OT_import_colmap, text="Cameras and Photographs (COLMAP, transforms.json)"
    )
}

"""File > Import > COLMAP Cameras: posed photographs and sparse points, below one root with the splat they belong to."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from ..svrgs_addon.blender.posed_photos import PosedPhotos, read_in_child
from ..svrgs_addon.camera import Camera
from ..svrgs_addon.errors import SplatError
from . import bridge, undistort
from .select import select

SHOWN_SIZE = 0.05  # of a camera in the viewport, in extents of all
CLIP_EXTENTS = 100


class SVRGS_OT_import_colmap(bpy.types.Operator):
    bl_idname = "svrgs.import_colmap"
    bl_label = "Import COLMAP Cameras"
    bl_description = "Import a COLMAP dataset: its cameras with their photographs, and its sparse points. They join the active splat"
    bl_options = {"REGISTER", "UNDO", "PRESET"}

    directory: StringProperty(name="Dataset", subtype="DIR_PATH", description="Folder of the dataset: its images folder and its sparse model")
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    images: StringProperty(name="Images", description="Name of the image folder in the dataset, such as images_4. Empty: images")
    photographs: BoolProperty(name="Photographs", default=True, description="Show each photograph in the background of its camera")
    undistorted: StringProperty(
        name="Undistorted",
        description="Folder for the undistorted photographs of lenses with distortion. Empty: images_undistorted in the dataset",
    )
    points: BoolProperty(name="Sparse Points", default=True, description="Import the sparse points as a mesh")

    def execute(self, context):
        folder = Path(bpy.path.abspath(self.directory))
        try:
            photos = read_in_child(folder, self.images)
        except SplatError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        splat = context.object if bridge.is_splat(context.object) else None
        root, cameras = self.build(context, folder.absolute(), photos)
        select(context, [splat or root])
        trouble = photos.warning or (self.show(folder, cameras, photos.files) if self.photographs else "")
        if trouble:
            self.report({"WARNING"}, trouble)
        shown = sum(bool(obj.data.background_images) for obj in cameras)
        self.report({"INFO"}, f"Imported {len(cameras):,} cameras, {shown:,} photographs and {len(photos.points):,} sparse points")
        return {"FINISHED"}

    def show(self, folder: Path, cameras: list[bpy.types.Object], files: list[Path | None]) -> str:
        """Puts photographs behind their cameras; those that have to be undistorted follow. Returns what went wrong."""
        for obj, file in zip(cameras, files, strict=True):
            undistort.show(obj, file)
        if None not in files:
            return ""
        undistorted = Path(bpy.path.abspath(self.undistorted)) if self.undistorted else folder / "images_undistorted"
        return undistort.start(cameras, folder, self.images, undistorted)

    def build(self, context, folder: Path, photos: PosedPhotos) -> tuple[bpy.types.Object, list[bpy.types.Object]]:
        """The root above the points and the cameras, and these; the first becomes the scene's camera."""
        name, beside = folder.name, bridge.is_splat(context.object)
        collection = bpy.data.collections.new(name)
        context.collection.children.link(collection)
        root, points = join(context.object, name, collection), []
        root[bridge.DATASET], root[bridge.IMAGES] = str(folder), self.images
        if self.points and len(photos.points):
            points.append(bridge.points_object(f"{name} points", photos.points, photos.point_colors, collection))
        cameras = [_camera(camera, photos.extent or 1.0, collection) for camera in photos.cameras]
        for obj in points + cameras:
            obj.parent = root
        context.scene.camera = cameras[0]
        bridge.apply_camera_size(context.scene)
        context.view_layer.update()
        for obj in points:
            obj.hide_set(beside)  # the points' dots would lie over the splat
        return root, cameras

    def invoke(self, context, event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


def join(obj: bpy.types.Object | None, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """The root the object is below; a new one in its place if it is a splat without; else a new one, upright."""
    root = bridge.root_of(obj)
    if root is not None:
        return root
    if not bridge.is_splat(obj):
        return bridge.new_root(name, collection)
    root = bridge.new_root(name, collection, obj.matrix_world)
    bridge.hang_below(obj, root)
    return root


def _camera(camera: Camera, extent: float, collection: bpy.types.Collection) -> bpy.types.Object:
    data = bpy.data.cameras.new(camera.name)
    obj = bpy.data.objects.new(camera.name, data)
    bridge.camera_to_object(camera, obj)
    data.display_size = SHOWN_SIZE * extent
    data.clip_start, data.clip_end = 1e-3 * extent, CLIP_EXTENTS * extent
    collection.objects.link(obj)
    return obj


def menu(self, context):
    self.layout.operator(SVRGS_OT_import_colmap.bl_idname, text="COLMAP Cameras (folder)")


def register():
    bpy.utils.register_class(SVRGS_OT_import_colmap)
    bpy.types.TOPBAR_MT_file_import.append(menu)


def unregister():
    undistort.forget()
    bpy.types.TOPBAR_MT_file_import.remove(menu)
    bpy.utils.unregister_class(SVRGS_OT_import_colmap)

"""File > Import > COLMAP Cameras: cameras with their photographs, and the sparse points.

Cameras and points become children of an empty, the root, together with the splat that is active. The root takes the place of the
splat, so moving the root moves all. A camera stores the size and the pixel aspect of its photograph and gives them to the scene when
it becomes the scene's camera (active_camera.py).
"""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from ..svrgs_addon.blender.posed_photos import PosedPhotos, read_in_child
from ..svrgs_addon.camera import Camera
from ..svrgs_addon.errors import SplatError
from . import bridge, dataset_paths, undistort
from .select import select

DISPLAY_SIZE = 0.05  # of a camera in the viewport, in extents of all cameras
CLIP_END = 100  # in extents of all cameras


class SVRGS_OT_import_colmap(bpy.types.Operator):
    bl_idname = "svrgs.import_colmap"
    bl_label = "Import COLMAP Cameras"
    bl_description = "Import the cameras, photographs and sparse points of a COLMAP dataset. They are placed with the active splat"
    bl_options = {"REGISTER", "UNDO", "PRESET"}

    directory: StringProperty(name="Dataset", subtype="DIR_PATH", description="Folder of the dataset. It holds the image folder and the sparse model")
    filter_folder: BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    images: StringProperty(name="Images", description="Name of the image folder in the dataset, such as images_4. Empty: images")
    photographs: BoolProperty(name="Photographs", default=True, description="Show each photograph as the background of its camera")
    undistorted: StringProperty(
        name="Undistorted",
        description="Folder for undistorted copies of photographs with lens distortion. Empty: images_undistorted in the dataset",
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
        root, cameras = self.add_objects(context, folder.absolute(), photos)
        select(context, [splat or root])
        problem = photos.warning or (self.show_photographs(folder, cameras, photos.files) if self.photographs else "")
        if problem:
            self.report({"WARNING"}, problem)
        shown = sum(bool(obj.data.background_images) for obj in cameras)
        self.report({"INFO"}, f"Imported {len(cameras):,} cameras, {shown:,} photographs and {len(photos.points):,} sparse points")
        return {"FINISHED"}

    def show_photographs(self, folder: Path, cameras: list[bpy.types.Object], files: list[Path | None]) -> str:
        """Gives cameras their photographs as backgrounds; starts undistorting where that is needed. Returns what went wrong."""
        for obj, file in zip(cameras, files, strict=True):
            undistort.show(obj, file)
        if None not in files:
            return ""
        undistorted = Path(bpy.path.abspath(self.undistorted)) if self.undistorted else folder / dataset_paths.UNDISTORTED
        return undistort.start(cameras, folder, self.images, undistorted)

    def add_objects(self, context, folder: Path, photos: PosedPhotos) -> tuple[bpy.types.Object, list[bpy.types.Object]]:
        """Adds points and cameras below a root. Returns root and cameras; the first becomes the scene's camera."""
        name, has_splat = folder.name, bridge.is_splat(context.object)
        collection = bpy.data.collections.new(name)
        context.collection.children.link(collection)
        root, points = root_for(context.object, name, collection), []
        root[bridge.DATASET], root[bridge.IMAGES] = dataset_paths.stored(str(folder)), self.images
        if self.points and len(photos.points):
            points.append(bridge.points_object(f"{name} points", photos.points, photos.point_colors, collection))
        cameras = [_camera(camera, photos.extent or 1.0, collection) for camera in photos.cameras]
        for obj in points + cameras:
            obj.parent = root
        context.scene.camera = cameras[0]
        bridge.apply_camera_size(context.scene)
        context.view_layer.update()
        for obj in points:
            obj.hide_set(has_splat)  # else the points would cover the splat
        return root, cameras

    def invoke(self, context, event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


def root_for(obj: bpy.types.Object | None, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """The root above the object; a new root in its place if it is a splat without one; else a new root with z up."""
    root = bridge.root_of(obj)
    if root is not None:
        return root
    if obj is None or not bridge.is_splat(obj):
        return bridge.new_root(name, collection)
    root = bridge.new_root(name, collection, obj.matrix_world)
    bridge.parent_to_root(obj, root)
    return root


def _camera(camera: Camera, extent: float, collection: bpy.types.Collection) -> bpy.types.Object:
    data = bpy.data.cameras.new(camera.name)
    obj = bpy.data.objects.new(camera.name, data)
    bridge.camera_to_object(camera, obj)
    data.display_size = DISPLAY_SIZE * extent
    data.clip_start, data.clip_end = 1e-3 * extent, CLIP_END * extent
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

"""Where the dataset of a splat is, how its path is stored, and how it is found again.

Paths are stored as Blender stores those of images: relative to the .blend file ("//…") where that is
possible, unless the preference Relative Paths is off. Blender adjusts its own paths when a file is saved in
another folder, but not properties of add-ons. So this is done here: of the datasets of roots and of the prune
panel, of masks, of job folders, and of the folder that was chosen for new jobs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import StringProperty

from ...svrgs_addon.system.errors import SplatError
from ...svrgs_addon.views.sources import find_cameras
from ..data import camera_object, splat_object
from ..data.job_paths import FOLDER, folder_of
from ..data.option_properties import RELATIVE
from ..data.reporting import FolderOperator

APPENDED = ("MAKE_LOCAL", "COPY_LOCAL")  # what Blender does with data that it appends
UNDISTORTED = "images_undistorted"  # folder of undistorted copies in a dataset

# (writes the path, the absolute path, from it and a folder to what is stored)
Place = tuple[Callable[[str], object], str, Callable[[str, str], str]]

_saved: list[Place] = []  # between save_pre and save_post


def dataset_of(context) -> tuple[str, str]:
    """(dataset, name of its image folder) to prune with: the chosen one, or that of the cameras imported with
    the splat. Absolute; '': none."""
    settings, root = context.scene.svrgs_prune, splat_object.root_of(context.object)
    if settings.data:
        return absolute(settings.data), settings.images
    if root is not None:
        return (dataset_of_root(root), settings.images or root.get(splat_object.IMAGES, ""))
    return ("", settings.images)


def masks_of(context) -> dict:
    """The options of a job that say what counts in its photographs."""
    settings = context.scene.svrgs_prune
    return {
        "masks": absolute(settings.masks), "invert_masks": settings.invert_masks, "outside": settings.outside
    }  # fmt: skip


def dataset_of_job(context, splat: bpy.types.Object | None) -> str:
    """Where the dataset of the splat's job may be now, if it was moved: that of its cameras, or the chosen
    one; '' for a job without its splat.

    Not the dataset of the active object, which may be of another scene.
    """
    if splat is None:
        return ""
    root, chosen = splat_object.root_of(splat), absolute(context.scene.svrgs_prune.data)
    of_cameras = dataset_of_root(root) if root is not None else ""
    return of_cameras if os.path.exists(of_cameras) else chosen


def problem(context) -> str:
    """Why there is no dataset to prune with, and what to do, in a sentence; '' if there is one."""
    folder, _ = dataset_of(context)
    if not folder:
        return tr("Choose the dataset of the splat's photographs, or import its cameras in Scene")
    if os.path.exists(folder):
        return ""
    if context.scene.svrgs_prune.data:
        return tr("There is no dataset {folder}: choose it again").format(folder=folder)
    return lost(splat_object.root_of(context.object))


def lost(root: bpy.types.Object | None) -> str:
    """That the dataset of the imported cameras is not where it was, in a sentence; '' if it is there, or if
    there is none."""
    folder = dataset_of_root(root) if root is not None else ""
    if root is None or not folder or os.path.exists(folder):
        return ""
    text = tr("The photographs of '{name}' are not in {folder} any more: press Find Dataset in Scene")
    return text.format(name=root.name, folder=folder)


def absolute(path: str, library: bpy.types.Library | None = None) -> str:
    """The path without '//', '..' and a slash at its end; '' for ''. library: the file to which '//' refers,
    if not the open one."""
    return os.path.normpath(bpy.path.abspath(path, library=library)) if path else ""


def dataset_of_root(root: bpy.types.Object) -> str:
    """The dataset of a root; '' if it has none."""
    return absolute(_text(root.get(splat_object.DATASET)), root.library)


def masks_of_job(root: bpy.types.Object) -> str:
    """The folder of the masks that the last job of a root's cameras wrote; '' if it wrote none."""
    return absolute(_text(root.get(splat_object.MASKS)), root.library)


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def stored(path: str, start: str = "") -> str:
    """How an absolute path is stored: relative to the .blend file with '/', so that other systems find it.
    start: the folder of that file, if not the present one."""
    start = start or os.path.dirname(bpy.data.filepath)
    if not start or not bpy.context.preferences.filepaths.use_relative_paths:
        return path
    try:
        return bpy.path.relpath(path, start=start).replace(os.sep, "/")
    except ValueError:  # on another drive of Windows
        return path


# --- when the file is saved


def _stored_below(path: str, start: str) -> str:
    """A job's folder: relative only below the .blend file. Others, such as those in the extension's folder,
    do not move with it."""
    return stored(path, start) if Path(path).is_relative_to(start) else path


def _paths() -> Iterator[Place]:
    """The paths that are stored in the file, as they are stored."""
    for obj in (obj for obj in bpy.data.objects if not obj.library):
        yield partial(obj.__setitem__, splat_object.DATASET), _text(obj.get(splat_object.DATASET)), stored
        yield partial(obj.__setitem__, FOLDER), folder_of(obj), _stored_below
        yield partial(obj.__setitem__, splat_object.MASKS), _text(obj.get(splat_object.MASKS)), _stored_below
    for scene in (scene for scene in bpy.data.scenes if not scene.library):
        settings = scene.svrgs_prune
        yield partial(setattr, settings, "data"), settings.data, stored
        yield partial(setattr, settings, "masks"), settings.masks, stored
        folder = settings.folder if settings.folder.startswith("//") else ""
        yield partial(setattr, settings, "folder"), folder, stored


def _before_save(path: str = "", *_):
    """Stores all paths relative to the file that is written, which may be another one than before. In a file
    without a name, '//' means nothing yet: such paths are left as they are."""
    _saved[:] = [
        (write, absolute(stored_path), keep)
        for write, stored_path, keep in _paths()
        if stored_path and (bpy.data.filepath or not stored_path.startswith("//"))
    ]
    for write, folder, keep in _saved if path else ():
        write(keep(folder, os.path.dirname(os.path.abspath(path))))


def _after_save(*_):
    """After a copy was saved, or nothing: stores all paths relative to the file that is open."""
    start = os.path.dirname(bpy.data.filepath)
    for write, folder, keep in _saved:
        write(keep(folder, start) if start else folder)
    _saved.clear()


# --- when objects are appended from another file


def _after_import(context, *_):
    """Makes absolute what was relative to the other file; the next save makes it relative to the open one."""
    for item in context.import_items:
        block, library = item.id, item.source_library
        if block is None or block.library or library is None or item.append_action not in APPENDED:
            continue
        if isinstance(block, bpy.types.Object):
            for key in (splat_object.DATASET, splat_object.MASKS, FOLDER):
                if _text(block.get(key)).startswith("//"):
                    block[key] = absolute(block[key], library)
        elif isinstance(block, bpy.types.Scene):
            for key in ("data", "masks", "folder"):
                if getattr(block.svrgs_prune, key).startswith("//"):
                    setattr(block.svrgs_prune, key, absolute(getattr(block.svrgs_prune, key), library))


# --- a dataset that was moved


class SVRGS_OT_find_dataset(FolderOperator):
    bl_label = "Find Dataset"
    bl_description = (
        "Choose the folder in which the dataset of these cameras is now. Their photographs are found again by"
        " their file names"
    )

    directory: StringProperty(
        name="Dataset",
        subtype="DIR_PATH",
        description="Folder of the dataset. It holds the photographs and their poses",
        options=RELATIVE,
    )

    @classmethod
    def problem(cls, context) -> str:
        root = splat_object.root_of(context.object)
        if root is not None and dataset_of_root(root):
            return ""
        return tr("Select a splat or a camera of the dataset first")

    def work(self, context) -> str:
        root, folder = splat_object.root_of(context.object), absolute(self.directory)
        assert root is not None  # see problem()
        find_cameras(Path(folder))
        shown, found = find_photographs(root, folder)
        settings, before = context.scene.svrgs_prune, dataset_of_root(root)
        root[splat_object.DATASET] = stored(folder)
        if settings.data and not os.path.exists(absolute(settings.data)):
            settings.data = stored(folder)
        if masks := _moved(absolute(settings.masks), before, folder):
            settings.masks = stored(masks)
        if masks := _moved(masks_of_job(root), before, folder):
            root[splat_object.MASKS] = masks
        text = tr("Found {found:,} of {count:,} photographs in {folder}")
        text = text.format(found=found, count=shown, folder=folder)
        self.report({"INFO"} if found == shown else {"WARNING"}, text)
        return ""


def find_photographs(root: bpy.types.Object, folder: str) -> tuple[int, int]:
    """Gives the cameras below the root the photographs in another folder of the dataset, by their file names.

    Returns the number of photographs and how many were found. Raises SplatError if there are some and none
    was found.
    """
    images = {}  # by image: its new file
    for camera in (obj for obj in root.children_recursive if obj.type == "CAMERA"):
        for image in camera_object.backgrounds(camera):
            if image.packed_file is None:
                images[image] = _file_of(image, camera, root, folder)
    found = {image: file for image, file in images.items() if file}
    if images and not found:
        text = tr(
            "{folder}: holds none of the {count:,} photographs of '{name}'; choose the folder with its"
            " photographs and their poses"
        )
        raise SplatError(text.format(folder=folder, count=len(images), name=root.name))
    for image, file in found.items():
        image.filepath = stored(file)
    return len(images), len(found)


def _file_of(image: bpy.types.Image, camera: bpy.types.Object, root: bpy.types.Object, folder: str) -> str:
    """The file of the image in the folder of the dataset: the first that exists of several; all have the name
    that it had. '': none."""
    old, name = absolute(image.filepath), camera.data.get(camera_object.IMAGE, "")
    parent, file_name = os.path.split(old)
    tries = [
        _beside(old, dataset_of_root(root)),
        f"{root.get(splat_object.IMAGES) or 'images'}/{name}",
        f"{UNDISTORTED}/{name}.png",
        os.path.join(os.path.basename(parent), file_name),
        file_name,
    ]
    wanted = (path for path in tries if path and os.path.basename(path) == file_name)
    files = (os.path.normpath(os.path.join(folder, path)) for path in wanted)
    return next((file for file in files if os.path.isfile(file)), "")


def _beside(file: str, dataset: str) -> str:
    """The place of the file seen from the dataset; '' on another drive."""
    try:
        return os.path.relpath(file, dataset)
    except ValueError:
        return ""


def _moved(masks: str, before: str, folder: str) -> str:
    """Where a folder of masks that was inside the dataset is in its new folder; '' if it is still where it
    was, or is not there either."""
    if not masks or os.path.exists(masks) or not Path(masks).is_relative_to(before):
        return ""
    found = os.path.normpath(os.path.join(folder, _beside(masks, before)))
    return found if os.path.isdir(found) else ""


HANDLERS: dict[str, Callable] = {
    "save_pre": _before_save,
    "save_post": _after_save,
    "save_post_fail": _after_save,
}
if hasattr(bpy.app.handlers, "blend_import_post"):  # from 5.0 on
    HANDLERS["blend_import_post"] = _after_import


def unregister():
    _saved.clear()

"""Saves the pixels of the extension's images with the .blend file. Blender saves those of generated images
only if they are packed."""

from __future__ import annotations

from bpy.app.handlers import persistent

from ..data import image_pixels


@persistent
def _before_save(*_):
    image_pixels.pack_written()


@persistent
def _after_load(*_):
    image_pixels.forget_written()


HANDLERS = {"save_pre": _before_save, "load_post": _after_load}

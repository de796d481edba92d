"""The picture of a job's metrics that the panel shows. It is no part of the file."""

from __future__ import annotations

import bpy
import bpy.utils.previews

from ..svrgs_addon.background import plot
from ..svrgs_addon.background.folder import JobFolder

_pictures: list = []  # the collection, while the extension is enabled
_drawn: dict[str, tuple] = {}  # by folder: what was drawn last


def redraw(folder: JobFolder):
    """Draws the metrics anew where they have grown."""
    metrics, total = folder.metrics(), folder.state().get("total", 0)
    key, what = str(folder.path), (len(metrics["iteration"]), total)
    if not what[0] or _drawn.get(key) == what:
        return
    preview = _pictures[0][key] if key in _pictures[0] else _pictures[0].new(key)
    preview.image_size = (plot.SIDE, plot.SIDE)
    preview.image_pixels_float.foreach_set(plot.draw(metrics, total).reshape(-1))
    _drawn[key] = what


def icon(folder: JobFolder) -> int:
    """Icon id of the picture; 0: there is none yet."""
    key = str(folder.path)
    return _pictures[0][key].icon_id if _pictures and key in _pictures[0] else 0


def register():
    _pictures.append(bpy.utils.previews.new())


def unregister():
    bpy.utils.previews.remove(_pictures.pop())
    _drawn.clear()

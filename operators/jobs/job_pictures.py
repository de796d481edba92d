"""Icons for the panel of a running job: a plot of its metrics, and its newest preview image. They are not
saved with the file."""

from __future__ import annotations

import bpy
import bpy.utils.previews

from ...svrgs_addon.jobs import job_plot
from ...svrgs_addon.jobs.job_folder import JobFolder

_pictures: list = []  # one preview collection, while the extension is enabled
# by folder, as a job may outlive its splat:
_drawn: dict[str, tuple] = {}  # (number of points, total) of the last plot
_shown: dict[str, str] = {}  # file of the newest preview image, its key in the collection


def redraw(folder: JobFolder):
    """Updates the plot if there are new metrics, and loads a new preview image."""
    metrics, total = folder.metrics(), folder.state().get("total", 0)
    key, plotted = str(folder.path), (len(metrics["iteration"]), total)
    if plotted[0] and _drawn.get(key) != plotted:
        preview = _pictures[0][key] if key in _pictures[0] else _pictures[0].new(key)
        preview.image_size = (job_plot.SIDE, job_plot.SIDE)
        preview.image_pixels_float.foreach_set(job_plot.draw(metrics, total).reshape(-1))
        _drawn[key] = plotted
    newest = folder.newest_preview()
    if newest is not None and _shown.get(key) != str(newest):
        if key in _shown:
            del _pictures[0][_shown[key]]
        _shown[key] = str(newest)
        preview = _pictures[0].load(str(newest), str(newest), "IMAGE", force_reload=True)
        # reads the file now; else Blender would show a waiting symbol first
        _ = preview.image_size[:], preview.icon_size[:]


def icons(folder: JobFolder) -> list[int]:
    """Icon ids of the plot and of the newest preview image; [] as long as there is no plot, and without a
    window."""
    plot, known = str(folder.path), _pictures[0] if _pictures else {}
    keys = (plot, _shown.get(plot, "")) if plot in known else ()
    return [icon for key in keys if key in known and (icon := known[key].icon_id)]


def register():
    _pictures.append(bpy.utils.previews.new())


def unregister():
    bpy.utils.previews.remove(_pictures.pop())
    _drawn.clear()
    _shown.clear()

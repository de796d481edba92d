"""The page of `svrgs view`: viser's, with pictures of the native renderer behind its cameras and controls.

viser serves the page and says where each browser looks. A thread for each draws that view, coarse at first
where an exact picture takes long, and sends it as the background. viser calls what is registered here from
many threads at once: one lock keeps them apart. The server listens on this machine alone.
"""

from __future__ import annotations

import contextlib
import io
import math
import threading
import time
from functools import partial
from typing import Any

import numpy as np

from ..native.rasterizer import Rasterizer
from ..render.color_maps import colored
from ..render.live_view import LiveView
from ..render.metrics.evaluate import evaluate
from ..render.painting import TOP_PERCENTILE, recolored
from ..scene.camera import Camera, evenly
from ..scene.gaussians import Scene
from ..scene.rotations import quats_from_matrices, rotation_matrices
from ..system import packages
from ..system.errors import Cancelled, SplatError
from .shown import COLORS, DIFFERENCE, MASK, Shown, drawn
from .source import Source, fov_of

HOST = "127.0.0.1"
FAST = 0.02  # seconds of an exact picture, up to which no coarse one is drawn before it
QUALITY = {True: 95, False: 70}  # of a JPEG: of an exact picture, and of a coarse one
LARGEST = 2048  # pixels of the longer side of a picture
MOST_FRUSTA, THUMBNAIL = 100, 96  # cameras that are drawn; pixels of the longer side of their photographs
FRUSTUM = 0.06  # length of a frustum, of the distance between cameras and the median Gaussian
FRUSTA = "/cameras"  # their node


class Viewer:
    """The server and its controls; close() ends it. Raises SceneError if viser is missing."""

    def __init__(self, source: Source, port: int):
        viser = packages.load("viser", "svrgs view")
        self.source, self.shown = source, Shown(source.scenes, background=source.background)
        with contextlib.redirect_stdout(io.StringIO()):  # viser prints its addresses
            self.server = viser.ViserServer(host=HOST, port=port, label="SVR-GS", verbose=False)
        self.server.request_share_url = lambda *_: None  # a page may ask for it, and it would be public
        self._lock = threading.RLock()
        self._views: dict[int, LiveView] = {}  # by the number of a client, as the next two
        self._seconds: dict[int, float] = {}  # of its last exact picture
        self._problems: dict[int, str] = {}  # what it was told last
        self._changes = 0  # of what is shown
        self._measuring, self._measured = threading.Lock(), (-1, -1)  # camera and Gaussians of the figures
        self._has_frusta = False
        self._look_from_a_camera()
        self._add_controls()
        self.server.on_client_connect(self._connected)
        self.server.on_client_disconnect(self._disconnected)

    @property
    def url(self) -> str:
        return f"http://{HOST}:{self.server.get_port()}"

    def close(self):
        self.server.stop()
        for view in [*self._views.values()]:
            view.close()

    def quality(self, index: int) -> list[str]:
        """A sentence on each scene, as far as it is shown: how it differs from a photograph. Raises
        SceneError, FormatError."""
        assert self.source.dataset is not None
        lines = []
        for name, scene in zip(self.source.names, self._kept(), strict=True):
            found = evaluate(scene, self.source.dataset, [index], Rasterizer())
            figures = f"PSNR {found['psnr']:.2f} dB, SSIM {found['ssim']:.3f}, FLIP {found['flip']:.3f}"
            lines.append(f"{name}: {figures}")
        return lines

    def _look_from_a_camera(self):
        """Where a browser looks from at first, and which way is up."""
        view, start = self.source.start(), self.server.initial_camera
        self.server.scene.set_up_direction(tuple(self.source.up()))
        start.fov, start.position, start.look_at = view.fov, tuple(view.position), tuple(view.target)

    def _add_controls(self):
        gui, source = self.server.gui, self.source
        gui.configure_theme(dark_mode=True, show_share_button=False, control_layout="collapsible")
        named = zip(source.names, source.scenes, strict=True)
        gui.add_markdown("  \n".join(f"{name}: {scene.count:,} Gaussians" for name, scene in named))
        pair = len(source.scenes) == 2
        choices = [COLORS, MASK, *([DIFFERENCE] if pair else []), *source.columns()]
        self._colors = gui.add_dropdown("Show", choices)
        self._share = gui.add_slider("Wipe", 0.0, 1.0, 0.005, 0.5, visible=pair)
        count = source.scenes[-1].count
        self._count = gui.add_slider("Gaussians", 1, count, 1, count, visible=source.nested)
        for control in (self._colors, self._share, self._count):
            control.on_update(lambda _: self._change())
        cameras = len(source.cameras)
        self._view = gui.add_slider("Camera", 0, max(1, cameras - 1), 1, 0, visible=cameras > 1)
        self._view.on_update(self._visit)
        self._frusta_shown = gui.add_checkbox("Show Cameras", False, visible=cameras > 0)
        self._frusta_shown.on_update(lambda _: self._show_frusta())
        self._figures = gui.add_markdown("", visible=source.dataset is not None)

    def _kept(self) -> tuple[Scene, ...]:
        """The scenes, the last one with as many Gaussians as are asked for."""
        *others, last = self.source.scenes
        return (*others, last.select(slice(self._count.value)))

    def _change(self):
        """A control was changed: every browser gets another picture."""
        with self._lock:
            colors = self._colors.value
            if column := self.source.columns().get(colors):
                scenes, colors = self._painted(column), COLORS
            else:
                scenes = self._kept()
            self.shown = Shown(scenes, colors, self._share.value, self.source.background)
            self._changes += 1
            for client in self.server.get_clients().values():
                self._request(client)
        self._measure()

    def _painted(self, column: str) -> tuple[Scene, ...]:
        """What is kept of the scenes, in the colours of a column, the same for both."""
        values = [scene.attributes[column] for scene in self.source.scenes]
        top = float(np.percentile(np.concatenate(values), TOP_PERCENTILE))
        return tuple(recolored(scene, colored(scene.attributes[column], top)) for scene in self._kept())

    def _connected(self, client: Any):
        with self._lock:
            self._views[client.client_id] = LiveView(partial(self._draw, client))
            if client.client_id not in self.server.get_clients():  # it has gone already
                return self._disconnected(client)
            client.camera.on_update(lambda _: self._request(client))
            self._request(client)
        self._measure()

    def _disconnected(self, client: Any):
        with self._lock:
            view = self._views.pop(client.client_id, None)
        if view:
            view.close()

    def _request(self, client: Any):
        """Asks for the picture of what a browser looks at now."""
        with self._lock:
            view = self._views.get(client.client_id)
            if view is not None and client.camera.image_height:
                camera = camera_of(client.camera, self.source.unit)
                view.request((camera.key, self._changes), (camera, self.shown))

    def _draw(self, client: Any, rasterizer: Rasterizer, job: tuple[Camera, Shown], reduction: int):
        """Draws a picture and sends it. Raises Cancelled, and what drawing raises: the browser is told."""
        camera, shown = job
        exact, started = reduction == 1, time.perf_counter()
        if not exact and self._seconds.get(client.client_id, math.inf) <= FAST:
            return
        if not exact:
            camera = camera.fitted(max(camera.width, camera.height) // reduction)
        try:
            picture = drawn(rasterizer, shown, camera)
            if exact:
                self._seconds[client.client_id] = time.perf_counter() - started
            client.scene.set_background_image(picture, format="jpeg", jpeg_quality=QUALITY[exact])
        except Cancelled:
            raise
        except Exception as error:  # such as too many Gaussians in a view
            if self._problems.get(client.client_id) != str(error):
                self._problems[client.client_id] = str(error)
                client.add_notification("The picture cannot be drawn", str(error), color="red")
            raise

    def _show_frusta(self):
        """Shows or hides the cameras, with their photographs; the first time reads these."""
        shown = self._frusta_shown.value
        self.server.scene.add_frame(FRUSTA, show_axes=False, visible=shown)
        with self._lock:
            if not shown or self._has_frusta:
                return
            self._has_frusta = True
        source, middle = self.source, self.source.middle()
        away = np.median([np.linalg.norm(camera.position - middle) for camera in source.cameras])
        for index in evenly(range(len(source.cameras)), MOST_FRUSTA):
            camera = source.cameras[index]
            frustum = self.server.scene.add_camera_frustum(
                f"{FRUSTA}/{index}",
                fov=fov_of(camera),
                aspect=camera.width / camera.height,
                scale=FRUSTUM * float(away),
                color=(255, 140, 40),
                image=self._thumbnail(index),
                wxyz=quats_from_matrices(camera.viewmat[None, :3, :3].swapaxes(1, 2))[0],
                position=tuple(camera.position),
            )
            frustum.on_click(partial(self._clicked, index))

    def _thumbnail(self, index: int) -> np.ndarray | None:
        """The photograph of a camera, small; None where it cannot be read."""
        if self.source.dataset is None:
            return None
        try:
            photo = self.source.dataset.image(index)
        except SplatError:
            return None
        step = max(1, max(photo.shape[:2]) // THUMBNAIL)
        return np.ascontiguousarray(photo[::step, ::step])

    def _clicked(self, index: int, event: Any):
        """A frustum was clicked. All are hidden then: its photograph would hide the picture."""
        self._view.value, self._frusta_shown.value = index, False
        self._visit(event)

    def _visit(self, event: Any):
        """Lets a browser look through the camera that is chosen."""
        if event.client is None:  # the server has set the control
            return
        with self._lock, event.client.atomic():
            view, looking = self.source.view_of(self.source.cameras[self._view.value]), event.client.camera
            looking.fov, looking.up_direction = view.fov, tuple(view.up)
            looking.position, looking.look_at = tuple(view.position), tuple(view.target)
        self._measure()

    def _measure(self):
        """Shows how the scenes differ from the photograph of the chosen camera. One thread at a time does it,
        until its figures are those of the controls; the others need not wait."""
        wanted = lambda: (self._view.value, self._count.value)
        while self.source.dataset and wanted() != self._measured and self._measuring.acquire(blocking=False):
            try:
                index, _ = measured = wanted()
                try:
                    lines = self.quality(index)
                except SplatError as error:
                    lines = [str(error)]
                self._figures.content = "  \n".join([f"**{self.source.cameras[index].name}**", *lines])
                self._measured = measured
            finally:
                self._measuring.release()


def camera_of(looking: Any, unit: float) -> Camera:
    """The view of a browser, given as viser's camera, at most LARGEST pixels wide and high. unit:
    Camera.unit."""
    width, height = looking.image_width, looking.image_height
    focal = height / 2 / math.tan(looking.fov / 2)
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation_matrices(np.array([looking.wxyz]))[0].T
    viewmat[:3, 3] = -viewmat[:3, :3] @ looking.position
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(viewmat, K, width, height, unit=unit).fitted(LARGEST)

"""`svrgs view --export`: the folder, and its page in a real browser."""

from __future__ import annotations

import functools
import http.server
import json
import math
import re
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import browser
from scenes import random_scene
from svrgs_addon.files.ply import write_ply
from svrgs_addon.files.registry import load_scene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.metrics.evaluate import evaluate, picture_options
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.system.errors import SceneError
from svrgs_addon.viewer import web_page
from svrgs_addon.viewer.source import Source, View

ORIGINAL = load_scene(Path(web_page.__file__).parents[1] / "sample.spz")
PRUNED = ORIGINAL.select(np.flatnonzero(ORIGINAL.opacity_logits > 0))
HAS_MODULES = all(web_page.packed_module(name).exists() for name in web_page.MODULES)
needs_modules = pytest.mark.skipif(not HAS_MODULES, reason="needs the modules of web pages: make wheels")


def page_of(folder: Path) -> dict:
    """What the page is told."""
    text = (folder / "index.html").read_text(encoding="utf-8")
    return json.loads(
        re.search(r'<script type="application/json" id="page">(.*?)</script>', text, re.DOTALL)[1]
    )


@needs_modules
def test_the_folder_holds_all_that_the_page_asks_for(tmp_path, svrgs):
    write_ply(tmp_path / "a.ply", ORIGINAL)
    write_ply(tmp_path / "b.ply", PRUNED)
    folder = tmp_path / "new" / "page"
    said = svrgs("view", tmp_path / "a.ply", tmp_path / "b.ply", "--export", folder).out
    assert f"{folder} holds original.spz" in said and "pruned.spz" in said and "http.server" in said
    page = page_of(folder)
    assert [one["count"] for one in page["scenes"]] == [ORIGINAL.count, PRUNED.count]
    for name in [*(f"modules/{name}.bin" for name in page["modules"]), "page.js", "LICENSES.txt"]:
        assert (folder / name).stat().st_size > 100
    for one, scene in zip(page["scenes"], (ORIGINAL, PRUNED), strict=True):
        assert (folder / one["file"]).stat().st_size == one["bytes"]
        assert load_scene(folder / one["file"]).count == scene.count


@needs_modules
def test_facts_are_told_as_json_and_a_page_can_be_written_again(tmp_path, svrgs):
    write_ply(tmp_path / "a.ply", PRUNED)
    for _ in range(2):
        told = json.loads(svrgs("view", tmp_path / "a.ply", "--export", tmp_path / "p", "--json").out)
    assert told["scenes"][0]["file"] == "scene.spz" and 1e6 < told["program_bytes"] < 3e6
    assert sorted(path.name for path in (tmp_path / "p").iterdir()) == [
        "LICENSES.txt", "index.html", "modules", "page.js", "scene.spz"
    ]  # fmt: skip


@needs_modules
def test_names_cannot_end_the_text_that_holds_them(tmp_path):
    name = "</script><b>&$page.ply"
    web_page.export(Source((name,), (PRUNED,), []), tmp_path)
    assert page_of(tmp_path)["scenes"][0]["name"] == name
    assert "<b>" not in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_what_cannot_be_written_is_one_sentence(tmp_path, monkeypatch):
    source = Source(("a",), (PRUNED,), [])
    if HAS_MODULES:
        (tmp_path / "index.html").write_text("<html>mine</html>")
        with pytest.raises(SceneError, match="holds another page"):
            web_page.export(source, tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == ["index.html"]
    monkeypatch.setattr(web_page, "WEB", tmp_path)
    with pytest.raises(SceneError, match="make wheels fetches them"):
        web_page.export(source, tmp_path / "new")
    assert not (tmp_path / "new").exists()


@needs_modules
def test_a_nested_result_needs_the_page_that_is_served(tmp_path, svrgs):
    write_ply(tmp_path / "a.ply", PRUNED)
    said = svrgs("view", tmp_path / "a.ply", "--nested", "--export", tmp_path / "p")
    assert said.status == 2 and "leave --nested out" in said.err and not (tmp_path / "p").exists()


@needs_modules
@pytest.mark.slow
def test_figures_are_those_of_what_the_file_holds(data, tmp_path):
    facts = web_page.export(Source(("a",), (PRUNED,), data.cameras, data), tmp_path)[0]
    held = load_scene(tmp_path / "scene.spz")
    found = evaluate(held, data, data.test_indices, Rasterizer())
    assert facts["psnr"] == found["psnr"] and facts["flip"] == found["flip"]
    assert f"{facts['psnr']:.2f} dB" in page_of(tmp_path)["scenes"][0]["text"]


@needs_modules
def test_files_are_rounded_by_training_views_alone(data, tmp_path, monkeypatch):
    """Figures are those of the test views, which must decide nothing."""
    given = []
    monkeypatch.setattr(web_page, "seen_from", lambda scene, cameras, out: given.append(cameras))
    web_page.export(Source(("a",), (PRUNED,), data.cameras, data), tmp_path)
    assert data.test_indices and given == [[data.cameras[i] for i in data.train_indices]]


@needs_modules
def test_files_of_an_older_page_do_not_stay(tmp_path):
    web_page.export(Source(("a", "b"), (ORIGINAL, PRUNED), []), tmp_path)
    web_page.export(Source(("b",), (PRUNED,), []), tmp_path)
    assert [path.name for path in tmp_path.glob("*.spz")] == ["scene.spz"]


@needs_modules
def test_what_an_spz_cannot_hold_is_said(tmp_path, svrgs, caplog):
    far = replace(PRUNED, means=np.concatenate([PRUNED.means[:-1], np.float32([[3e6, 0, 0]])]))
    write_ply(tmp_path / "a.ply", far)
    told = svrgs("view", tmp_path / "a.ply", "--export", tmp_path / "p", "--json").json["scenes"][0]
    assert "remove those far away first" in caplog.text and told["limits"][0] in caplog.text


def camera_of(view: View, width: int, height: int) -> Camera:
    """The camera of a view of the page."""
    ahead = (view.target - view.position) / np.linalg.norm(view.target - view.position)
    right = np.cross(ahead, view.up)
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = right, np.cross(ahead, right), ahead
    viewmat[:3, 3] = -viewmat[:3, :3] @ view.position
    focal = height / 2 / math.tan(view.fov / 2)
    return Camera(
        viewmat, np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]), width, height
    )


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture
def opened(tmp_path):
    """Opens the page of a source, from a file server."""
    with http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Quiet, directory=str(tmp_path))
    ) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()

        def opened(source: Source) -> browser.Browser:
            web_page.export(source, tmp_path)
            return browser.Browser(f"http://127.0.0.1:{server.server_port}/")

        yield opened
        server.shutdown()


def picture(page: browser.Browser) -> np.ndarray:
    """What the page shows without its controls, (H, W, 3) float64 0..1."""
    page.run(
        "for (const one of document.querySelectorAll('#texts, #controls, #edge')) one.style.display = 'none'"
    )
    return page.picture() / 255


def psnr(image: np.ndarray, scene: Scene, view: View, background=(0.0, 0.0, 0.0)) -> float:
    """Between a picture of the page and the native renderer's, both without what lies above the page."""
    height, width = image.shape[:2]
    drawn = Rasterizer().forward(scene, camera_of(view, width, height), picture_options(scene, background))
    return -10 * math.log10(((np.clip(drawn["rgb"], 0, 1) - image) ** 2).mean())


def wait_for(page: browser.Browser, scene: Scene, view: View, background=(0.0, 0.0, 0.0)):
    """Waits until the page shows what the native renderer draws: it sorts beside its pictures. Raises
    TimeoutError."""
    page.until(lambda: psnr(picture(page), scene, view, background) > 35)


@needs_modules
@pytest.mark.slow
@pytest.mark.skipif(browser.PROGRAM is None, reason="needs Chromium")
def test_a_browser_shows_both_scenes_and_asks_nobody_else(opened, tmp_path):
    start = Source(("",), (ORIGINAL,), []).start()
    places = (start.position, start.target + 0.6 * (start.position - start.target)[[2, 1, 0]])
    views = [View(0.8, place, start.target, start.up) for place in places]
    cameras = [replace(camera_of(view, 300, 200), name=f"{k}.jpg") for k, view in enumerate(views)]
    source = Source(("a.ply", "b.ply"), (ORIGINAL, PRUNED), cameras, background=(0.2, 0.5, 0.9))
    with opened(source) as page:
        page.until(lambda: page.run("svrgs.seconds"))
        held = [load_scene(tmp_path / f"{name}.spz") for name in ("original", "pruned")]
        wait_for(page, held[1], source.start(), source.background)
        page.run("document.getElementById('compare').click()")
        page.until(lambda: page.run("document.getElementById('compare').hidden"))
        page.run(
            "const w = document.getElementById('wipe'); w.value = 1; w.dispatchEvent(new Event('input'))"
        )
        wait_for(page, held[0], source.start(), source.background)
        page.run(
            "const c = document.getElementById('cameras'); c.selectedIndex = 1;"
            " c.dispatchEvent(new Event('change'))"
        )
        wait_for(page, held[0], source.view_of(cameras[1]), source.background)
        origin = page.run("location.origin")
        foreign = [url for url in page.requests if not url.startswith((origin, "data:", f"blob:{origin}"))]
        assert len(page.requests) > 5 and not foreign


@needs_modules
@pytest.mark.slow
@pytest.mark.skipif(browser.PROGRAM is None, reason="needs Chromium")
@pytest.mark.parametrize("antialiased", [False, True])
def test_a_browser_shows_harmonics_and_small_gaussians_as_the_native_renderer_does(
    opened, tmp_path, antialiased
):
    scene = random_scene(3_000, 3, scale=0.01, antialiased=antialiased)
    source = Source(("a.ply",), (scene,), [])
    with opened(source) as page:
        page.until(lambda: page.run("svrgs.seconds"))
        held, start = load_scene(tmp_path / "scene.spz"), source.start()
        wait_for(page, held, start)
        shown = picture(page)
        as_stored = psnr(shown, held, start)
        assert psnr(shown, replace(held, antialiased=not antialiased), start) < as_stored - 3
        assert psnr(shown, replace(held, sh=held.sh[:, :1].copy()), start) < as_stored - 3


@needs_modules
@pytest.mark.slow
@pytest.mark.skipif(browser.PROGRAM is None, reason="needs Chromium")
def test_a_drag_turns_about_the_middle_and_the_wheel_zooms(opened, tmp_path):
    source = Source(("a.ply",), (PRUNED,), [])
    with opened(source) as page:
        page.until(lambda: page.run("svrgs.seconds"))
        held, start = load_scene(tmp_path / "scene.spz"), source.start()
        mouse = functools.partial(page.call, "Input.dispatchMouseEvent", button="left", clickCount=1)
        for kind, x, y in (("mousePressed", 300, 200), ("mouseMoved", 380, 230), ("mouseReleased", 380, 230)):
            mouse(type=kind, x=x, y=y, buttons=1)
        angle = math.pi / page.run("innerHeight")  # of a pixel
        offset, up = start.position - start.target, start.up
        offset = turned(offset, up, -80 * angle)
        right = np.cross(-offset, up) / np.linalg.norm(np.cross(offset, up))
        offset, up = (turned(vector, right, 30 * angle) for vector in (offset, up))
        wait_for(page, held, replace(start, position=start.target + offset, up=up))
        mouse(type="mouseWheel", x=300, y=200, deltaX=0, deltaY=-400)
        wait_for(page, held, replace(start, position=start.target + math.exp(-0.4) * offset, up=up))


def turned(vector: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """A vector turned about an axis, a unit vector (Rodrigues)."""
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * vector + sin * np.cross(axis, vector) + (1 - cos) * (axis @ vector) * axis

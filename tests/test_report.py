"""The report page as a browser and a reader meet it: parsed, its pictures decoded, its numbers looked up."""

import base64
import sys
import tempfile
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from plans import prune_settings
from svrgs_addon.finetune.run import Curves
from svrgs_addon.prune.report import prune_report
from svrgs_addon.prune.report.line_chart import Series, line_chart
from svrgs_addon.prune.report.page import Phase, Report, View, page, write_report
from svrgs_addon.prune.report.pictures import data_uri, difference_image, mask_to_rgb, png_bytes
from svrgs_addon.prune.report.svg_axes import nice_ticks, short_number
from svrgs_addon.prune.report.swing import cameras as swing_cameras
from svrgs_addon.prune.report.swing import swing
from svrgs_addon.system.errors import SceneError
from svrgs_bench.scenes import orbit_camera, room

BEFORE = dict(
    psnr=27.41, ssim=0.8912, lpips=None, flip=0.1022, count=1234567, bytes=291_234_567, ms_per_frame=41.2
)
AFTER = dict(
    psnr=27.38, ssim=0.8921, lpips=None, flip=0.1031, count=312345, bytes=73_623_423, ms_per_frame=16.9
)


class Page(HTMLParser):
    """What the tests ask of a page: its text, tags, attributes, and table rows."""

    def __init__(self, text: str):
        super().__init__()
        self.raw, self.text, self.tags, self.rows, self.open = text, "", [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data
            if self.open[-1] in ("td", "th"):
                self.rows[-1][-1] += data.replace("\N{NARROW NO-BREAK SPACE}", " ")

    def attributes(self, tag) -> list[dict]:
        return [attrs for name, attrs in self.tags if name == tag]

    def row(self, label) -> list[str]:
        return next(row[1:] for row in self.rows if row[0] == label)


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((24, 32, 3), np.float32)


def full_report(**changes) -> Report:
    mask = np.linspace(0, 9, 24 * 32, dtype=np.float32).reshape(24, 32)
    steps = np.arange(0, 2000, 100)
    fields = {
        "scene": "garden",
        "before": BEFORE,
        "after": AFTER,
        "method": "svr",
        "lambda_f": 1e-4,
        "lpips_missing": "no LPIPS weights: give --lpips-weights",
        "phases": (Phase("loading", 3.2), Phase("pruning", 812.0, 0), Phase("recovery", 423.0, 1400)),
        "iterations_per_second": 1.62,
        "peak_memory_bytes": 3_412_000_000,
        "seed": 7,
        "versions": {"svrgs": "0.1.0", "NumPy": "1.26.4"},
        "curves": (
            Series("Gaussians", steps, 1e6 - 300.0 * steps, from_zero=True),
            Series("PSNR", steps, 27 + 0 * steps, "dB"),
        ),
        "views": (View("images/a.jpg", picture(0), picture(1), picture(2), mask, mask / 2, 27.5, 27.25),),
    }
    return Report(**fields | changes)


def written(folder, report: Report) -> Page:
    return Page(write_report(folder, report).read_text("utf-8"))


@pytest.fixture(scope="module")
def full(tmp_path_factory) -> Page:
    return written(tmp_path_factory.mktemp("report"), full_report())


def test_page_is_one_complete_file(tmp_path):
    path = write_report(tmp_path / "new" / "folder", full_report())
    assert path == tmp_path / "new" / "folder" / "index.html"
    assert [entry.name for entry in path.parent.iterdir()] == ["index.html"]
    assert Page(path.read_text("utf-8")).open == []


def test_folder_that_cannot_be_made_is_a_scene_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SceneError):
        write_report(tmp_path / "file", full_report())


def test_page_loads_nothing_from_outside(full):
    assert "://" not in full.raw
    assert not any(tag in ("link", "iframe", "object", "base") for tag, _ in full.tags)
    assert all(attrs["src"].startswith("data:image/") for attrs in full.attributes("img"))
    assert any("default-src 'none'" in attrs.get("content", "") for attrs in full.attributes("meta"))


@pytest.mark.parametrize(
    ("label", "values"),
    [
        ("PSNR", ["27.41 dB", "27.38 dB", "−0.03 dB"]),
        ("SSIM", ["0.8912", "0.8921", "+0.0009"]),
        ("LPIPS (VGG)", ["no LPIPS weights: give --lpips-weights"]),
        ("FLIP", ["0.1022", "0.1031", "+0.0009"]),
        ("Gaussians", ["1 234 567", "312 345", "−74.7 %"]),
        ("File size", ["291.2 MB", "73.6 MB", "−74.7 %"]),
        ("Time per frame", ["41.2 ms", "16.9 ms", "−59.0 %"]),
    ],
)
def test_table(full, label, values):
    assert full.row(label) == values


def test_changes_are_coloured_by_what_they_mean(full):
    verdicts = [attrs["class"] for attrs in full.attributes("td") if attrs.get("class") in ("good", "bad")]
    assert verdicts == ["bad", "good", "bad", "good", "good", "good"]


def test_facts_of_the_run(full):
    for text in ("svr", "0.0001", "13 min 32 s", "7 min 3 s", "1.62 iterations/s", "3.4 GB", "NumPy 1.26.4"):
        assert text in full.text


def test_curves_carry_phase_names(full):
    assert len(full.attributes("svg")) == 2
    assert all(
        "Gaussians" in attrs["aria-label"] or "PSNR" in attrs["aria-label"]
        for attrs in full.attributes("svg")
    )
    assert full.text.count("recovery") == 2


def test_pictures_of_a_view(full):
    oiio = pytest.importorskip("OpenImageIO")
    alts = [attrs["alt"] for attrs in full.attributes("img")]
    for part in (
        "photograph",
        "original",
        "pruned",
        "difference original – pruned, × 4",
        "spatial mask F, original: mean 4.5",
    ):
        assert any(alt == f"images/a.jpg: {part}" for alt in alts)
    assert len(alts) == 6 and "27.50 → 27.25 dB (−0.25)" in full.text
    for attrs in full.attributes("img"):
        assert decoded(oiio, attrs["src"]).shape == (24, 32, 3)


def decoded(oiio, uri: str) -> np.ndarray:
    """Pixels of a data URI, through a file: that is what this image library reads."""
    kind, data = uri.removeprefix("data:image/").split(";base64,")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"picture.{kind}"
        path.write_bytes(base64.b64decode(data, validate=True))
        return oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)


def test_masks_share_one_colour_range():
    low, high = np.full((4, 4), 1.0), np.full((4, 4), 10.0)
    views = tuple(
        View(name, picture(0), picture(1), mask_before=mask) for name, mask in (("a", low), ("b", high))
    )
    assert page(full_report(views=views)).count("≥ 10<") == 2


def test_names_cannot_break_out_of_the_page(tmp_path):
    evil = '"><script>alert(1)</script>'
    view = View(evil, picture(0), picture(1))
    report = full_report(
        scene=evil,
        method=evil,
        names=(evil, evil),
        versions={evil: evil},
        phases=(Phase(evil, 1, 0),),
        views=(view,),
    )
    parsed = written(tmp_path, report)
    assert len(parsed.attributes("script")) == 1
    assert parsed.text.count("alert(1)") > 5


def test_a_comparison_uses_its_own_names_and_leaves_out_the_run(tmp_path):
    parsed = written(tmp_path, Report("garden", BEFORE, AFTER, names=("a.ply", "b.ply")))
    assert parsed.rows[0] == ["Measure", "a.ply", "b.ply", "Change"]
    for absent in ("The run", "Over the iterations", "Views", "spatial mask"):
        assert absent not in parsed.text


def test_missing_and_infinite_figures(tmp_path):
    parsed = written(
        tmp_path,
        Report("garden", {"psnr": 30.0, "count": 0}, {"psnr": float("inf"), "count": 0, "flip": 0.1}),
    )
    assert parsed.row("PSNR") == ["30.00 dB", "∞", "–"]
    assert parsed.row("FLIP") == ["–", "0.1000", "–"]
    assert parsed.row("Gaussians") == ["0", "0", "–"]
    assert parsed.row("SSIM") == ["not measured"]


# --- pictures and plots ---


def test_mask_colours_brighten_with_the_mask():
    rgb = mask_to_rgb(np.linspace(0, 3, 64).reshape(1, 64))
    luminance = rgb[0] @ [0.2126, 0.7152, 0.0722]
    assert rgb.dtype == np.uint8 and rgb.shape == (1, 64, 3)
    assert (np.diff(luminance) > 0).all() and luminance[0] < 5 and luminance[-1] > 230


def test_mask_range_is_clipped_and_may_be_empty():
    mask = np.array([[0.0, 1.0, 2.0]])
    assert (mask_to_rgb(mask, vmax=1.0)[0, 1] == mask_to_rgb(mask, vmax=1.0)[0, 2]).all()
    assert (mask_to_rgb(np.zeros((2, 2))) == mask_to_rgb(mask)[0, 0]).all()


def test_difference_is_amplified_symmetric_and_clipped():
    a, b = np.full((1, 1, 3), 0.5, np.float32), np.float32([[[0.5, 0.6, 0.0]]])
    assert difference_image(a, b).tolist() == difference_image(b, a).tolist() == [[[0, 102, 255]]]


def test_png_holds_the_exact_pixels():
    oiio = pytest.importorskip("OpenImageIO")
    rgb = (picture(3) * 255).astype(np.uint8)
    uri = "data:image/png;base64," + base64.b64encode(png_bytes(rgb)).decode()
    assert (decoded(oiio, uri) == rgb).all()


def test_pictures_need_no_image_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenImageIO", None)
    assert data_uri((picture(3) * 255).astype(np.uint8)).startswith("data:image/png;base64,")


@pytest.mark.parametrize("values", [[], [np.nan, np.inf]], ids=["empty", "not finite"])
def test_curve_without_points_is_left_out(values):
    assert line_chart(Series("PSNR", np.arange(len(values)), np.array(values))) == ""


@pytest.mark.parametrize("values", [[5.0], [5.0, 5.0], [1e-9, 2e-9], [-3.0, 1e7]])
def test_curve_stays_inside_its_picture(values):
    chart = Page(line_chart(Series("PSNR", np.arange(len(values)), np.array(values)), ((0, "pruning"),)))
    _, _, width, height = map(float, chart.attributes("svg")[0]["viewbox"].split())
    points = np.array([p.split(",") for p in chart.attributes("polyline")[0]["points"].split()], float)
    assert len(points) == len(values)
    assert (points >= 0).all() and (points <= [width, height]).all()
    assert len(chart.attributes("line")) >= 4


def test_long_curve_is_thinned_but_keeps_its_course():
    chart = Page(line_chart(Series("loss", np.arange(30_000), np.linspace(1, 0, 30_000))))
    points = np.array([p.split(",") for p in chart.attributes("polyline")[0]["points"].split()], float)
    assert 100 < len(points) < 1000
    assert (np.diff(points, axis=0) > 0).all()


@pytest.mark.parametrize(("low", "high"), [(0, 17), (-3, 1e7), (1e-9, 2e-9), (0.94, 0.95)])
def test_ticks_are_round_and_within_the_axis(low, high):
    ticks = nice_ticks(low, high)
    assert 3 <= len(ticks) <= 8 and low <= ticks[0] and ticks[-1] <= high * (1 + 1e-9)
    steps = np.diff(ticks)
    np.testing.assert_allclose(steps, steps[0])
    assert f"{steps[0]:.0e}"[0] in "125"


def test_tick_texts_are_short():
    texts = {0: "0", 0.05: "0.05", 9_999: "9999", 1e4: "10 k", 2.5e6: "2.5 M", 1e10: "1e10", -2e-7: "-2e-7"}
    assert {value: short_number(value) for value in texts} == texts


def test_the_swing_turns_around_what_the_view_shows():
    camera = orbit_camera(90, 60)
    target = camera.position + 3.0 * camera.viewmat[2, :3]
    views = swing_cameras(camera, 3.0)
    angles = []
    for view in views:
        seen = view.viewmat[:3, :3] @ target + view.viewmat[:3, 3]
        np.testing.assert_allclose(seen, (0, 0, 3), atol=1e-9)  # in the middle, as far away as before
        np.testing.assert_allclose(view.viewmat[:3, :3] @ view.viewmat[:3, :3].T, np.eye(3), atol=1e-12)
        side = camera.viewmat[:3, :3] @ (view.position - target)
        assert abs(side[1]) < 1e-9  # at the height of the view
        angles.append(np.degrees(np.arctan2(side[0], -side[2])))
    assert len(views) == 16 and abs(abs(angles[0]) - 7) < 1e-6 and np.sign(angles[0]) == -np.sign(angles[-1])
    np.testing.assert_allclose(angles, -np.array(angles[::-1]), atol=1e-6)


def test_the_swing_shows_both_scenes_side_by_side_and_nothing_of_an_empty_view():
    scene, camera = room(2_000), orbit_camera(90, 60)
    pictures = swing((scene, scene), camera)
    assert pictures.shape == (16, 60, 180, 3) and pictures.dtype == np.uint8
    np.testing.assert_array_equal(pictures[:, :, :90], pictures[:, :, 90:])
    assert (pictures[0] != pictures[-1]).any() and pictures.any()
    faint = replace(scene, opacity_logits=np.full(scene.count, -20, np.float32))
    assert swing((faint, scene), camera) is None


def test_the_page_holds_the_swing_and_how_to_turn_the_scenes(tmp_path):
    frames = np.zeros((16, 6, 20, 3), np.uint8)
    found = written(tmp_path, replace(full_report(), swing=frames, files=("a b.ply", "c<d>.ply")))
    style = next(attrs["style"] for attrs in found.attributes("div") if attrs.get("class") == "swing")
    assert "aspect-ratio:20/6" in style and "1600% 100%" in style and "url(data:image/" in style
    assert "svrgs view 'a b.ply' 'c<d>.ply'" in found.text
    assert 'class="swing"' not in written(tmp_path, full_report()).raw


def test_phases_begin_where_the_ones_before_them_end():
    plan = prune_settings("removal", 30, 20)
    plan = replace(plan, phases=(*plan.phases, replace(plan.phases[-1], name="more")))
    seconds = {"read": 1.0, "prune": 2.0, "recover": 3.0, "more": 4.0}
    found = prune_report._phases(SimpleNamespace(plan=plan), seconds)
    assert [phase.start for phase in found] == [None, 0, 30, 50]


def test_a_quality_that_was_not_measured_has_no_curve():
    curves = Curves([1, 2], [9, 8], [0.2, 0.1], [None, None])
    names = lambda: [series.title for series in prune_report._series(SimpleNamespace(curves=curves))]
    assert names() == ["Gaussians", "Loss"]
    curves.psnr[1] = 30.0
    assert names() == ["Gaussians", "PSNR", "Loss"]

"""The extension in a real window, driven with mouse and keyboard by the scripts in tests/window.

SVRGS_BLENDER names the Blender (a command that takes Blender's arguments); without a screen an Xvfb is
started, if there is one. SVRGS_PICTURES names a folder to keep the pictures in.
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from blender.messages import catalogues
from svrgs_addon.cli.main import main as run_svrgs
from svrgs_addon.files.images import read_pixels
from test_extension import ROOT, extension_zip  # noqa: F401

WINDOW = Path(__file__).parent / "window"
SIZE = (1280, 1120)


@pytest.fixture(scope="module")
def blender() -> list[str]:
    named = os.environ.get("SVRGS_BLENDER")
    if not named:
        pytest.skip("SVRGS_BLENDER names no Blender with a window")
    return shlex.split(named)


@contextlib.contextmanager
def screen():
    """Environment with a screen: this one's, or a virtual one."""
    if os.environ.get("DISPLAY") or not shutil.which("Xvfb"):
        yield dict(os.environ)
        return
    read, write = os.pipe()
    with subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{SIZE[0]}x{SIZE[1]}x24", "-nolisten", "tcp"],
        pass_fds=[write],
    ) as server:
        os.close(write)
        with os.fdopen(read) as display:
            yield {**os.environ, "DISPLAY": ":" + display.readline().strip(), "LIBGL_ALWAYS_SOFTWARE": "1"}
        server.terminate()


@pytest.fixture
def drive(blender, extension_zip, tmp_path):  # noqa: F811
    """Runs a script of tests/window with the extension enabled; what it wrote to seen.json."""

    def run(script: str, data: Path) -> dict:
        out = Path(os.environ.get("SVRGS_PICTURES", tmp_path / "out"))
        out.mkdir(parents=True, exist_ok=True)
        with screen() as environment:
            environment["BLENDER_USER_RESOURCES"] = str(tmp_path / "user")
            install = [*blender, *"--command extension install-file -r user_default -e".split()]
            install.append(str(extension_zip(*blender, "-b", "--python-expr")))
            done = subprocess.run(install, env=environment, capture_output=True, text=True, timeout=120)
            assert "STATUS Installed" in done.stdout or "STATUS Reinstalled" in done.stdout, (
                done.stdout + done.stderr
            )
            window = ["--window-geometry", "0", "0", *map(str, SIZE)]
            script = ["--enable-event-simulate", "-P", str(WINDOW / script), "--", str(data), str(out)]
            command = [*blender, *window, *script]
            done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
        return json.loads((out / "seen.json").read_text())

    return run


def test_pruning_with_the_mouse(drive, tiny):
    seen = drive("prune.py", tiny.folder)
    assert seen["estimate"][0] == "About 100 of 250 would stay (40%)"
    assert seen["running"]["psnr"] > 20 and seen["running"]["total"] == 9000
    assert seen["stopped"]["state"] == "stopped" and seen["stopped"]["iteration"] > 1500
    assert seen["result"] == ["scene pruned", 100, 100]
    assert seen["fewer"] == seen["applied"] == 50
    assert seen["undone"] == [100, 50]
    assert seen["deleted"] == [False, False, False], "the original is free"
    assert seen["back"] == [True, True, 50]


def test_looking_with_the_mouse(drive, tiny, tmp_path):
    seen = drive("look.py", tiny.folder)
    assert seen["overlay"] == seen["rendered"] == [seen["region"]], "exact pictures, of the whole viewport"
    assert max(seen["apart"].values()) < 0.05 and seen["parallel"][0] > 0.02, seen
    assert seen["without_overlays"][0] > 0.02, "a splat stays where overlays are hidden"
    # two sides in Solid and in Rendered; the mouse moves the line
    assert seen["wipe"] == ["scene", "scene pruned", 2, 2] and abs(seen["moved"][0] - seen["moved"][1]) < 2
    assert seen["opened"] == ["SVR-GS Wipe"]
    assert seen["mask"]["camera"] == seen["compare"]["camera"] == seen["camera"]
    assert seen["mask"]["largest"] > seen["mask"]["mean"] > 0
    original, pruned = seen["compare"]["original"], seen["compare"]["pruned"]
    assert (original["count"], pruned["count"]) == (250, 100) and min(original["psnr"], pruned["psnr"]) > 15
    words = f"render {tiny.splat} --data {tiny.folder} --out {tmp_path}/renders --views".split()
    assert run_svrgs([*words, seen["camera"]]) == 0
    (expected,) = (tmp_path / "renders").iterdir()
    rendered, expected = (read_pixels(path).astype(int)[..., :3] for path in (Path(seen["f12"]), expected))
    assert rendered.shape == expected.shape and np.abs(rendered - expected).max() <= 1


def test_splats_as_objects_with_keys(drive, tiny):
    seen = drive("objects.py", tiny.folder)
    before, applied, joined = (
        read_pixels(Path(seen["out"]) / f"{name}.png").astype(int)[..., :3]
        for name in ("before", "applied", "joined")
    )
    assert before.std() > 10 and np.abs(before - applied).max() <= 1 and np.abs(before - joined).max() <= 1
    assert (seen["moved"], seen["joined"]) == (250, 500)
    assert "another capture" not in seen["own"] and seen["parted"]
    assert seen["reloaded"]["photo"] == [64, 48] and seen["reloaded"]["mask"] > 0
    assert "moved/dataset" in seen["reloaded"]["dataset"]
    assert seen["after_new"] == [True, True], "a job goes on after File > New, and is known"


def test_frame_times_are_printed(drive, tiny, capsys):
    """Of a Solid viewport that moves, and of the same one without splats; so that a slow-down shows."""
    seen = drive("frames.py", tiny.folder)
    with capsys.disabled():
        for count, times in seen.items():
            figures = ", ".join(
                f"{name} {1e3 * times[name]:.0f} ms" for name in ("first", "median", "largest", "without")
            )
            print(f"\n{int(count):,} Gaussians: {figures}; a pixel for {times['reductions']}")
    assert [int(count) for count in seen] == [196_000, 1_500_000]
    assert all(times["median"] > 0 and times["reductions"] for times in seen.values()), seen


def test_the_panels_speak_german_and_chinese(drive, tiny):
    seen = drive("languages.py", tiny.folder)
    assert seen["en_US"][:3] == ["Spatial Mask", "Estimate", "250 Gaussians, SH degree 1"]
    for locale, texts in catalogues(ROOT).items():
        about = texts["{count:,} Gaussians, SH degree {degree}"].format(count=250, degree=1)
        assert seen[locale][:3] == [texts["Spatial Mask"], texts["Estimate"], about]
        assert seen[locale][3] and seen[locale][3] != seen["en_US"][3]
    assert seen["without"] == ["Spatial Mask", "Estimate"], "nothing of it stays in Blender"

"""Two jobs on one output: the second is refused, and leaves the first alone."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

from svrgs_addon.files.atomic import reserved
from svrgs_addon.system.errors import SceneError
from system_checks import with_links

ROOT = Path(__file__).resolve().parents[1]


def test_a_reserved_path_is_refused_until_it_is_free(tmp_path):
    out = tmp_path / "new/folder/o.ply"
    with reserved(out):
        with pytest.raises(SceneError, match="o.ply: another job is writing this file"), reserved(out):
            pass
        with reserved(out.with_name("other.ply")):
            pass
    assert not list(tmp_path.iterdir())
    with reserved(out):
        out.write_text("result")
    assert list(out.parent.iterdir()) == [out]


def test_a_path_is_free_when_its_holder_was_killed(tmp_path):
    code = (
        "import sys, time\nfrom svrgs_addon.files.atomic import reserved\nwith reserved(sys.argv[1]):\n   "
        " print(1, flush=True)\n    time.sleep(60)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, tmp_path / "o.ply"], cwd=ROOT, stdout=subprocess.PIPE
    ) as holder:
        holder.stdout.readline()
        with pytest.raises(SceneError, match="another job"), reserved(tmp_path / "o.ply"):
            pass
        holder.kill()
    with reserved(tmp_path / "o.ply"):
        pass
    assert not list(tmp_path.iterdir())


@with_links
def test_a_link_and_its_target_are_one_output(tmp_path):
    os.symlink(tmp_path / "o.ply", tmp_path / "link.ply")
    with (
        reserved(tmp_path / "o.ply"),
        pytest.raises(SceneError, match="link.ply: another job"),
        reserved(tmp_path / "link.ply"),
    ):
        pass


@pytest.mark.slow
def test_a_second_job_on_the_same_output_is_refused_and_the_first_goes_on(tiny, tmp_path):
    words = (
        f"prune {tiny.splat} --data {tiny.folder} --out {tmp_path}/o.ply --target 0.5 --recovery 0".split()
    )
    command = [sys.executable, "-m", "svrgs_addon", *words, "--iterations"]
    first = subprocess.Popen([*command, "1500"], cwd=ROOT, stderr=subprocess.PIPE, text=True)
    assert "Gaussians" in first.stderr.readline()
    began = time.monotonic()
    second = subprocess.run([*command, "10"], cwd=ROOT, capture_output=True, text=True)
    assert time.monotonic() - began < 30 and second.returncode == 2
    assert "o.ply: another job is writing this file" in second.stderr and "Traceback" not in second.stderr
    assert first.poll() is None, "the first job should still run"
    first.communicate(timeout=120)
    assert first.returncode == 0 and [path.name for path in tmp_path.iterdir()] == ["o.ply"]

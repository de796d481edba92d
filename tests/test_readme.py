"""Every command of README.md and of the pages that it names first, run as it stands in a folder that holds
the files it names. A new line must be added here.

`blender` is Blender as a Python module behind run_as_blender.py, or the Blender that SVRGS_BLENDER names (a
command that takes Blender's arguments).
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import platforms

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import tiny_dataset
from test_extension import extension_zip  # noqa: F401

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
PAGES = (README, *((ROOT / f"docs/{name}.md").read_text() for name in ("command-line", "blender")))
RUNS: dict[str, tuple[str, ...]] = {  # command: what it writes
    "svrgs info scene.ply": (),
    "svrgs train --data DATASET --out trained.ply": ("trained.ply",),
    "svrgs prune trained.ply --data DATASET --out pruned.ply --report report": (
        "pruned.ply",
        "report/index.html",
    ),
    "svrgs prune trained.ply --data DATASET --target 0.25 --out quarter.ply": ("quarter.ply",),
    "svrgs prune trained.ply --data DATASET --target 0.25 --time 60 --out quarter.ply": ("quarter.ply",),
    "svrgs prune trained.ply --data DATASET --target 0.25 --levels 0.5,0.1 --out quarter.ply": (
        "quarter.ply",
        "quarter_50.ply",
        "quarter_10.ply",
    ),
    "svrgs prune scene.ply --target 0.25 --time 90 --out quarter.ply": ("quarter.ply",),
    "svrgs rig scene.ply --out cameras.json --preview rig.png": ("cameras.json", "rig.png"),
    "svrgs prune scene.ply --quick --target 0.25 --out quarter.ply": ("quarter.ply",),
    "svrgs select scene.ply --floaters --invert --out clean.ply": ("clean.ply",),
    "svrgs convert pruned.ply pruned.spz": ("pruned.spz",),
    "svrgs prune scene.ply --quick --levels 0.5,0.25,0.12 --out scene/lod-meta.json": (
        "scene/lod-meta.json",
        "scene/3_0/meta.json",
    ),
    "svrgs eval pruned.ply --data DATASET": (),
    "svrgs farm export FOLDER --out JOB --methods removal,lightgaussian --targets 0.5,0.25": (
        "JOB/job.json",
        "JOB/template.json",
    ),
    "svrgs render pruned.ply --data DATASET --views test --outputs rgb,mask --out pictures": (
        "pictures/00.rgb.png",
        "pictures/00.mask.png",
    ),
    "svrgs compare trained.ply pruned.ply --data DATASET --out comparison": ("comparison/index.html",),
    "blender --command svrgs prune trained.ply --data DATASET --out pruned.ply": ("pruned.ply",),
    (
        "blender -b FILE.blend --python-expr"
        """ "import bpy; bpy.ops.svrgs.prune(data='DATASET', target=0.25)\""""
    ): ("scene_pruned.spz",),
    "blender -b --python svrgs_addon/batch.py -- prune FOLDER --out PRUNED": ("PRUNED/one.spz",),
}
STEPS = "--iterations 100 --recovery 100"
SHORTER = {  # added, since the steps of each take longer than all that this is about
    "svrgs train --data DATASET --out trained.ply": "--iterations 100",
    "svrgs prune trained.ply --data DATASET --out pruned.ply --report report": STEPS,
    "svrgs prune trained.ply --data DATASET --target 0.25 --out quarter.ply": STEPS,
    "svrgs prune trained.ply --data DATASET --target 0.25 --time 60 --out quarter.ply": "--time 12",
    "svrgs prune trained.ply --data DATASET --target 0.25 --levels 0.5,0.1 --out quarter.ply": STEPS,
    "svrgs prune scene.ply --target 0.25 --time 90 --out quarter.ply": "--time 15",
    "blender --command svrgs prune trained.ply --data DATASET --out pruned.ply": STEPS,
    "blender -b --python svrgs_addon/batch.py -- prune FOLDER --out PRUNED": STEPS,
}
IN_PYTHON = "target=0.25, iterations=100, recovery=100"  # likewise, in the line of Python
assert SHORTER.keys() <= RUNS.keys()
NOT_RUN = {
    "make demo": "renders and trains for minutes, and downloads packages",
    "make test": "runs this test",
    "svrgs view trained.ply pruned.ply --data DATASET": "serves until it is interrupted: tests/test_view.py",
    "svrgs view trained.ply pruned.ply --data DATASET --export page": "needs modules: tests/test_web_page.py",
    "svrgs bench": "measures for minutes; tests/test_bench.py runs it on small cases",
}


def commands(text: str) -> list[str]:
    """The commands of all code blocks, indented or fenced, without comments and with single blanks."""
    blocks = re.findall(r"(?<=\n\n)(?: {4}.*\n)+", text) + re.findall(
        r"^```.*\n([\s\S]*?)^```", text, re.MULTILINE
    )
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    return [" ".join(re.sub(r"\s# .*", "", line).split()) for line in lines if line.strip()]


@pytest.fixture(scope="module")
def tools(request, tmp_path_factory) -> dict[str, str]:
    """Environment in which `svrgs` and `blender` are on PATH. The extension is installed in this Blender,
    unless it cannot be built."""
    folder = tmp_path_factory.mktemp("tools")
    programs = {
        "svrgs": [sys.executable, "-m", "svrgs_addon"],
        "blender": [sys.executable, ROOT / "tests/run_as_blender.py"],
    }
    if os.environ.get("SVRGS_BLENDER"):
        programs["blender"] = shlex.split(os.environ["SVRGS_BLENDER"])
    for name, words in programs.items():
        (folder / name).write_text(f'#!/bin/sh\nexec {shlex.join(map(str, words))} "$@"\n')
        (folder / name).chmod(0o755)
    variables = {
        "PYTHONPATH": str(ROOT),
        "BLENDER_USER_RESOURCES": str(folder / "user"),
        "XDG_CACHE_HOME": str(folder / "cache"),
    }
    return {**os.environ, **variables, "PATH": f"{folder}:{os.environ['PATH']}"}


@pytest.fixture(scope="module")
def inputs(tools, tmp_path_factory) -> Path:
    """Folder with the files that the commands name, apart from FILE.blend."""
    folder = tmp_path_factory.mktemp("inputs")
    tiny = tiny_dataset.write_tiny(folder / "DATASET", seen=20, cameras=tiny_dataset.views(6, 24, 16))
    shutil.copytree(folder / "DATASET", folder / "FOLDER/one")
    for name in ("scene.ply", "trained.ply", "pruned.ply"):
        shutil.copy(tiny.splat, folder / name)
    (folder / "svrgs_addon").symlink_to(ROOT / "svrgs_addon")
    return folder


@pytest.fixture(scope="module")
def blend(tools, inputs, extension_zip) -> Path:  # noqa: F811
    """A .blend whose active object is the splat "scene", made by the Blender in which the extension is now
    installed."""
    made = extension_zip(shutil.which("blender", path=tools["PATH"]), "-b", "--python-expr")
    assert "STATUS Installed" in run(
        f"blender --command extension install-file -r user_default -e {made}", tools, inputs
    )
    code = (
        "import bpy; bpy.ops.svrgs.import_ply(filepath='scene.ply');"
        " bpy.ops.wm.save_as_mainfile(filepath='FILE.blend')"
    )
    run(f'blender -b --python-expr "{code}"', tools, inputs)
    return inputs / "FILE.blend"


def run(line: str, variables: dict[str, str], folder: Path) -> str:
    """stdout of a line in a shell."""
    done = subprocess.run(
        ["bash", "-c", line], env=variables, cwd=folder, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stdout[-2000:] + done.stderr[-4000:]
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("line", RUNS)
def test_command(line, tools, inputs, tmp_path, request):
    if line.startswith("blender"):
        request.getfixturevalue("blend")
    work = tmp_path / "work"
    shutil.copytree(inputs, work, symlinks=True)
    for name in RUNS[line]:
        (work / name).unlink(missing_ok=True)
    shorter = f"{line} {SHORTER.get(line, '')}".replace("target=0.25", IN_PYTHON)
    said = run(shorter, tools, work)
    assert said and all((work / name).stat().st_size for name in RUNS[line]), said
    for result in (json.loads(text) for text in said.splitlines() if text.startswith("{")):
        assert (work / result["out"]).is_file() and result["count"] < result["before"]["count"]


def test_every_command_is_known_here():
    known = {line for page in PAGES for line in commands(page) if not line.startswith("pip install ")}
    assert known == {*RUNS, *NOT_RUN}
    assert all(len(commands(page)) == len({*commands(page)}) for page in PAGES)


def test_the_first_page_fits_two_screens():
    assert len(README.splitlines()) <= 100


def test_wheels_have_the_names_that_make_package_gives_them():
    """tests/test_packaging.py looks into the wheels, and installs one."""
    named = [line for page in PAGES for line in commands(page) if line.startswith("pip install ")]
    made = [
        f"svrgs_addon-{platforms.VERSION}-py3-none-{facts['pip']}.whl"
        for facts in platforms.TABLE["platform"].values()
    ]
    assert named
    assert all(line == f'pip install "{wheel}[colmap]"' for line in named for wheel in made if wheel in line)
    assert all(any(wheel in line for wheel in made) for line in named)


def test_every_command_that_is_not_run_exists():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert set(re.findall(r"(?<![\w.])make ([a-z-]+)", README)) <= set(targets)
    for line in NOT_RUN:
        program, command = line.split()[:2]
        assert (
            command in targets
            if program == "make"
            else subprocess.run([sys.executable, "-m", "svrgs_addon", command, "--help"], cwd=ROOT).returncode
            == 0
        )


def test_commands_are_found_in_every_kind_of_block():
    text = (
        "Text:\n\n    a  --b   # comment\n\n    c \\\n      --d\n\n1. item\n    no code\n\n```sh\ne"
        " '#1'\n\nf\n```\n"
    )
    assert commands(text) == ["a --b", "c --d", "e '#1'", "f"]

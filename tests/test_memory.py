"""What does not fit into memory is refused before it starts, in one sentence with the number; what does is
estimated well."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import scenes
import tiny_dataset
import whole_jobs
from plans import plan_of, prune_settings
from svrgs_addon.cli import commands
from svrgs_addon.files import ply
from svrgs_addon.files.ply import write_ply
from svrgs_addon.files.registry import load_parts, load_scene, write_scene
from svrgs_addon.finetune.settings import Densify, Phase, Rates
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.recipes.fine_tuned import refuse_excess
from svrgs_addon.system import memory, packages
from svrgs_addon.system import memory_limits as readings
from svrgs_addon.system.errors import Cancelled, NativeError, SceneError, TooMany
from svrgs_addon.views.dataset import Dataset, load_dataset
from svrgs_bench.scenes import room

FEW, MANY = 300_000, 1_000_000  # Gaussians: parts, and copies of theirs, need the same in both
REFUSED = r"needs about [\d.]+ [kMG]B of memory, but only [\d.]+ [kMG]B are available"


@pytest.fixture
def little(monkeypatch):
    """Sets what is said to be available."""
    return lambda size: monkeypatch.setattr(memory, "available", lambda: size)


def refused(outcome, out):
    assert outcome.status == 2 and outcome.err.count("\n") == 1 and re.search(REFUSED, outcome.err), (
        outcome.err
    )
    assert not out.exists() and not out.with_name(out.name + ".job").exists()


def test_reading_is_refused(svrgs, little, tiny, tmp_path):
    little(1000)
    refused(svrgs("render", tiny.splat, "--data", tiny.folder, "--out", tmp_path / "out"), tmp_path / "out")


def test_rendering_is_refused(svrgs, little, tiny, tmp_path):
    little(memory.reading(tiny.splat.stat().st_size))
    refused(svrgs("render", tiny.splat, "--data", tiny.folder, "--out", tmp_path / "out"), tmp_path / "out")


@pytest.mark.parametrize("command", ["prune", "train"])
def test_jobs_are_refused(svrgs, little, tiny, tmp_path, command):
    little(1_000_000)
    scene = [tiny.splat] if command == "prune" else []
    outcome = svrgs(
        command, *scene, f"--data {tiny.folder} --iterations 2 --recovery 0 --out {tmp_path}/o.ply"
    )
    refused(outcome, tmp_path / "o.ply")


@pytest.mark.parametrize("command", ["eval", "compare"])
def test_measuring_is_refused(svrgs, little, tiny, tmp_path, monkeypatch, command):
    monkeypatch.setattr(Dataset, "image", lambda *_: pytest.fail("a photograph was read"))
    little(memory.rendering(tiny_dataset.COUNT, tiny_dataset.WIDTH, tiny_dataset.HEIGHT))
    words = [tiny.splat, tiny.splat, "--out", tmp_path / "out"] if command == "compare" else [tiny.splat]
    refused(svrgs(command, *words, "--data", tiny.folder), tmp_path / "out")


def test_lpips_counts():
    views = [scenes.camera(640, 480)]
    assert memory.measuring(0, views, 0, lpips=True) > 5 * memory.measuring(0, views, 0, lpips=False)


def test_enough_is_enough(svrgs, little, tiny, tmp_path):
    little(100_000_000)
    assert (
        svrgs("render", tiny.splat, "--data", tiny.folder, "--out", tmp_path / "out", "--views", 0).status
        == 0
    )


def test_nothing_is_refused_where_the_system_is_silent(little):
    little(None)
    memory.refuse_excess("anything", 10**18)


def test_what_is_available():
    assert 10**7 < memory.available() < 10**14


def test_a_containers_limit_counts(monkeypatch, tmp_path):
    monkeypatch.setattr(readings, "CGROUP", tmp_path)
    before = memory.available()
    (tmp_path / "memory.max").write_text("3000000\n")
    (tmp_path / "memory.current").write_text("2500000\n")
    (tmp_path / "memory.stat").write_text("anon 5\ninactive_file 200000\n")
    assert memory.available() == 700_000
    (tmp_path / "memory.max").write_text("max\n")
    assert memory.available() > 700_000 < before


@pytest.fixture
def cgroups(monkeypatch, tmp_path):
    """A function that writes the files of cgroups: the lines of /proc/self/cgroup, and {path below
    /sys/fs/cgroup: text}."""
    monkeypatch.setattr(readings, "CGROUP", tmp_path / "cgroup")
    monkeypatch.setattr(readings, "OWN_CGROUPS", tmp_path / "own")

    def write(own: str, **files: str):
        (tmp_path / "own").write_text(own)
        for name, text in files.items():
            path = tmp_path / "cgroup" / name.replace("__", "/").replace("_DOT_", ".")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

    return write


def group(folder: str, version: int, limit: str, used: int, cached: int) -> dict[str, str]:
    """The files of one cgroup below /sys/fs/cgroup."""
    names = (
        ("memory_DOT_max", "memory_DOT_current")
        if version == 2
        else ("memory_DOT_limit_in_bytes", "memory_DOT_usage_in_bytes")
    )
    stat = f"anon 5\n{'' if version == 2 else 'total_'}inactive_file {cached}\n"
    return {
        f"{folder}{name}": text
        for name, text in zip((*names, "memory_DOT_stat"), (limit, f"{used}\n", stat), strict=True)
    }


def test_the_limit_of_a_container_of_version_1_counts(cgroups):
    cgroups(
        "12:cpu,cpuacct:/docker/abc\n5:memory:/docker/abc\n0::/\n",
        **group("memory__", 1, "3000000\n", 2500000, 200000),
    )
    assert memory.available() == 700_000


@pytest.mark.parametrize(
    "version, root, own", [(2, "", "0::/user/job/step\n"), (1, "memory__", "5:memory:/user/job/step\n")]
)
def test_the_limit_of_an_outer_group_counts(cgroups, version, root, own):
    unlimited = "max\n" if version == 2 else "9223372036854771712\n"
    groups = group(f"{root}user__job__step__", version, unlimited, 10, 0) | group(
        f"{root}user__job__", version, "5000000\n", 1000000, 0
    )
    cgroups(
        own,
        **groups,
        **group(f"{root}user__", version, "9000000\n", 1000000, 0),
        **group(f"{root}other__", version, "10\n", 0, 0),
    )
    assert memory.available() == 4_000_000


LIMITED = "import resource; resource.setrlimit(resource.RLIMIT_AS, ({0}, {0})); {1}"


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not hold ulimit -v")
@pytest.mark.parametrize("command", ["info", "render", "train", "prune", "eval", "compare"])
def test_too_few_addresses_give_one_sentence(tiny, tmp_path, command):
    """As with ulimit -v 150000: NumPy's library would fail or never return."""
    words = {"compare": [tiny.splat, tiny.splat], "train": []}.get(command, [tiny.splat]) + (
        [] if command == "info" else ["--data", tiny.folder]
    )
    words += ["--out", tmp_path / "o.ply"] if command in ("render", "train", "compare", "prune") else []
    start = "import sys; from svrgs_addon.cli.main import main; sys.exit(main())"
    code = LIMITED.format(150_000_000, start)
    done = subprocess.run(
        [sys.executable, "-c", code, command, *map(str, words)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2 and done.stdout == "", done.stderr
    assert re.fullmatch(
        r"svrgs: this process may use only 150\.0 MB of memory \(ulimit -v\), but needs at least [\d.]+"
        r" [MG]B; raise the limit\n",
        done.stderr,
    )


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not hold ulimit -v")
def test_the_addresses_that_are_left_are_available():
    code = LIMITED.format(2_000_000_000, "from svrgs_addon.system import memory; print(memory.available())")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 1_000_000_000 < int(done.stdout) < 2_000_000_000


@pytest.mark.parametrize(
    "error, sentence",
    [
        (RuntimeError("can't start new thread"), "no further thread can be started"),
        (MemoryError(), "out of memory"),
        (SystemError("<ufunc 'add'> returned NULL without setting an exception"), "out of memory"),
    ],
)
def test_lack_of_memory_in_the_middle_is_one_sentence(svrgs, tiny, monkeypatch, error, sentence):
    def fail(*_):
        raise error

    monkeypatch.setattr("svrgs_addon.prune.blocks.block_rasterizer.load_scene", fail)
    done = svrgs("eval", tiny.splat, "--data", tiny.folder)
    assert done.status == 1 and done.err.startswith(f"svrgs: {sentence}") and done.err.count("\n") == 1, (
        done.err
    )


def test_a_package_that_does_not_load_is_not_called_missing(monkeypatch, tmp_path):
    (tmp_path / "broken_package.py").write_text(
        "raise ImportError('libx.so: failed to map segment from shared object')"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        NativeError, match=r"broken_package cannot be loaded \(libx.so: failed to map segment"
    ):
        packages.load("broken_package", "reading")
    with pytest.raises(
        SceneError, match="reading needs the package no_such_package: run .* -m pip install no_such_package"
    ):
        packages.load("no_such_package", "reading")


def test_ctrl_c_while_a_package_is_loaded_is_no_broken_package(tmp_path, monkeypatch):
    text = "try:\n    raise KeyboardInterrupt\nexcept KeyboardInterrupt:\n    raise ImportError('broken')\n"
    (tmp_path / "stopped_package.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        packages.load("stopped_package", "reading")


@pytest.mark.parametrize(
    "value, text",
    [(0, "0 bytes"), (999, "999 bytes"), (34_600, "34.6 kB"), (150e6, "150.0 MB"), (1.26e9, "1.3 GB")],
)
def test_sizes_have_sensible_units(value, text):
    assert memory.size_text(value) == text


def test_a_childs_peak_is_its_own():
    """However much the process holds that starts it."""
    held = np.ones(150_000_000, np.uint8)
    code = (
        "import numpy as np; from svrgs_addon.system.memory_limits import peak; array = np.ones(20_000_000,"
        " np.uint8); del array; print(peak())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 20_000_000 < int(done.stdout) < 100_000_000 < held.nbytes


PARTS = """
import sys
from svrgs_addon.files.registry import load_parts
from svrgs_addon.system.memory_limits import peak
assert sum(part.count for part in load_parts(sys.argv[1]))
print(peak())
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from /proc")
def test_reading_in_parts_needs_what_is_foreseen(tmp_path):
    """Of an SPZ, whose streams are unpacked as a whole. Seen: 96 % of the estimate with 2,000,000 Gaussians;
    a SOG 61 %."""
    peaks = []
    for count in (FEW, MANY):
        write_scene(tmp_path / "a.spz", room(count, 3))
        done = subprocess.run(
            [sys.executable, "-c", PARTS, tmp_path / "a.spz"], capture_output=True, text=True, check=True
        )
        peaks.append(int(done.stdout))
    assert 0.5 < (peaks[1] - peaks[0]) / memory.unpacking_in_parts(MANY - FEW, 16) < 1.2


def test_reading_in_parts_is_let_in_where_reading_as_a_whole_is_not(little, tmp_path):
    write_scene(tmp_path / "a.spz", room(2_000, 3))
    little(memory.unpacking_in_parts(2_000, 16))
    with pytest.raises(TooMany, match=r"a.spz needs about"):
        load_scene(tmp_path / "a.spz")
    assert sum(part.count for part in load_parts(tmp_path / "a.spz")) == 2_000
    little(memory.unpacking_in_parts(2_000, 16) - 1)
    with pytest.raises(TooMany, match=r"a.spz needs about"):
        next(load_parts(tmp_path / "a.spz"))


def test_files_with_more_gaussians_than_are_read_as_a_whole_are_converted(svrgs, monkeypatch, tmp_path):
    write_scene(tmp_path / "a.ply", room(300, 1))
    monkeypatch.setattr(ply.read_ply, "__defaults__", (299,))
    assert svrgs("info", tmp_path / "a.ply", "--json").json["count"] == 300
    assert svrgs("convert", tmp_path / "a.ply", tmp_path / "b.ply").status == 0
    monkeypatch.undo()
    assert load_scene(tmp_path / "b.ply").count == 300
    assert (load_scene(tmp_path / "b.ply").sh == load_scene(tmp_path / "a.ply").sh).all()


METRICS = """
import numpy as np
from svrgs_addon.native import library
from svrgs_addon.render.metrics.measures import flip
from svrgs_addon.render.metrics.measures import psnr
from svrgs_addon.render.metrics.measures import ssim
from svrgs_addon.system.memory_limits import peak, proc_bytes
library.set_threads(2)
a, b = np.random.default_rng(0).random((2, 1500, 2000, 3), np.float32)
start = proc_bytes("self/status", "VmRSS")
psnr(a, b), ssim(a, b), flip(a, b)
print((peak() - start) / 1500 / 2000)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from /proc")
def test_metrics_need_little_memory():
    """Bytes per pixel beside the two images: seen 15; metrics of the whole image at once took 88."""
    done = subprocess.run([sys.executable, "-c", METRICS], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 40


# --- growth


RULE = Densify(start=2, until=9, every=2, gradient=0.0)
GROWING = plan_of("3dgs", (Phase("train", 10, Rates(), RULE),))


def trained(tiny, out, **options) -> dict:
    return whole_jobs.train(load_dataset(tiny.folder), GROWING, JobContext(out, **options))


def short_from_the_start_on(monkeypatch):
    """Training is let in, and from there on nothing is available."""
    answers = iter([10**12])
    monkeypatch.setattr(memory, "available", lambda: next(answers, 1000))


def test_training_grows_where_memory_allows_it(tiny, little, tmp_path):
    little(10**12)
    result = trained(tiny, tmp_path / "o.ply")
    assert result["densifications_held_back"] == 0 and result["count"] > tiny_dataset.SEEN


def test_training_goes_on_without_growing_where_memory_is_short(tiny, monkeypatch, caplog, tmp_path):
    short_from_the_start_on(monkeypatch)
    result = trained(tiny, tmp_path / "o.ply")
    assert result["densifications_held_back"] == 3 and result["count"] <= tiny_dataset.SEEN
    assert result["iterations"] == 10
    assert "3 densifications added nothing: memory was too short" in commands._figures(result)
    (said,) = caplog.messages
    assert re.fullmatch(
        rf"iteration 4: growing beyond {tiny_dataset.SEEN} Gaussians {REFUSED}; training goes on without"
        r" growing",
        said,
    )


def test_growth_held_back_is_remembered_by_checkpoints(tiny, monkeypatch, tmp_path):
    short_from_the_start_on(monkeypatch)
    seen = []
    with pytest.raises(Cancelled):
        trained(tiny, tmp_path / "o.ply", observe=seen.append, stop=lambda: len(seen) == 5)
    monkeypatch.setattr(memory, "available", lambda: 10**12)
    result = trained(tiny, tmp_path / "o.ply", resume=True)
    assert result["densifications_held_back"] == 1 and result["count"] > tiny_dataset.SEEN


GROWTH = """
import sys
import numpy as np
from svrgs_addon.native import rasterizer as native
from svrgs_addon.system import memory
from svrgs_bench.cases import Case
from svrgs_bench.scenes import orbit_camera
from svrgs_bench.trial import Trial
from svrgs_addon.finetune import densify
from svrgs_addon.finetune.settings import Densify
from svrgs_addon.files.registry import load_scene
from svrgs_addon.system.memory_limits import peak, proc_bytes
camera, start = orbit_camera(640, 480), peak()
scene = load_scene(sys.argv[1])
read = peak() - start
native.Rasterizer().forward(scene, camera, native.RenderOptions(picture_only=True))
drawn = peak() - start
trial = Trial(Case("room", scene, camera))
for array in trial.model.moments.values():
    array += 0
trial.step()
tuned = peak() - start
model, statistics = trial.model, densify.Statistics(scene.count)
statistics.total[::2] = 1
before = proc_bytes("self/status", "VmRSS")
densify.densify(model, statistics, Densify(), 1.0, np.random.default_rng(0))
grown = peak() - before
count, file_bytes = scene.count, int(sys.argv[2])
print(read / memory.reading(file_bytes),
      drawn / (memory.reading(file_bytes) + memory.rendering(count, 640, 480)),
      tuned / (memory.reading(file_bytes) + memory.tuning(count, 16, [camera], 0)),
      grown / memory.growing(count, model.count - count, 16, [camera]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the peak is read from /proc")
def test_estimates_are_what_is_taken(tmp_path):
    """Shares of the estimate that reading, drawing, tuning and growing 150,000 Gaussians take: seen 0.93,
    0.68, 0.71 and 0.75."""
    path = tmp_path / "room.ply"
    write_ply(path, room(150_000))
    done = subprocess.run(
        [sys.executable, "-c", GROWTH, path, str(path.stat().st_size)],
        capture_output=True,
        text=True,
        check=True,
    )
    shares = [float(word) for word in done.stdout.split()]
    assert all(0.3 < share < 1.1 for share in shares), shares


def test_small_scenes_are_never_refused(little):
    little(64 * 2**20)
    memory.refuse_excess("a small scene", memory.tuning(1000, 16, [scenes.camera(64, 48)], 10**9))


def test_a_method_that_merges_needs_the_memory_of_its_order(little, tiny, data):
    little(1 << 50)
    needed = lambda method: refuse_excess("", 100_000_000, 1, data, prune_settings(method, 10, 10, target=9))
    assert needed("merge") == memory.ordering(100_000_000, 1, data.cameras) > needed("opacity")


def test_masks_of_distractors_take_a_bit_a_pixel(little, data):
    little(1 << 50)
    plan = prune_settings("removal", 10, 10, target=9)
    needed = [refuse_excess("", 100, 1, data, replace(plan, mask_distractors=on)) for on in (False, True)]
    assert needed[1] - needed[0] == sum(camera.height * camera.width // 8 for camera in data.cameras)

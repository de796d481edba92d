"""Fixtures every test may use."""

from __future__ import annotations

import json
import os
import re
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

WORKER = re.compile("gw([0-9]+)")  # how pytest-xdist calls its workers
LONGEST = (  # files of make test-slow, each of which one worker runs
    "test_extension.py", "test_sanitizers.py", "test_by_blocks.py", "test_demo_scene.py", "test_readme.py",
    "test_learned_by_blocks.py", "test_farm.py", "test_strength_controller.py", "test_packaging.py",
)  # fmt: skip
SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_configure():
    """A worker of pytest-xdist and its children keep to one core each: the native library, torch and numpy
    then run one thread unless they are told another number. Ctrl-C is heard also where a shell's & let it be
    ignored. This process does not wait for the disk; its children do, as the product does."""
    os.fsync = lambda descriptor: None
    os.environ["SVRGS_LPIPS_WEIGHTS"] = ""  # whether the user has fetched some changes nothing
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    worker = WORKER.fullmatch(os.environ.get("PYTEST_XDIST_WORKER", ""))
    if worker and hasattr(os, "sched_setaffinity"):
        allowed = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {allowed[int(worker[1]) % len(allowed)]})


def pytest_make_parametrize_id(val: object) -> str | None:
    """Names of tests stay short: on Windows they would not fit into an environment variable."""
    return f"{val[:40]}…{len(val)}" if isinstance(val, str) and len(val) > 1000 else None


def pytest_collection_modifyitems(items: list[pytest.Item]):
    """The longest files of slow tests come first, so that no worker is left with them at the end."""
    ranks = {name: rank for rank, name in enumerate(LONGEST)}
    items.sort(
        key=lambda item: ranks.get(item.path.name, len(LONGEST)) if item.get_closest_marker("slow") else -1
    )


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real photographs and splats kept beside the repository; the test is skipped where they are absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip("the data folder beside the repository (../shared/data) is absent")
    return SHARED_DATA


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """A tiny dataset and its splat, a tiny_dataset.Tiny; for reading only."""
    pytest.importorskip("pycolmap")
    pytest.importorskip("OpenImageIO")
    import tiny_dataset

    return tiny_dataset.write_tiny(tmp_path_factory.mktemp("tiny"))


@pytest.fixture(scope="module")
def data(tiny):
    """The tiny dataset, loaded."""
    from svrgs_addon.views.dataset import load_dataset

    return load_dataset(tiny.folder)


@pytest.fixture
def small_pictures(monkeypatch):
    """Quick jobs in this process decide on smaller pictures than those of users, in a fraction of the
    time."""
    from svrgs_addon.prune import job_views

    monkeypatch.setattr(job_views, "QUICK_SIDE", 128)


@pytest.fixture
def small_rig(small_pictures, monkeypatch):
    """As above, and fewer and smaller views are placed."""
    from svrgs_addon.views.rig import place, viewpoints

    few = {"FIRST": 12, "SECOND": 4, "MIN_CHOSEN": 8, "MAX_CHOSEN": 12, "USUAL_VIEWS": 16}
    for module, limits in ((place, few), (viewpoints, {"SMALLEST": 96, "LARGEST": 96})):
        for name, value in limits.items():
            monkeypatch.setattr(module, name, value)


@pytest.fixture
def default_threads():
    """As many threads as processors again, after a test that changes their number."""
    yield
    from svrgs_addon.native import library

    library.set_threads(0)


@dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    status: int
    out: str
    err: str

    @property
    def json(self) -> dict:
        """stdout, which must be one line with one JSON object."""
        assert self.status == 0, self.err
        assert self.out.count("\n") == 1 and self.out.endswith("\n")
        return json.loads(self.out)


@pytest.fixture
def svrgs(capfd):
    """Runs a command line in this process; returns its Outcome. A text is several words, apart by spaces; all
    else is one."""
    from command_checks import command_words
    from svrgs_addon.cli.main import main as run_svrgs

    def run(*words: object) -> Outcome:
        capfd.readouterr()
        try:
            status = run_svrgs(command_words(*words))
        except SystemExit as stop:  # usage errors, --help
            status = stop.code
        return Outcome(status, *capfd.readouterr())

    return run


@pytest.fixture
def stop_at(monkeypatch):
    """Sends Ctrl-C, once, when a job by blocks tells of a step, at or after this share of it."""
    from svrgs_addon.prune.progress import Reporter

    told = Reporter.part

    def stop(step: str, at: float = 0.0):
        def part(self, text: str, share: float):
            told(self, text, share)
            if text.startswith(step) and share >= at:
                monkeypatch.setattr(Reporter, "part", told)
                signal.raise_signal(signal.SIGINT)

        monkeypatch.setattr(Reporter, "part", part)

    return stop


@pytest.fixture
def jobs():
    """Collects jobs whose processes must not outlive the test."""
    started: list = []
    yield started
    for job in started:
        if job.running:
            job._process.kill()
            job._process.wait()


@pytest.fixture
def windows(monkeypatch):
    """A fake_windows.FakeWindows in whose hands this process is; None on Windows, where the system itself is
    tested."""
    if sys.platform == "win32":
        yield None
        return
    from fake_windows import FakeWindows
    from svrgs_addon.system import here, windows

    fake = FakeWindows()
    monkeypatch.setattr(here, "WINDOWS", True)
    monkeypatch.setattr(windows, "kernel32", lambda: fake)
    monkeypatch.setattr(windows, "failure", fake.failure)
    monkeypatch.setattr(windows, "descriptor", fake.descriptor)
    monkeypatch.setattr(os, "replace", fake.replace)
    monkeypatch.setattr(Path, "read_bytes", lambda path: fake.read_bytes(path))
    yield fake

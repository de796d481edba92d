"""`svrgs bench --cores`: what more threads would give, by the tasks of one."""

from __future__ import annotations

import numpy as np
import pytest

from svrgs_addon.native import library
from svrgs_addon.native.library import traced
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_bench import cores
from svrgs_bench.cores import COUNTS, makespan, measure_cores
from svrgs_bench.scenes import orbit_camera, room
from svrgs_bench.timing import seconds


@pytest.fixture(autouse=True)
def usual_threads():
    yield
    library.set_threads(0)


def test_a_thread_that_is_free_takes_the_next_task():
    tasks = np.array([3.0, 1.0, 1.0, 1.0, 2.0])
    assert [makespan(tasks, threads) for threads in (1, 2, 3, 9)] == [8, 5, 3, 3]
    assert makespan(np.zeros(0), 4) == 0


def test_each_task_of_one_thread_is_timed():
    rasterizer, scene, camera = Rasterizer(), room(2_000), orbit_camera(160, 120)
    library.set_threads(1)
    took = []
    jobs = traced(lambda: took.append(seconds(rasterizer.forward, scene, camera, RenderOptions())))
    bins = -(-160 // 128) * -(-120 // 128)  # of 16 tiles, each of which is a task, too
    assert len(jobs) >= 4 and any(len(job) == 17 * bins for job in jobs)
    assert all((job >= 0).all() for job in jobs)
    assert 0.2 * took[0] < sum(job.sum() for job in jobs) < took[0]
    assert len(traced(lambda: None)) == 0
    rasterizer.forward(scene, camera, RenderOptions())
    library.set_threads(2)
    assert traced(lambda: rasterizer.forward(scene, camera, RenderOptions())) == []


def test_more_threads_are_foreseen_to_be_faster_up_to_the_serial_part():
    found = measure_cores(3, lambda _: None, ((5_000, (320, 192)),))
    assert [entry["what"] for entry in found["entries"]] == ["picture", "step"]
    assert library.threads() == found["threads"]
    for entry in found["entries"]:
        speed = [entry["speed_up"][str(count)] for count in COUNTS]
        assert speed[0] == pytest.approx(1, abs=1e-3) and speed == sorted(speed) and 0 < entry["serial"] < 0.9
        assert all(
            value <= min(count, 1 / entry["serial"]) * 1.2 for value, count in zip(speed, COUNTS, strict=True)
        )
        assert entry["measured"]["1"] == 1 and set(entry["measured"]) <= {str(count) for count in COUNTS}
        assert set(entry["measured_ms"]) == set(entry["measured"]) == set(found["arithmetic"])
        assert min(entry["measured_ms"].values()) > 0
    assert found["arithmetic"]["1"] == 1


def test_two_threads_of_a_core_count_once(tmp_path, monkeypatch):
    monkeypatch.setattr(cores, "TOPOLOGY", tmp_path)
    monkeypatch.setattr(cores.os, "sched_getaffinity", lambda _: {0, 1, 2, 5}, raising=False)
    for number, siblings in ((0, "0,4"), (1, "1,5"), (2, "2,6"), (5, "1,5")):
        (tmp_path / f"cpu{number}/topology").mkdir(parents=True)
        (tmp_path / f"cpu{number}/topology/thread_siblings_list").write_text(siblings + "\n")
    assert cores.physical_cores() == 3
    (tmp_path / "cpu5/topology/thread_siblings_list").unlink()
    assert cores.physical_cores() is None

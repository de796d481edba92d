"""A small job of every recipe that is killed, or that runs out of disk or memory, at any moment: it ends with
one sentence, the splat and the old output stay as they are, and taken up again it gives the bytes of an
undisturbed run."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import random
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path

import tiny_dataset
import whole_jobs
from faults import Survived, digest, done, forked, killed
from plans import prune_settings
from svrgs_addon.cli.main import main as svrgs
from svrgs_addon.files.registry import read_scene
from svrgs_addon.finetune import loop
from svrgs_addon.prune.context import JobContext
from svrgs_addon.system import memory
from svrgs_addon.system.errors import SplatError
from svrgs_addon.system.exit_status import guarded
from svrgs_addon.views.dataset import load_dataset

METHOD = ("--iterations", 20, "--recovery", 10)
BY_BLOCKS = ("--target", 0.5, "--block", 130)
BY_C = "ended by the C library"
ENDED_BY_C = (127, -signal.SIGABRT)  # glibc, where it finds no memory for the data of a thread
LIMITS_MB = (16, 64, 96, 112, 120, 128, 136, 144, 152, 160, 176, 192, 224, 256, 320, 384, 512)


@dataclass(frozen=True)
class Job:
    """A job of a recipe, in a folder of its own."""

    folder: Path
    splat: Path
    work: Callable[[], object]  # takes up what was left; raises SplatError
    outs: Sequence[str]  # files in the folder
    kept: str  # pattern of what it is taken up from
    fresh: Sequence[str] = ()  # further files and folders that are removed before it is done again

    def state(self) -> list[str | None]:
        """Digests of the splat and of the outputs; None for one that is not there."""
        paths = [self.splat, *(self.folder / name for name in self.outs)]
        return [digest(path) if path.exists() else None for path in paths]

    def ended(self) -> bool:
        return all((self.folder / name).exists() for name in self.outs)

    def clear(self):
        for name in (*self.outs, *self.fresh):
            path = self.folder / name
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)

    def names(self) -> list[str]:
        """What lies in the folder."""
        return sorted(str(path.relative_to(self.folder)) for path in self.folder.rglob("*"))


def job_named(name: str, folder: Path) -> Job:
    """A job of JOBS, with a dataset of its own, in the folder."""
    done(lambda: tiny_dataset.write_tiny(folder / "tiny"))  # in a child: it draws
    (folder / "out").mkdir()
    loop.CHECKPOINT_SECONDS = 0
    return JOBS[name](folder / "tiny" / "scene.ply", folder / "tiny", folder / "out")


def _run(splat: Path, dataset: Path, folder: Path) -> Job:
    settings = replace(prune_settings("svr", 40, 20, prune_every=15, lambda_f=1e-3), mask_init=0.5, seed=5)
    data, context = load_dataset(dataset), JobContext(folder / "o.ply", resume=True)
    work = lambda: whole_jobs.prune(splat, data, settings, context)
    return Job(folder, splat, work, ["o.ply"], "o.ply.job/*/manifest.json")


def _blocks(splat: Path, dataset: Path, folder: Path) -> Job:
    words = "large", "prune", splat, "--data", dataset, "--method", "removal", *METHOD, *BY_BLOCKS, "--resume"
    work = _command(*words, "--out", folder / "o.ply")
    return Job(folder, splat, work, ["o.ply"], "o.ply.blocks/**/manifest.json")


def _merged_blocks(splat: Path, dataset: Path, folder: Path) -> Job:
    words = "large", "prune", splat, "--data", dataset, "--tuning-steps", 20, *BY_BLOCKS
    return Job(folder, splat, _command(*words, "--out", folder / "o.spz"), ["o.spz"], "none")


def _quick(splat: Path, dataset: Path, folder: Path) -> Job:
    words = "prune", splat, "--quick", "--target", 0.5, "--levels", 0.5
    return Job(folder, splat, _command(*words, "--out", folder / "o.sog"), ["o.sog", "o_50.sog"], "none")


def _farm(splat: Path, dataset: Path, folder: Path) -> Job:
    words = "farm", "export", dataset, "--methods", "removal,opacity", "--targets", 0.5, *METHOD
    done(_command(*words, "--out", folder / "job"))
    outs = [f"job/results/{dataset.name}-{method}-50.spz" for method in ("removal", "opacity")]
    return Job(folder, splat, _command("farm", "run", folder / "job"), outs, "job/results/*", ["job/results"])


JOBS: dict[str, Callable[[Path, Path, Path], Job]] = {
    "run": _run, "quick": _quick, "farm": _farm, "blocks": _blocks, "merged-blocks": _merged_blocks,
}  # fmt: skip


def _command(*words: object) -> Callable[[], object]:
    """A command of svrgs; SplatError with what it says if it fails."""

    def work():
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as said:
            status = svrgs([str(word) for word in words])
        if status:
            raise SplatError(said.getvalue())

    return work


def kill(job: Job, kills: int, seed: int = 0) -> Survived:
    """Killed again and again, and taken up each time."""
    chance, survived = random.Random(seed), Survived()
    began = time.monotonic()
    done(job.work)
    longest, expected, names = 1.1 * (time.monotonic() - began), job.state(), job.names()
    assert job.ended()
    job.clear()
    while survived.kills < kills:
        survived.resumed += any(job.folder.glob(job.kept))
        code = killed(job.work, chance.uniform(0, longest))
        assert code in (None, 0), "a job that was taken up has failed"
        survived.kills += code is None
        found = job.state()
        assert all(one in (None, right) for one, right in zip(found, expected, strict=True)), "other bytes"
        if job.ended():  # whether or not its process lived on
            survived.finished += 1
            job.clear()
    done(job.work)
    assert job.state() == expected and job.names() == names
    return survived


def fill_the_disk(job: Job, most: int = 0) -> int:
    """The disk is full from the first write on, from the second one on, and so forth; `most` of them, evenly
    spread, or all. Returns their number."""
    reader, writer = os.pipe()
    done(lambda: os.write(writer, b"%d" % _writes(job, sys.maxsize)))
    total, expected = int(os.read(reader, 20)), job.state()
    assert job.ended()
    numbers = (
        range(total) if not most else sorted({round(k * (total - 1) / max(1, most - 1)) for k in range(most)})
    )
    for number in numbers:
        job.clear()
        for name in job.outs:
            (job.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (job.folder / name).write_bytes(b"old")
        old = job.state()
        sentence = _sentence(job, lambda number=number: _writes(job, number))
        assert sentence is None or "No space left" in sentence, f"write {number}: {sentence!r}"
        found = job.state()
        allowed = zip(found, old if sentence else expected, expected, strict=True)
        assert all(one in both for one, *both in allowed), f"write {number}: an output is neither old nor new"
        done(job.work)
        assert job.state() == expected, f"write {number}: other bytes"
    return len(numbers)


def limit_the_memory(job: Job) -> list[str | None]:
    """So many MB of addresses more than the process has: too few and just enough. Returns for each of
    LIMITS_MB the sentence of the job, if it failed."""
    done(job.work)
    counts = {name: read_scene(job.folder / name).count for name in job.outs}
    splat, sentences = job.state()[0], []
    for megabytes in LIMITS_MB:
        job.clear()
        sentence = _sentence(job, lambda megabytes=megabytes: _limited(job, megabytes))
        sentences.append(sentence)
        whole = [(job.folder / name).exists() for name in job.outs]
        assert all(whole) or sentence is not None
        for name in compress(job.outs, whole):  # by blocks, if memory is short: other Gaussians, as many
            assert read_scene(job.folder / name).count == counts[name], f"{megabytes} MB: {sentence}"
        done(job.work)
        assert job.ended() and job.state()[0] == splat, f"{megabytes} MB: not done again"
    return sentences


def _writes(job: Job, number: int) -> int:
    """Does the job on a disk that is full from that write on: a file that is opened to be written, a new
    folder, an fsync. Returns how many there were."""
    count, folder = 0, str(job.folder)

    def one_more():
        nonlocal count
        count += 1
        if count > number:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def hook(event: str, arguments: tuple):
        if event == "open":
            path, mode, flags = arguments
            writes = set(mode or "") & set("wxa+") or flags & (os.O_WRONLY | os.O_RDWR)
            inside = isinstance(path, str | bytes) and os.fsdecode(path).startswith(folder)
        elif event == "os.mkdir":
            writes, inside = True, str(arguments[0]).startswith(folder)
        else:
            return
        if writes and inside:
            one_more()

    def synced(descriptor: int):
        one_more()
        fsync(descriptor)

    fsync, os.fsync = os.fsync, synced
    sys.addaudithook(hook)
    job.work()
    return count


def _limited(job: Job, megabytes: int):
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + megabytes * 2**20, resource.RLIM_INFINITY))
    memory.refuse_few_addresses(memory.PHOTOGRAPH_ADDRESSES)  # as every command does
    job.work()


def _sentence(job: Job, work: Callable[[], object]) -> str | None:
    """The sentence with which the work ends in a child; None if it succeeds."""
    reader, writer = os.pipe()

    def told():
        os.dup2(writer, 2)
        guarded(lambda: work() and 0, lambda sentence: os.write(writer, sentence.encode()[-4000:]))

    status = os.waitstatus_to_exitcode(os.waitpid(forked(told), 0)[1])
    os.close(writer)
    with open(reader, "rb") as file:
        said = file.read().decode().strip()
    if status in ENDED_BY_C and "thread-local data" in said:
        return BY_C
    assert status == 0 and "Traceback" not in said, said or status
    return said.splitlines()[-1] if said else None

"""The folder of a background job, which prunes a splat or trains one. It is the whole state of the job: a
.blend file holds only its path.

    job.json           the request: schema, version, kind (prune or train), name, number of Gaussians,
                       digest_of() the splat, options
    state.json         state of the job, replaced as a whole, at least every HEARTBEAT seconds while the job
                       runs
    scene.ply          of a job that prunes: the splat at its start; the column svrgs_row holds the row of
                       each Gaussian
    messages.jsonl     stdout of the child process: messages, one JSON object per line (job_main.py)
    log.txt            stderr of the child process
    metrics.csv        iteration, count, loss, psnr
    previews/ITERATION.png
    ranking.npz        of a job that prunes: when each Gaussian was removed, and its last probability
                       (ranking.py)
    recovered.ply.job  checkpoints; recovered.ply is the splat after the last step
    recovered.ply.blocks    of a job by blocks (prune/blocks/): the blocks, and which of its tasks are done
    stop               flag file: the parent creates it, the child obeys (job_main.py)
    cameras.json       given views of a job without photographs, if there are any
    merged.ply, order.npy   of a quick job: its order (finetune/decimate/saved_order.py)

    pruned.ply, kept.npy, score.npy, result.json     the result; result.json is written last
    probability.npy                                  if masks were learned
    trained.ply, result.json                         the result of a job that trains
    recovered.ply_distractor_masks/   if distractors were masked (prune/distractors.py)
    recovered.ply_exposure.json, trained.ply_exposure.json   if exposure was fitted (finetune/exposure.py)
    recovered.ply_refined_cameras.json, trained.ply_refined_cameras.json   if poses were refined

A job whose state is not renewed for STALE seconds counts as interrupted. The folder is read like a file of a
stranger: options are checked by name, type and range, arrays by shape and dtype, sizes of JSON files by
LARGEST_JSON, and the number of Gaussians against scene.ply. A job with a symbolic link in its folder is
refused before anything is written. discard() removes only names that a job writes.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import math
import os
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from .. import __version__
from ..files.atomic import write_json
from ..files.ply_header import MAX_HEADER_BYTES, parse_header
from ..files.reading import json_object
from ..files.registry import write_scene
from ..finetune.decimate.saved_order import MERGED, ORDER
from ..prune.blocks import folder as blocks
from ..prune.blocks import tasks
from ..prune.disk_room import ROW, check_room
from ..prune.options import PruneOptions, TrainOptions, refuse_time_and_steps
from ..scene.camera import Camera
from ..scene.gaussians import Scene
from ..system.errors import FormatError, SceneError
from ..system.file_names import extended, is_link, remove_link
from ..system.foreign import open_regular, refuse_entry
from ..system.option_kinds import check_mapping
from ..system.replacing import patiently

SCHEMA = 1
BLOCKS = blocks.blocks_of(Path("recovered.ply")).name
HEARTBEAT = 2.0  # seconds between two writes of state.json
STALE = 15.0  # seconds: a process that has not renewed its state for so long is gone
LARGEST_JSON = 1 << 20  # bytes; larger files are not read
STOP = "stop"  # flag file
CAMERAS = "cameras.json"  # given views of a job without photographs
ENDED = ("queued", "stopped", "interrupted", "failed", "done")  # states without a process
PRUNE, TRAIN = "prune", "train"  # kinds of a job
OPTIONS = {PRUNE: PruneOptions, TRAIN: TrainOptions}
METRICS = ("iteration", "count", "loss", "psnr")
FACTS = {  # keys of state.json and of messages that are read, and their types
    "state": str, "text": str, "pid": int, "iteration": int, "total": int, "phase": str, "count": int,
    "loss": float, "psnr": float, "seconds_left": float, "finishing": bool, "note": str, "asked": float,
    "foreseen": float, "schedule": float, "share": float,
}  # fmt: skip
_FILES = (
    "state.json", "scene.ply", "recovered.ply", "messages.jsonl", "log.txt", "metrics.csv", "ranking.npz",
    "pruned.ply", "kept.npy", "score.npy", "probability.npy", "trained.ply", "*_exposure.json",
    "*_refined_cameras.json", "recovered.ply_distractor_masks/**/*.png", "result.json", MERGED, ORDER,
    CAMERAS, STOP, ".svrgs-*", "previews/[0-9]*.png", "previews/.svrgs-*", "job.json",
)  # fmt: skip


class JobFolder:
    """The files of one job, below `path`."""

    def __init__(self, path: str | Path):
        self.path = extended(path)

    @classmethod
    def create(
        cls, path: str | Path, scene: Scene, options: dict, name: str = "", cameras: Sequence[Camera] = ()
    ) -> JobFolder:
        """Creates the folder of a new job that will prune the scene. cameras: of the option `cameras`, in the
        scene's coordinates; they are stored in the folder. Raises SceneError if the folder is not empty or an
        option is wrong."""
        folder = cls._empty(path)
        _check_options(PRUNE, options)
        check_room(folder.path, scene, bool(options.get("quick")))
        rows = np.arange(scene.count, dtype=np.uint32)
        write_scene(folder / "scene.ply", replace(scene, attributes={**scene.attributes, ROW: rows}))
        if cameras:
            from ..views.cameras_json import write_cameras_json  # a Blender that only starts does not need it

            write_cameras_json(folder / CAMERAS, cameras)
        folder._write_request(PRUNE, name, scene.count, options, digest_of(scene))
        return folder

    @classmethod
    def create_training(cls, path: str | Path, options: dict, name: str = "") -> JobFolder:
        """Creates the folder of a new job that will train a splat. Raises SceneError as create()."""
        folder = cls._empty(path)
        _check_options(TRAIN, options)
        folder._write_request(TRAIN, name, 0, options)
        return folder

    @classmethod
    def _empty(cls, path: str | Path) -> JobFolder:
        """Raises SceneError if there is something in the folder."""
        folder = cls(path)
        if folder.path.exists() and any(folder.path.iterdir()):
            raise SceneError(f"{folder.path}: is not empty; each job needs a folder of its own")
        return folder

    def _write_request(self, kind: str, name: str, count: int, options: dict, digest: str = ""):
        request = {"schema": SCHEMA, "version": __version__, "kind": kind, "name": name, "count": count}
        self.write_json("job.json", request | {"digest": digest, "options": options})
        self.write_json("state.json", {"state": "new"})

    def __truediv__(self, name: str) -> Path:
        return self.path / name

    def request(self) -> dict:
        """job.json, checked: kind, name, count (0 for a job that trains), options. Raises FormatError."""
        request = self._json("job.json") or {}
        kind, count = request.get("kind"), request.get("count")
        if request.get("schema") != SCHEMA or kind not in (PRUNE, TRAIN):
            raise FormatError(f"{self / 'job.json'}: is no job of this version")
        if not isinstance(request.get("name"), str) or not _is(int, count) or count < (kind == PRUNE):
            raise FormatError(
                f"{self / 'job.json'}: the name of the splat or its number of Gaussians is missing"
            )
        try:
            _check_options(kind, request.get("options"))
        except SceneError as error:
            raise FormatError(f"{self / 'job.json'}: {error}") from None
        return request

    @property
    def kind(self) -> str:
        """PRUNE or TRAIN. Raises FormatError."""
        return self.request()["kind"]

    @property
    def output(self) -> Path:
        """The splat that a finished job leaves. Raises FormatError."""
        return self / ("trained.ply" if self.kind == TRAIN else "pruned.ply")

    def options(self) -> PruneOptions | TrainOptions:
        """All options of the job, with the paths of its input and output. Raises FormatError."""
        request = self.request()
        cls, paths = OPTIONS[request["kind"]], {"out": self / "recovered.ply"}
        if request["kind"] == PRUNE:
            paths["scene"] = self / "scene.ply"
            if (self / CAMERAS).is_file():
                paths["cameras"] = self / CAMERAS
        options = check_mapping(cls, request["options"])
        # a quick job has no checkpoints
        return cls(**(options | paths), resume=not options.get("quick"), quiet=True)

    def set_dataset(self, data: str):
        """Writes another folder of the dataset into job.json: it was moved. Raises FormatError,
        SceneError."""
        request = self.request()
        self.write_json("job.json", {**request, "options": {**request["options"], "data": data}})

    def refuse_links(self):
        """Raises FormatError if an entry of the folder is a link, a pipe or a device."""
        for entry in self._entries():
            refuse_entry(entry)

    def check_scene(self):
        """Raises FormatError if scene.ply of a job that prunes does not have the number of Gaussians that
        job.json says."""
        count, file = self.request()["count"], self / "scene.ply"
        try:
            with open_regular(file) as stream:
                elements = parse_header(stream.read(MAX_HEADER_BYTES)).elements
            (stored,) = [element.count for element in elements if element.name == "vertex"]
        except (OSError, ValueError, FormatError) as error:
            raise FormatError(f"{file}: cannot be read ({error}); discard the job and start again") from None
        if stored != count:
            raise FormatError(
                f"{file}: has {stored:,} Gaussians, but job.json says {count:,}; discard the job and start"
                " again"
            )

    def state(self) -> dict:
        """The keys of state.json. "state" is "interrupted" if the job has not ended but was not renewed for
        STALE seconds; "missing" without a job."""
        state = facts_of(self._json("state.json") or {})
        if "state" not in state:
            return {"state": "interrupted" if (self / "job.json").exists() else "missing"}
        if state["state"] not in ENDED and not self.alive():
            state["state"] = "interrupted"
        return state

    def alive(self) -> bool:
        """Whether state.json was renewed in the last STALE seconds."""
        with contextlib.suppress(OSError):
            return abs(time.time() - (self / "state.json").stat().st_mtime) < STALE
        return False

    def result(self) -> dict:
        """The JSON result of a finished job. Raises FormatError if there is none."""
        result = self._json("result.json")
        sides = ("before", "after") if self.kind == PRUNE else ()
        if result is None or not all(isinstance(result.get(side), dict) for side in sides):
            raise FormatError(f"{self.path}: holds no result")
        return result

    @property
    def merged(self) -> bool:
        """Whether the result of a finished job has merged Gaussians: then there is no ranking of the source
        Gaussians."""
        return bool(self.result().get("merged"))

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Of a finished job, for each source Gaussian: kept (N,) bool and score (N,) float32 (ranking.py).
        Raises FormatError."""
        return self._array("kept", bool), self._array("score", np.float32)

    def probability(self) -> np.ndarray | None:
        """Of a finished job, the probability of each source Gaussian, (N,) float32; None if no masks were
        learned. Raises FormatError."""
        return self._array("probability", np.float32) if (self / "probability.npy").exists() else None

    def metrics(self) -> dict[str, np.ndarray]:
        """The columns of metrics.csv by name, float64, NaN for missing values. Incomplete lines are
        skipped."""
        with (
            contextlib.suppress(OSError, UnicodeDecodeError, csv.Error),
            open_regular(self / "metrics.csv") as file,
        ):
            lines = list(csv.reader(io.StringIO(file.read(LARGEST_JSON).decode())))[1:]
            rows = [row for row in map(_numbers, lines) if len(row) == len(METRICS) and math.isfinite(row[0])]
            return dict(zip(METRICS, np.array(rows, np.float64).reshape(-1, len(METRICS)).T, strict=True))
        return {name: np.empty(0) for name in METRICS}

    def newest_preview(self) -> Path | None:
        """The newest preview; None if there is none yet."""
        return max((self / "previews").glob("[0-9]*.png"), default=None)

    def log_tail(self, lines: int = 5) -> list[str]:
        """The last lines of log.txt that are not blank."""
        with contextlib.suppress(OSError), open_regular(self / "log.txt") as file:
            file.seek(max(0, file.seek(0, io.SEEK_END) - 4096))
            tail = file.read().decode(errors="replace").splitlines()
            return [line for line in tail if line.strip()][-lines:]
        return []

    def write_json(self, name: str, value: dict):
        write_json(self / name, value, keep=False)

    def raise_flag(self):
        """Creates the flag file STOP."""
        (self / STOP).touch()

    def lower_flag(self):
        """Removes the flag file."""
        (self / STOP).unlink(missing_ok=True)

    def checkpoint(self) -> int:
        """The step of the newest checkpoint; 0 if there is none. Damaged checkpoints count: they are found
        when the job is resumed."""
        return max(
            (int(path.name) for path in self._checkpoints() if (path / "manifest.json").is_file()), default=0
        )

    def tasks(self) -> tuple[int, int]:
        """How many tasks of a job by blocks are done, and how many it has, 0 if that is not known or the job
        is none."""
        return tasks.progress(self / BLOCKS)

    def size(self) -> int:
        """Bytes on disk of the files in the folder. Links are not followed."""
        total = 0
        for entry in self._entries():
            with contextlib.suppress(OSError):  # removed meanwhile
                if entry.is_file(follow_symlinks=False):
                    total += entry.stat(follow_symlinks=False).st_size
        return total

    def discard(self):
        """Removes the files that the job wrote, and the folder if it is empty then. Of a link, only the link
        itself is removed.

        Raises FormatError if the folder holds no job.
        """
        if not (self / "job.json").is_file():
            raise FormatError(f"{self.path}: holds no job")
        masks = self / "recovered.ply_distractor_masks"
        for folder in (self / "previews", self / "recovered.ply.job", masks):
            remove_link(folder)  # else the patterns would be searched behind it
        for folder in [*masks.rglob("*")]:
            remove_link(folder)
        for checkpoint in self._checkpoints():
            shutil.rmtree(checkpoint, ignore_errors=True)
        blocks.remove(self / BLOCKS)
        for pattern in _FILES:
            for file in self.path.glob(pattern):
                file.unlink(missing_ok=True)
        within = sorted(masks.rglob("*"), reverse=True)
        for folder in (self / "recovered.ply.job", self / "previews", *within, masks, self.path):
            with contextlib.suppress(OSError):
                folder.rmdir()

    def _entries(self) -> Iterator[os.DirEntry]:
        """Files, folders and links in the folders of the job."""
        checkpoints = self / "recovered.ply.job"
        for folder in (
            self.path,
            self / "previews",
            self / "recovered.ply_distractor_masks",
            checkpoints,
            *checkpoints.glob("[0-9]" * 7),
            *blocks.folders(self / BLOCKS),
        ):
            with contextlib.suppress(FileNotFoundError, NotADirectoryError), os.scandir(folder) as entries:
                yield from entries

    def _checkpoints(self) -> Iterator[Path]:
        paths = self.path.glob("recovered.ply.job/" + "[0-9]" * 7)
        return (path for path in paths if path.is_dir() and not is_link(path))

    def _array(self, name: str, dtype: type) -> np.ndarray:
        """The array (N,) in NAME.npy, one value per source Gaussian. Raises FormatError if it is missing or
        has another shape or dtype."""
        file, count = self / f"{name}.npy", self.request()["count"]
        try:
            with open_regular(file) as stream:
                array = np.load(stream, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise FormatError(f"{file}: cannot be read ({error})") from None
        if array.shape != (count,) or array.dtype != dtype:
            raise FormatError(
                f"{file}: holds {array.dtype}{array.shape}; expected {np.dtype(dtype)}({count},)"
            )
        return array

    def _json(self, name: str) -> dict | None:
        """The JSON object in a file; None if the file is missing, too large or no JSON object."""
        with contextlib.suppress(OSError):
            return patiently(lambda: json_object(self / name, LARGEST_JSON))
        return None


def digest_of(scene: Scene) -> str:
    """Digest of all Gaussians: of means, scales, rotations, opacities and SH, as stored."""
    digest = hashlib.sha256()
    for array in (scene.means, scene.log_scales, scene.quats, scene.opacity_logits, scene.sh):
        digest.update(array.data)
    return digest.hexdigest()


def facts_of(message: dict) -> dict:
    """The entries of a message or of state.json that are in FACTS and have the right type."""
    return {name: value for name, value in message.items() if name in FACTS and _is(FACTS[name], value)}


def _check_options(kind: str, options: object):
    """Raises SceneError if these are not valid options of a job of this kind."""
    checked = check_mapping(OPTIONS[kind], options)
    if kind == TRAIN and not checked.get("data"):
        raise SceneError("the job has no dataset")
    refuse_time_and_steps(OPTIONS[kind], checked)


def _is(kind: type, value) -> bool:
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


def _numbers(row: list[str]) -> list[float]:
    try:
        return [float(value) if value else math.nan for value in row]
    except ValueError:
        return []

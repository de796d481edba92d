"""What lies in a job's folder, and nothing that is not the job's own is ever read, trusted or removed.

job.json       the request: schema, version, name, options
state.json     where the job is; replaced as a whole, at least every HEARTBEAT seconds while it runs
scene.ply      the splat as it was when the job began, each Gaussian with its row
messages.jsonl what the running process said, one JSON object a line;  log.txt its stderr
metrics.csv    iteration, count, loss, psnr;  previews/ITERATION.png
pruned.ply, kept.npy, score.npy, result.json   the result; result.json is written last;  probability.npy where masks were learned
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from .. import __version__
from ..errors import FormatError, SceneError
from ..files.atomic import atomic_write
from ..files.registry import write_scene
from ..finetune.methods import FORMER_NAMES
from ..option_kinds import check_mapping
from ..scene import Scene
from .options import PruneOptions

SCHEMA = 2
ROW = "svrgs_row"  # column of scene.ply
HEARTBEAT = 2.0  # seconds
STALE = 15.0  # seconds without a sign of life: whoever wrote the state is gone
LARGEST_JSON = 1 << 20
CANCEL, PAUSE = "cancel", "pause"  # flag files
ENDED = ("paused", "cancelled", "interrupted", "failed", "done")
METRICS = ("iteration", "count", "loss", "psnr")
FACTS = {  # of a job's state, and their types
    "state": str, "text": str, "pid": int, "iteration": int, "total": int, "phase": str, "count": int, "loss": float, "psnr": float,
    "seconds_left": float,
}  # fmt: skip
_FILES = (
    "state.json", "scene.ply", "recovered.ply", "messages.jsonl", "log.txt", "metrics.csv", "ranking.npz", "pruned.ply", "kept.npy",
    "score.npy", "probability.npy", "result.json", CANCEL, PAUSE, ".svrgs-*", "previews/[0-9]*.png", "previews/.svrgs-*", "job.json",
)  # fmt: skip


class JobFolder:
    """One job's files below `path`."""

    def __init__(self, path: str | Path):
        self.path = Path(path)

    @classmethod
    def create(cls, path: str | Path, scene: Scene, options: dict, name: str = "") -> JobFolder:
        """A new job that would prune the scene. Raises SceneError where the folder is in use or the options are not."""
        folder = cls(path)
        _check_options(options)
        if folder.path.exists() and any(folder.path.iterdir()):
            raise SceneError(f"{folder.path}: is not empty; each job has a folder of its own")
        rows = np.arange(scene.count, dtype=np.uint32)
        write_scene(folder / "scene.ply", replace(scene, attributes={**scene.attributes, ROW: rows}))
        folder.write_json("job.json", {"schema": SCHEMA, "version": __version__, "name": name, "count": scene.count, "options": options})
        folder.write_json("state.json", {"state": "new"})
        return folder

    def __truediv__(self, name: str) -> Path:
        return self.path / name

    def request(self) -> dict:
        """job.json, checked: name, count, options. Raises FormatError."""
        request = self._json("job.json")
        if request is None or request.get("schema") not in (1, SCHEMA):
            raise FormatError(f"{self / 'job.json'}: is no job of this version")
        if not isinstance(request.get("name"), str) or not _is(int, request.get("count")) or request["count"] < 1:
            raise FormatError(f"{self / 'job.json'}: does not say which splat it is about")
        try:
            _check_options(request.get("options"))
        except SceneError as error:
            raise FormatError(f"{self / 'job.json'}: {error}") from None
        return request

    def options(self) -> PruneOptions:
        """The options of the job, complete. Raises FormatError."""
        given = check_mapping(PruneOptions, self.request()["options"])
        return PruneOptions(**given, scene=self / "scene.ply", out=self / "recovered.ply", resume=True, quiet=True)

    def update_schema(self) -> str:
        """Brings a job of schema 1 up to date; says so in a sentence where its method is called otherwise now. Raises FormatError."""
        request = self.request()
        if request["schema"] == SCHEMA:
            return ""
        former = request["options"].get("method", "svr")
        present = FORMER_NAMES.get(former, former)
        self.write_json("job.json", {**request, "schema": SCHEMA, "options": {**request["options"], "method": present}})
        return f"Method '{former}' is called '{present}' now" if present != former else ""

    def state(self) -> dict:
        """state.json. Of a job that says it runs but shows no sign of life, "state" is "interrupted"; of no job, "missing"."""
        state = self._json("state.json")
        state = facts_of(state or {})
        if "state" not in state:
            return {"state": "interrupted" if (self / "job.json").exists() else "missing"}
        if state["state"] not in ENDED and not self.alive():
            state["state"] = "interrupted"
        return state

    def alive(self) -> bool:
        """Whether a process has written the state lately."""
        with contextlib.suppress(OSError):
            return abs(time.time() - (self / "state.json").stat().st_mtime) < STALE
        return False

    def result(self) -> dict:
        """The JSON result of a job that is done. Raises FormatError."""
        result = self._json("result.json")
        if result is None or not all(isinstance(result.get(side), dict) for side in ("before", "after")):
            raise FormatError(f"{self.path}: holds no result")
        return result

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Of a job that is done, per source Gaussian: kept (N,) bool, score (N,) float32. Raises FormatError."""
        return self._array("kept", bool), self._array("score", np.float32)

    def probability(self) -> np.ndarray | None:
        """Of a job that is done, (N,) float32: each source Gaussian's probability of existence; None where no masks were learned. Raises FormatError."""
        return self._array("probability", np.float32) if (self / "probability.npy").exists() else None

    def metrics(self) -> dict[str, np.ndarray]:
        """Columns of metrics.csv, float64; NaN where there is no value; of whole lines only."""
        with contextlib.suppress(OSError, UnicodeDecodeError, csv.Error), open(self / "metrics.csv") as file:
            lines = list(csv.reader(io.StringIO(file.read(LARGEST_JSON))))[1:]
            rows = [row for row in map(_numbers, lines) if len(row) == len(METRICS) and math.isfinite(row[0])]
            return dict(zip(METRICS, np.array(rows, np.float64).reshape(-1, len(METRICS)).T, strict=True))
        return {name: np.empty(0) for name in METRICS}

    def newest_preview(self) -> Path | None:
        """The picture drawn last; None: there is none yet."""
        return max((self / "previews").glob("[0-9]*.png"), default=None)

    def log_tail(self, lines: int = 5) -> list[str]:
        """The last lines of log.txt that say something."""
        with contextlib.suppress(OSError), open(self / "log.txt", "rb") as file:
            file.seek(max(0, file.seek(0, io.SEEK_END) - 4096))
            return [line for line in file.read().decode(errors="replace").splitlines() if line.strip()][-lines:]
        return []

    def write_json(self, name: str, value: dict):
        with atomic_write(self / name) as file:
            file.write(json.dumps(value).encode())

    def ask(self, flag: str):
        """Raises the flag CANCEL or PAUSE."""
        (self / flag).touch()

    def lower_flags(self):
        for flag in (CANCEL, PAUSE):
            (self / flag).unlink(missing_ok=True)

    def discard(self):
        """Removes what the job wrote, and the folder where nothing else is in it. Raises FormatError where there is no job."""
        if not (self / "job.json").is_file():
            raise FormatError(f"{self.path}: holds no job")
        for checkpoint in self._checkpoints():
            shutil.rmtree(checkpoint, ignore_errors=True)
        for pattern in _FILES:
            for file in self.path.glob(pattern):
                file.unlink(missing_ok=True)
        for folder in (self / "recovered.ply.job", self / "previews", self.path):
            with contextlib.suppress(OSError):
                folder.rmdir()

    def _checkpoints(self) -> Iterator[Path]:
        return (path for path in self.path.glob("recovered.ply.job/" + "[0-9]" * 7) if path.is_dir() and not path.is_symlink())

    def _array(self, name: str, dtype: type) -> np.ndarray:
        """(N,) numbers, one a source Gaussian. Raises FormatError."""
        file, count = self / f"{name}.npy", self.request()["count"]
        try:
            array = np.load(file, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise FormatError(f"{file}: cannot be read ({error})") from None
        if array.shape != (count,) or array.dtype != dtype:
            raise FormatError(f"{file}: holds {array.dtype}{array.shape}; expected {np.dtype(dtype)}({count},)")
        return array

    def _json(self, name: str) -> dict | None:
        """The object in a file; None where there is none."""
        try:
            if (self / name).stat().st_size > LARGEST_JSON:
                return None
            value = json.loads((self / name).read_bytes())
        except (OSError, ValueError, RecursionError):
            return None
        return value if isinstance(value, dict) else None


def facts_of(message: dict) -> dict:
    """What a message or a state says that is a fact of the right type."""
    return {name: value for name, value in message.items() if name in FACTS and _is(FACTS[name], value)}


def _check_options(options: object):
    """Raises SceneError where these are no options of a job."""
    if not check_mapping(PruneOptions, options).get("colmap"):
        raise SceneError("the job does not say where its photographs are")


def _is(kind: type, value) -> bool:
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


def _numbers(row: list[str]) -> list[float]:
    try:
        return [float(value) if value else math.nan for value in row]
    except ValueError:
        return []

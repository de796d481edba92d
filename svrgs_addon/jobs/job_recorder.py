"""What a background job writes into its folder: metrics and previews while it runs, and the result at the
end. A job that prunes also writes a ranking of the Gaussians."""

from __future__ import annotations

import contextlib
import time
from dataclasses import asdict, replace
from typing import Protocol

import numpy as np

from ..files.atomic import atomic_write, write_array, write_bytes
from ..files.images import to_bytes
from ..files.registry import load_scene, read_scene, write_scene
from ..finetune import loop, masks
from ..finetune.run import Run
from ..prune.context import JobContext
from ..prune.disk_room import ROW
from ..prune.report.pictures import png_bytes
from ..render.metrics.evaluate import picture_options
from ..scene.gaussians import Scene
from ..system.errors import FormatError, SceneError
from ..system.exit_status import plain
from ..system.replacing import replace as replace_file
from .job_folder import METRICS, PRUNE, TRAIN, JobFolder
from .ranking import VIEWS as IMPORTANCE_VIEWS
from .ranking import Ranking, importance

PREVIEW_SIDE = 512  # longest side of a preview, pixels
METRIC_ROWS = 200  # rows of metrics.csv for a whole run, roughly
METRICS_EVERY = 1.0  # seconds between two writes of it
# views that are rendered: for each point of the curves, and at the end of a job that prunes
RECORDED = (1, IMPORTANCE_VIEWS)


class Listener(Protocol):
    """The receiver of messages: job_main.JobMain."""

    def tell(self, kind: str, **facts): ...

    def progress(self, stage: str, label: str, **facts): ...


class JobRecorder:
    """Records one run. Call begin() before its first step, observe() after each step, finish() with the job's
    result, or flush() where it is stopped."""

    _unwritten = False  # whether metrics.csv lacks lines

    def __init__(self, folder: JobFolder, listener: Listener):
        self.folder, self.listener = folder, listener

    def attached(self, job: JobContext) -> JobContext:
        """The context of the job, with this recorder as its observer."""
        return replace(
            job,
            order=self.folder.path,
            begin=self.begin,
            observe=self.observe,
            part=lambda text, share: self.listener.progress("looping", text, share=share),
            tell=lambda planned, _: self.listener.tell("STATUS", **asdict(planned)),
            recorded=RECORDED,
        )

    def begin(self, run: Run, notes: list[str]):
        self.run = run
        self._points = len(run.curves.iteration)
        old = self.folder.metrics()
        rows = [row for row in zip(*(old[name] for name in METRICS), strict=True) if row[0] <= run.iteration]
        self._metrics = [",".join(METRICS), *map(_line, rows)]
        self._write_metrics()
        if notes:
            self.listener.tell("STATUS", note="; ".join(notes))

    def observe(self, progress: loop.Progress):
        run, curves = self.run, self.run.curves
        new_point = len(curves.iteration) > self._points
        psnr = curves.psnr[-1] if curves.psnr else None
        count = int(masks.most_probable(run.model).sum()) if run.model.learns_masks else run.model.count
        if new_point or progress.iteration % max(1, progress.total // METRIC_ROWS) == 0:
            row = progress.iteration, count, progress.loss, psnr if new_point else None
            self._metrics.append(_line(row))
            self._unwritten = True
            if new_point or run.finished or time.monotonic() > self._stored + METRICS_EVERY:
                self._write_metrics()
        if new_point:
            self._points = len(curves.iteration)
            self._preview(progress.iteration)
        self.listener.progress(
            "finishing" if run.finished else "looping",
            progress.label,
            iteration=progress.iteration,
            total=progress.total,
            phase=progress.phase,
            count=count,
            loss=round(progress.loss, 6),
            psnr=psnr,
            seconds_left=round(progress.seconds_left, 1),
        )

    def finish(self, result: dict) -> dict:
        """Writes the files of the result, result.json last. Returns the JSON result."""
        raise NotImplementedError

    def _write_result(self, result: dict) -> dict:
        """Writes result.json and returns its contents."""
        result = plain(result)
        self.folder.write_json("result.json", result)
        return result

    def _preview(self, iteration: int):
        run: Run = self.run
        views = run.dataset.test_indices or run.dataset.train_indices
        camera = run.dataset.cameras[views[0]]
        camera = camera.reduced(max(1, -(-max(camera.width, camera.height) // PREVIEW_SIDE)))
        kept = masks.most_probable(run.model).astype(np.uint8) if run.model.learns_masks else None
        options = picture_options(run.model, run.plan.background)
        name = f"previews/{iteration:07d}.png"
        rgb = run.engine.rasterizer.forward(run.model, camera, options, kept)["rgb"]
        write_bytes(self.folder / name, png_bytes(to_bytes(rgb)))
        self.listener.tell("PREVIEW", path=name)

    def flush(self):
        """Writes what metrics.csv lacks."""
        if self._unwritten:
            self._write_metrics()

    def _write_metrics(self):
        self._stored = time.monotonic()
        # the next one holds these lines too
        with contextlib.suppress(SceneError), atomic_write(self.folder / "metrics.csv", keep=False) as file:
            file.write(("\n".join(self._metrics) + "\n").encode())
            self._unwritten = False


class TrainRecorder(JobRecorder):
    """Records a job that trains."""

    def finish(self, result: dict) -> dict:
        replace_file(self.folder / "recovered.ply", self.folder.output)
        return self._write_result(result | {"out": str(self.folder.output)})


class PruneRecorder(JobRecorder):
    """Records a job that prunes, and how it ranks the Gaussians of the splat."""

    def __init__(self, folder: JobFolder, listener: Listener):
        super().__init__(folder, listener)
        folder.check_scene()
        self.count = folder.request()["count"]
        self.ranking = Ranking(self.count, folder / "ranking.npz")
        self.merged = True  # until a run begins: the quick way has none

    def begin(self, run: Run, notes: list[str]):
        self.merged = run.method.merges and ROW not in run.model.metadata["attributes"]
        if not self.merged:
            self.ranking.begin(run, self._checked_rows(run.model.metadata["attributes"].get(ROW)))
        super().begin(run, notes)

    def observe(self, progress: loop.Progress):
        if not self.merged:
            self.ranking.observe(self.run)
        super().observe(progress)

    def finish(self, result: dict) -> dict:
        """As JobRecorder.finish(); the file sizes of the result are those without the column of source
        rows."""
        recovered = read_scene(self.folder / "recovered.ply")
        if self.merged:
            return self._write_pruned(recovered, result | {"merged": True})
        rows = recovered.attributes[ROW]
        kept = np.zeros(self.count, bool)
        kept[rows] = True
        rank = np.zeros(self.count, np.float32)
        source = load_scene(self.folder / "scene.ply")
        source_rows = self._checked_rows(source.attributes.get(ROW))
        rank[source_rows] = importance(source, self.run.dataset, self.run.plan.background)
        if self.run.plan.nested:  # its rows are in the order of importance
            rank[rows] = np.linspace(1, 0, recovered.count, dtype=np.float32)
            recovered = recovered.select(np.argsort(rows))
        write_array(self.folder / "kept.npy", kept)
        write_array(
            self.folder / "score.npy", self.ranking.scores(kept, rank, nested=self.run.plan.nested > 0)
        )
        probability = self.ranking.probabilities()
        if probability is not None:
            write_array(self.folder / "probability.npy", probability)
        return self._write_pruned(recovered, result)

    def _write_pruned(self, recovered: Scene, result: dict) -> dict:
        """Writes the splat and result.json, and deletes recovered.ply. Returns the JSON result."""
        pruned = self.folder / "pruned.ply"
        write_scene(pruned, without_rows(recovered))
        result |= {"out": str(pruned), "bytes": pruned.stat().st_size}
        result["after"] = result["after"] | {"bytes": result["bytes"]}
        rows = 4 * self.count + len(f"property uint {ROW}\n")  # bytes of their column
        result["before"] = result["before"] | {"bytes": result["before"]["bytes"] - rows}
        result = self._write_result(result)
        (self.folder / "recovered.ply").unlink()
        return result

    def _checked_rows(self, rows: np.ndarray | None) -> np.ndarray:
        """The column ROW (N,). Raises FormatError if it is missing, or if it does not hold rows of the
        source, each at most once."""
        if (
            rows is None
            or rows.dtype.kind != "u"
            or rows.max(initial=0) >= self.count
            or len(np.unique(rows)) < len(rows)
        ):
            raise FormatError(
                f"{self.folder / 'scene.ply'}: its column {ROW} does not name the rows of the splat; discard"
                " the job and start again"
            )
        return rows


RECORDERS: dict[str, type[JobRecorder]] = {PRUNE: PruneRecorder, TRAIN: TrainRecorder}  # by kind of the job


def without_rows(scene: Scene) -> Scene:
    """The scene without the column of source rows (ROW)."""
    attributes = {name: column for name, column in scene.attributes.items() if name != ROW}
    order = tuple(name for name in scene.property_order if name != ROW)
    return replace(scene, attributes=attributes, property_order=order)


def _line(row) -> str:
    values = [None if value is None or value != value else value for value in row]
    return ",".join(
        "" if value is None else f"{value:.6g}" if i > 1 else str(int(value))
        for i, value in enumerate(values)
    )

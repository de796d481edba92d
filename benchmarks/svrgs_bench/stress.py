"""`svrgs bench --stress`: worst image and gradient errors of extreme scenes, and the drift of float32 over
1,000 fine-tuning steps.

All errors are those against the float64 level. No value may be non-finite.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from svrgs_addon.finetune.engine import NativeEngine, Step
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.settings import Rates
from svrgs_addon.native.library import best_level
from svrgs_addon.native.rasterizer import RenderOptions, sample_masks
from svrgs_addon.prune.report.point_chart import Axis, Point, chart

from .accuracy import error
from .cases import Case, room_case
from .stress_rows import Row, extremes, rows

DRIFT_STEPS = (1, 3, 10, 30, 100, 300, 1000)
EXTENT = 5.0  # of the generated room, for the position rate


def measure_stress(
    progress: Callable[[str], None],
    level: str | None = None,
    drift_steps: Sequence[int] = DRIFT_STEPS,
    case: Case | None = None,
) -> list[dict]:
    """One entry per row: row (its name), title, quantity; the worst image_max, grad_rel_l2 and crossed; the
    sum of nonfinite; `points`. case: a scene and a view that alone are measured, with extremes in them."""
    entries = []
    for row in [extremes(case)] if case else rows():
        entries.append(
            _entry(
                row.name, row.title, row.quantity, [_point(row, value, level) for value in row.values], row
            )
        )
        progress(
            "{title}: image error {image_max:.1e}, gradient error {grad_rel_l2:.1e},"
            " not finite {nonfinite}".format(**entries[-1])
        )
    if drift_steps and not case:
        progress(f"{max(drift_steps)} fine-tuning steps in float32 and in float64")
        entries.append(
            _entry("drift", "float32 against float64 while fine-tuning", "steps", measure_drift(drift_steps))
        )
    return entries


def _point(row: Row, value, level: str | None) -> dict:
    made = row.make(value)
    with np.errstate(over="ignore", invalid="ignore"):
        found = error(made.case, level, masks=made.masks, lambda_f=made.lambda_f, full=True)
    return {
        "value": value if row.numeric else _label(value),
        **{key: found[key] for key in ("image_max", "grad_rel_l2", "crossed", "nonfinite")},
    }


def _label(value) -> str:
    return " x ".join(map(str, value)) if isinstance(value, tuple) else f"{value:.5g}"


def _entry(name: str, title: str, quantity: str, points: list[dict], row: Row | None = None) -> dict:
    worst = {key: max(point[key] for point in points) for key in ("image_max", "grad_rel_l2", "crossed")}
    return {
        "row": name, "title": title, "quantity": quantity, **worst,
        "nonfinite": sum(point["nonfinite"] for point in points),
        "logarithmic": row is None or row.logarithmic, "points": points,
    }  # fmt: skip


def measure_drift(
    steps: Sequence[int] = DRIFT_STEPS, count: int = 400, size: tuple[int, int] = (64, 48)
) -> list[dict]:
    """Compares two runs of the same steps, one in float32 and one in float64.

    image_max: largest difference between their renderings of the training view. grad_rel_l2: distance between
    their parameters over the distance that the float64 run has moved.
    """
    case = room_case(count, 1, *size)
    runs = [_Tuned(case, level) for level in (best_level(), "float64")]
    start, points = runs[1].parameters(), []
    for number in range(1, max(steps) + 1):
        for run in runs:
            run.step(number)
        if number in steps:
            ours, exact = (run.parameters() for run in runs)
            images = [run.image() for run in runs]
            points.append({
                "value": number,
                "image_max": float(np.abs(images[0] - images[1]).max()),
                "grad_rel_l2": float(np.linalg.norm(ours - exact) / np.linalg.norm(exact - start)),
                "crossed": 0.0,
                "nonfinite": sum(int((~np.isfinite(array)).sum()) for array in (ours, *images)),
            })  # fmt: skip
    return points


class _Tuned:
    """A scene that learns a mirrored picture of itself in one view, with masks that are sampled in each
    step."""

    def __init__(self, case, level: str):
        self.engine, self.camera = NativeEngine(level), case.camera
        self.model = Model.of(case.scene, self.engine.rasterizer.dtype)
        self.model.add_masks(9.0)
        self.target = np.ascontiguousarray(np.clip(self.image()[:, ::-1], 0, 1))

    def step(self, number: int):
        masks, slope = sample_masks(self.model.mask_logits.astype(np.float32), 0, number)
        step = Step(
            self.camera, self.target, number, Rates().at(number, EXTENT), RenderOptions(mask_kind="svr"),
            masks=masks,
            slope=slope.astype(self.model.dtype), lambda_f=1e-3,
        )  # fmt: skip
        self.engine.step(self.model, step)

    def image(self) -> np.ndarray:
        return self.engine.rasterizer.forward(self.model, self.camera)["rgb"]

    def parameters(self) -> np.ndarray:
        """All parameters as one flat float64 array."""
        return np.concatenate([value.astype(np.float64).ravel() for value in self.model.values.values()])


def stress_charts(entries: list[dict]) -> dict[str, str]:
    """One chart per row: {file name without suffix: SVG document}. Gradient errors are dots, image errors are
    rings."""
    return {f"stress-{entry['row']}": _chart(entry) for entry in entries}


def _chart(entry: dict) -> str:
    """The chart of one row. Values that are not numbers are placed side by side with labels."""
    numeric = not isinstance(entry["points"][0]["value"], str)
    places = [point["value"] if numeric else i for i, point in enumerate(entry["points"])]
    labels = ["" if numeric else point["value"] for point in entry["points"]]
    gradient = [
        Point(x, point["grad_rel_l2"], label)
        for x, label, point in zip(places, labels, entry["points"], strict=True)
    ]
    image = [
        replace(dot, y=point["image_max"], label="")
        for dot, point in zip(gradient, entry["points"], strict=True)
    ]
    error_axis = Axis("error against float64: dots gradient, rings image", log=True)
    return chart(
        entry["title"],
        gradient,
        Axis(entry["quantity"], log=entry["logarithmic"] and numeric),
        error_axis,
        rings=image,
    )

"""The metrics of a job as a small picture for Blender's panel: number of Gaussians above, PSNR below, over
iterations."""

from __future__ import annotations

import numpy as np

SIDE = 256  # pixels
GROUND, GRID = (0.11, 0.11, 0.11, 1.0), (0.2, 0.2, 0.2, 1.0)
COLORS = {"count": (0.35, 0.65, 1.0, 1.0), "psnr": (1.0, 0.65, 0.25, 1.0)}
MARGIN = 0.08  # share of a chart's height that is free above and below its line
THICK = 2  # thickness of a line, pixels


def draw(metrics: dict[str, np.ndarray], total: int) -> np.ndarray:
    """The picture, (SIDE, SIDE, 4) float32 RGBA, bottom row first as in Blender. metrics: columns of
    metrics.csv; total: iterations of the run."""
    picture = np.empty((SIDE, SIDE, 4), np.float32)
    picture[:] = GROUND
    half = SIDE // 2
    for name, part in (("psnr", picture[:half]), ("count", picture[half:])):
        part[:: half // 4] = GRID
        known = np.isfinite(metrics[name])
        share = np.clip(metrics["iteration"][known] / max(1, total), 0, 1)
        _line(part, share, metrics[name][known], COLORS[name])
    return picture


def _line(part: np.ndarray, x: np.ndarray, y: np.ndarray, color: tuple):
    """Draws y over x (0..1) into a part (H, W, 4) of the picture. The line fills the height, whatever the
    range of y."""
    if not len(x):
        return
    height, width = part.shape[:2]
    low, high = y.min(), y.max()
    share = (y - low) / (high - low) if high > low else np.full(len(y), 0.5)
    columns = np.arange(int(x[0] * (width - 1)), int(x[-1] * (width - 1)) + 1)
    heights = (MARGIN + (1 - 2 * MARGIN) * share) * (height - THICK)
    rows = np.interp(columns / (width - 1), x, heights).astype(int)
    for column, row, before in zip(columns, rows, np.r_[rows[:1], rows[:-1]], strict=True):
        part[min(row, before) : max(row, before) + THICK, column] = color

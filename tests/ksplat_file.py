"""Writes a .ksplat for the tests: the product reads this format alone."""

from __future__ import annotations

import numpy as np

from svrgs_addon.scene.gaussians import SH_COEFFICIENTS, Scene

BANDS = tuple(zip(SH_COEFFICIENTS[:-1], SH_COEFFICIENTS[1:], strict=True))  # of SH degree 1, 2, 3


def ksplat_of(sections: list[Scene], level: int, bucket: int = 10, block: float = 8.0) -> bytes:
    """A .ksplat with buckets in which the Gaussians lie as they come. Header fields as GaussianSplats3D
    numbers them."""
    head, heads, bodies = np.zeros(1024, "<u4"), [], []
    head[:6] = 1 << 8, len(sections), len(sections), 40, sum(scene.count for scene in sections), level
    for scene in sections:
        full, left = divmod(scene.count, bucket)
        starts = np.arange(0, scene.count, bucket)
        centres = np.array([scene.means[start : start + bucket].mean(axis=0) for start in starts], "<f4")
        rows = np.zeros(256, "<u4")
        rows[:4] = scene.count, scene.count, bucket, len(starts) if level else 0
        rows[4:5].view("<f4")[0], rows[5], rows[6] = block, 12, 32767
        rows[8:11] = full if level else 0, bool(left) if level else 0, scene.sh_degree
        heads.append(rows.tobytes())
        steps = (
            np.rint((scene.means - np.repeat(centres, bucket, axis=0)[: scene.count]) / (block / 2 / 32767))
            + 32767
        )
        kinds = ("<f4", "<f4", "<f4") if level == 0 else ("<u2", "<f2", "<f2" if level == 1 else "u1")
        bands = [
            scene.sh[:, first:last].transpose(0, 2, 1).reshape(scene.count, -1)
            for first, last in BANDS[: scene.sh_degree]
        ]
        rest = np.concatenate([np.zeros((scene.count, 0), np.float32), *bands], axis=1)
        colors = np.clip(np.rint(255 * (0.28209479 * scene.sh[:, 0] + 0.5)), 0, 255)
        alphas = 255 / (1 + np.exp(-scene.opacity_logits))
        parts = [
            (steps if level else scene.means).astype(kinds[0]),
            np.exp(scene.log_scales).astype(kinds[1]),
            scene.quats.astype(kinds[1]),
            np.rint(np.column_stack([colors, alphas])).astype("u1"),
            (rest if level < 2 else np.rint((rest + 1.5) / 3 * 255)).astype(kinds[2]),
        ]
        buckets = (np.array([left] if left else [], "<u4").tobytes() + centres.tobytes()) if level else b""
        bodies.append(
            buckets
            + np.concatenate([part.view("u1").reshape(scene.count, -1) for part in parts], axis=1).tobytes()
        )
    return b"".join([head.tobytes(), *heads, *bodies])

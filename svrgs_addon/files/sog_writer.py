"""Writes SOG version 2 (sog_layout.py), as a folder or as a bundle.

Tables and the palette of SH are those with the least error in the picture: a Gaussian weighs as much as its
colour does there (picture_weights).
"""

from __future__ import annotations

import json
import os
import secrets
import tempfile
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..scene.gaussians import Scene
from ..scene.morton_order import morton_order
from ..system import memory
from ..system.errors import SceneError
from . import sog_layout as layout
from .atomic import atomic_path, atomic_write, check_space, write_bytes
from .images import write_texture
from .palette import nearest, palette, refined, table
from .quantised import COARSE, alphas_of, picture_weights, small_scale, three_of_quats, to_uint8
from .sh_rounding import SeenFrom, higher_factors, rounded
from .sog_layout import META

SHARES = (64, 16, 4)  # Gaussians for each entry of the palette: the first one whose error is small enough
SMALL_ERROR = 2.5e-3  # weighted mean of the squared errors of all coefficients: about 50 dB in a picture
SHARES_SEEN, SMALL_SEEN_ERROR = (64, 16, 8, 4, 3), 1.4e-4  # the same for the error that views see
LARGEST_SCALES = 1e-4  # share as of picture_weights, for scales: those of the sky show in every picture
SAMPLE = 1 << 15  # Gaussians by which it is chosen
MIN_ENTRIES = 1024
FARTHEST = 1e30  # positions beyond are written as if they were there
BYTES = 40  # free space per Gaussian that is asked for
PART = 1 << 14  # Gaussians that are corrected together
FIRST_DATE = (1980, 1, 1, 0, 0, 0)  # of the files in a bundle: the same scene gives the same bytes

Factors = Callable[[slice | np.ndarray], np.ndarray]  # of some rows: see palette.refined


@dataclass(frozen=True)
class _Higher:
    """The palette of SH of degree 1 to 3."""

    levels: list[float]  # its table
    entries: np.ndarray  # (E, K-1, 3) uint8: rows of the table
    labels: np.ndarray  # (N,) int64: the entry of each Gaussian

    @property
    def image(self) -> np.ndarray:
        """The texture, (H, W, 3) uint8."""
        count, coefficients, _ = self.entries.shape
        heights = -(-max(count, 1) // layout.PALETTE_ROW)
        image = np.zeros((heights * layout.PALETTE_ROW, coefficients, 3), np.uint8)
        image[:count] = self.entries
        return image.reshape(heights, -1, 3)


def write(path: str | os.PathLike, scene: Scene, quantise: float = 1.0, seen: SeenFrom | None = None):
    """Writes the scene with its Gaussians in Morton order, as a bundle, or, if the name is meta.json, as the
    files of a folder, this one last. quantise: factor on SMALL_ERROR's root. seen: from where, if it is
    known: the palette is then that of the least error there, and colours take up the rest. Raises
    SceneError."""
    order = morton_order(scene.means)
    write_in_order(path, scene.select(order), quantise, seen.select(order) if seen else None)


def write_in_order(
    path: str | os.PathLike, scene: Scene, quantise: float = 1.0, seen: SeenFrom | None = None
):
    """As write(), with the Gaussians in the order of the scene."""
    check_space(path, BYTES * scene.count)
    if sentence := memory.shortage(
        f"{path}: writing so many Gaussians into one SOG", memory.texturing(scene.count, scene.sh.shape[1])
    ):
        raise SceneError(sentence)
    meta, textures = encoded(scene, quantise, seen)
    if Path(path).name == META:
        _write_folder(Path(path), meta, textures)
    else:
        _write_bundle(path, meta, textures)


def limits(scene: Scene) -> list[str]:
    """A sentence if steps of positions show."""
    if not scene.count:
        return []
    stored, small = np.abs(_stored(scene.means)), small_scale(scene)
    step = float(np.ptp(_stored(scene.means), axis=0).max() / layout.HIGHEST * np.exp(np.median(stored)))
    if step <= small / COARSE:
        return []
    return [
        f"positions are stored in steps of {step:.2g}, because some lie {np.expm1(stored.max()):g} away, and"
        f" small Gaussians have a scale of {small:.2g}: remove those far away first (svrgs select), or write"
        " another format"
    ]


def encoded(
    scene: Scene, quantise: float = 1.0, seen: SeenFrom | None = None
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """meta.json and the textures by name, (H, W, 3 or 4) uint8."""
    weights, higher, base = picture_weights(scene), None, scene.sh[:, 0]
    if scene.sh_degree:
        higher = _higher_bands(scene, weights, quantise, seen)
        base = _corrected(scene, higher, seen) if seen else base
    means, ranges = _means(scene)
    three, largest = three_of_quats(scene.quats)
    three = to_uint8((three / layout.ROOT2 + np.float32(0.5)) * 255)
    quats = np.column_stack([three, (layout.LARGEST_QUAT + largest).astype(np.uint8)])
    logs, scales = _by_table(scene.log_scales, picture_weights(scene, LARGEST_SCALES))
    colors, sh0 = _by_table(base, weights)
    pixels = {
        "means_l": means & 255,
        "means_u": means >> 8,
        "scales": scales,
        "quats": quats,
        "sh0": np.column_stack([sh0, alphas_of(scene.opacity_logits)]),
    }
    meta: dict[str, Any] = {
        "version": layout.VERSION,
        "asset": {"generator": f"SVR-GS {__version__}"},
        "count": scene.count,
        **({"antialias": True} if scene.antialiased else {}),
        "means": {**ranges, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": logs, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colors, "files": ["sh0.webp"]},
    }
    textures = {}
    if higher:
        meta["shN"] = {
            "count": len(higher.entries),
            "bands": scene.sh_degree,
            "codebook": higher.levels,
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        }
        textures["shN_centroids"] = higher.image
        pixels["shN_labels"] = np.column_stack([higher.labels & 255, higher.labels >> 8, 0 * higher.labels])
    textures.update({name: _texture(rows.astype(np.uint8)) for name, rows in pixels.items()})
    return meta, textures


def _means(scene: Scene) -> tuple[np.ndarray, dict[str, list[float]]]:
    """16 bits of each coordinate, (N, 3) int64, and their range."""
    stored = _stored(scene.means)
    low, high = (stored.min(axis=0), stored.max(axis=0)) if scene.count else (np.zeros(3), np.zeros(3))
    low, high = low.astype(np.float32).astype(np.float64), high.astype(np.float32).astype(np.float64)
    shares = (stored - low) / np.where(high > low, high - low, 1)
    whole = np.clip(np.rint(shares * layout.HIGHEST), 0, layout.HIGHEST).astype(np.int64)
    return whole, {"mins": low.tolist(), "maxs": high.tolist()}


def _stored(means: np.ndarray) -> np.ndarray:
    """sign(x) log(1 + |x|) of coordinates, float64."""
    whole = np.clip(np.nan_to_num(means.astype(np.float64)), -FARTHEST, FARTHEST)
    return np.sign(whole) * np.log1p(np.abs(whole))


def _by_table(values: np.ndarray, weights: np.ndarray) -> tuple[list[float], np.ndarray]:
    """The table of three columns (N, 3) and the row of each value, (N, 3) uint8."""
    values, levels = np.nan_to_num(values, posinf=80, neginf=-80), np.zeros(layout.TABLE, np.float32)
    if len(values):
        levels = table(values.reshape(-1), np.repeat(weights, 3), layout.TABLE)
    return levels.tolist(), nearest(values, levels)


def _higher_bands(scene: Scene, weights: np.ndarray, quantise: float, seen: SeenFrom | None) -> _Higher:
    coefficients = scene.sh.shape[1] - 1
    rows = np.nan_to_num(scene.sh[:, 1:].reshape(scene.count, -1), posinf=1, neginf=-1)
    factors = partial(_factors, scene, weights, seen) if seen else None
    size = min(layout.MAX_ENTRIES, max(MIN_ENTRIES, scene.count // _share(rows, weights, quantise, factors)))
    entries, labels = palette(rows, weights, size, layout.MAX_ENTRIES)
    if factors and not np.array_equal(entries[labels], rows):  # it came out of a palette
        shape = (-1, coefficients, 3)
        entries, labels = refined(rows.reshape(shape), entries.reshape(shape), labels, factors)
    used = np.bincount(labels, weights, len(entries)).astype(np.float32)
    levels, stored = _by_table(entries.reshape(-1, 3), np.repeat(used, coefficients))
    return _Higher(levels, stored.reshape(len(entries), coefficients, 3), labels)


def _corrected(scene: Scene, higher: _Higher, seen: SeenFrom) -> np.ndarray:
    """SH of degree 0 (N, 3) that take up what the palette changes in the directions from which Gaussians are
    seen."""
    entries, base = np.array(higher.levels, np.float32)[higher.entries], np.empty_like(scene.sh[:, 0])
    for start in range(0, scene.count, PART):
        part = slice(start, start + PART)
        moments = seen.select(part).moments(scene.means[part], scene.sh.shape[1])
        # all values of the first coefficient can be stored, of others those of the palette
        stored = lambda k, values, held=entries[higher.labels[part]]: held[:, k - 1] if k else values
        base[part] = rounded(scene.sh[part], moments, stored)[:, 0]
    return base


def _factors(scene: Scene, weights: np.ndarray, seen: SeenFrom, some: slice | np.ndarray) -> np.ndarray:
    """(n, K-1, K-1): F of some Gaussians for palette.refined, which weighs their errors as pictures do."""
    moments = seen.select(some).moments(scene.means[some], scene.sh.shape[1])
    return higher_factors(moments) * np.sqrt(weights[some])[:, None, None]


def _share(rows: np.ndarray, weights: np.ndarray, quantise: float, factors: Factors | None) -> int:
    """One of SHARES, or of SHARES_SEEN if factors are given, by a part of the rows."""
    some = np.random.default_rng(0).permutation(len(rows))[:SAMPLE]
    part, mass = rows[some], weights[some]
    shares, small = (SHARES_SEEN, SMALL_SEEN_ERROR) if factors else (SHARES, SMALL_ERROR)
    F = factors(some) if factors else np.sqrt(mass)[:, None, None]
    for share in shares[:-1]:
        entries, labels = palette(part, mass, max(1, len(some) // share), 0)
        wrong = (part - entries[labels]).reshape(len(some), -1, 3)
        error = np.square(F @ wrong if factors else F * wrong).sum()
        if error <= small * quantise**2 * mass.sum():
            return share
    return shares[-1]


def _texture(rows: np.ndarray) -> np.ndarray:
    """An image of rows (N, C), nearly square, its sides multiples of four; an alpha of what follows is
    255."""
    width = 4 * max(1, int(np.ceil(np.sqrt(len(rows)) / 4)))
    height = 4 * max(1, -(-len(rows) // (4 * width)))
    image = np.zeros((height * width, rows.shape[1]), np.uint8)
    image[: len(rows)] = rows
    image[len(rows) :, 3:] = 255
    return image.reshape(height, width, -1)


def _write_folder(path: Path, meta: dict[str, Any], textures: dict[str, np.ndarray]):
    """Writes the textures, then meta.json, and removes those that an older meta.json named. Until then, the
    older one stays as it is."""
    old = layout.files_of(path)[1:]
    tag = f".{secrets.token_hex(4)}" if old else ""
    text = json.dumps(meta)
    for name in textures:
        text = text.replace(f'"{name}.webp"', f'"{name}{tag}.webp"')

    def write_one(name: str):
        texture = path.parent / f"{name}{tag}.webp"
        with atomic_path(texture) as temporary:
            write_texture(temporary, texture, textures[name])

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(write_one, textures))
    write_bytes(path, text.encode())
    for texture in old:
        texture.unlink(missing_ok=True)


def _write_bundle(path: str | os.PathLike, meta: dict[str, Any], textures: dict[str, np.ndarray]):
    with atomic_write(path) as file, tempfile.TemporaryDirectory() as temp_dir:
        files = {name: Path(temp_dir) / f"{name}.webp" for name in sorted(textures)}
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            list(threads.map(lambda name: write_texture(files[name], path, textures[name]), textures))
        with zipfile.ZipFile(file, "w") as bundle:
            bundle.writestr(zipfile.ZipInfo(META, FIRST_DATE), json.dumps(meta))
            for texture in files.values():
                bundle.writestr(zipfile.ZipInfo(texture.name, FIRST_DATE), texture.read_bytes())

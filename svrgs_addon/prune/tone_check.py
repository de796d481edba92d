"""Whether the colours of a splat differ from those of its photographs as a whole: another tool's tone curve,
gain or white balance, sRGB against linear."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..scene.gaussians import Scene
from ..views.dataset import Dataset
from ..views.reduced_photos import toned
from .compared_views import compared_views

VIEWS = 24  # that are compared, at most
QUANTILES = 257  # of colours, which the curve leads from those of the photographs to those of the splat
LEAST, PIXELS = 0.05, 100  # share of the pictures, and pixels, that the splat must fill
DIFFERS = 3.0  # dB: the colours differ if the curve gains more, in views that it was not taken from


@dataclass(frozen=True)
class Tone:
    """curve: (3, 256) float32, the display value in 0..1 that the splat has for each 8-bit value of a channel
    of a photograph. before, after: PSNR in dB of the photographs as they are, and with the curve."""

    curve: np.ndarray
    before: float
    after: float

    @property
    def differs(self) -> bool:
        return self.after - self.before > DIFFERS

    def sentence(self, matched: bool) -> str:
        """For the user, if the colours differ. matched: whether the photographs are brought to those of the
        splat, then."""
        found = (
            "the colours of the splat differ from those of the photographs as a whole (PSNR"
            f" {self.before:.1f} dB, with a curve for each channel {self.after:.1f} dB)"
        )
        if not matched:
            return f"{found}; --exposure auto brings the photographs to its colours"
        return f"{found}, so the photographs are brought to its colours, for the figures too"


def tone_of(scene: Scene, dataset: Dataset) -> Tone:
    """The curve of every other view, and what it gains in the others; a gain of 0 if the splat fills too
    little of them. Raises FormatError, SceneError."""
    pairs, filled = list[tuple[np.ndarray, np.ndarray]](), list[float]()
    for photo, shown, comparable in compared_views(scene, dataset, VIEWS):
        pairs.append((photo[comparable], shown[comparable].clip(0, 1)))
        filled.append(float(comparable.mean()))
    others = pairs[1::2] or pairs
    fewest = min(sum(len(photo) for photo, _ in some) for some in (pairs[::2], others))
    if fewest < PIXELS or np.mean(filled) < LEAST:
        return Tone(np.tile(np.linspace(0, 1, 256, dtype=np.float32), (3, 1)), 0.0, 0.0)
    curve = _curve(*(np.concatenate(side) for side in zip(*pairs[::2], strict=True)))
    errors = np.zeros(2)
    for photo, shown in others:
        errors += np.square(photo - shown).sum(), np.square(toned(photo, curve) - shown).sum()
    before, after = -10 * np.log10(errors / sum(photo.size for photo, _ in others) + 1e-12)
    return Tone(curve, float(before), float(after))


def with_tone(dataset: Dataset, tone: Tone) -> Dataset:
    """The dataset with its photographs in the colours of the splat."""
    return replace(dataset, tone=tone.curve, _cache={})


def _curve(photo: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """The curve that gives colours (n, 3) of photographs the distribution of those that are shown. Beyond
    them, it is straight, to black and to white."""
    places, values, channels = np.linspace(0, 1, QUANTILES), np.linspace(0, 1, 256), []
    for k in range(3):
        ends = (np.r_[0, np.quantile(one[:, k], places), 1] for one in (photo, shown))
        channels.append(np.interp(values, *ends))
    return np.stack(channels).astype(np.float32)

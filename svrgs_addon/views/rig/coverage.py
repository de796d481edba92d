"""Which Gaussians candidate views see, and the choice of the fewest that see all of them several times."""

from __future__ import annotations

import heapq

import numpy as np

from ...native.library import thresholds
from ...native.rasterizer import Rasterizer, RenderOptions
from ...scene.camera import Camera
from ...scene.gaussians import Scene

TIMES = 3  # views that must see a Gaussian
# a view sees a Gaussian if a pixel there is at most so many widths of it, or pixels of the nearest view, wide
RESOLVED, NEAREST = 4.0, 2.0


class Coverage:
    """What each candidate sees of a scene. A Gaussian is seen where alpha T is at least 1/255 in a pixel."""

    def __init__(self, scene: Scene, widths: np.ndarray):
        """widths: (N,) float32, of the Gaussians in the world."""
        self.scene, self.widths = scene, widths
        self.cameras: list[Camera] = []
        self.peaks = np.zeros(scene.count, np.float32)  # largest alpha T in any view
        self._seen: list[np.ndarray] = []  # packed bits, (N,) of each view
        # smallest width of a pixel at the Gaussian, of the views that see it
        self._nearest = np.full(scene.count, np.inf, np.float32)
        self._rasterizer = Rasterizer()
        self._options = RenderOptions(sh_degree=0, antialiased=scene.antialiased)

    def add(self, cameras: list[Camera]):
        """Renders further candidates."""
        n = self.scene.count
        sums, hits = np.zeros(n), np.zeros(n, np.int64)
        for camera in cameras:
            peaks = np.zeros(n, np.float32)
            self._rasterizer.forward(self.scene, camera, self._options, outputs=())
            self._rasterizer.add_scores(sums, peaks, hits)
            seen = np.flatnonzero(peaks >= thresholds().alpha_cut)
            self.peaks[seen] = np.maximum(self.peaks[seen], peaks[seen])
            self._nearest[seen] = np.minimum(self._nearest[seen], self._pixel(camera, seen))
            self._seen.append(np.packbits(_marked(seen, n)))
            self.cameras.append(camera)

    def seen(self, view: int) -> np.ndarray:
        """(N,) bool: what a candidate sees, and near enough."""
        rows = np.flatnonzero(np.unpackbits(self._seen[view], count=self.scene.count))
        limit = np.maximum(NEAREST * self._nearest[rows], RESOLVED * self.widths[rows])
        return _marked(rows[self._pixel(self.cameras[view], rows) <= limit], self.scene.count)

    def _pixel(self, camera: Camera, rows: np.ndarray) -> np.ndarray:
        """The width of a pixel in the world, where the Gaussians are, (P,) float32."""
        axis, offset = camera.viewmat[2, :3].astype(np.float32), np.float32(camera.viewmat[2, 3])
        return (self.scene.means[rows] @ axis + offset) / np.float32(camera.K[0, 0])


class Choice:
    """Greedy choice of candidates: the next one is the one that adds most to the sum over Gaussians of weight
    times the number of views that see it, at most `cap`."""

    def __init__(self, coverage: Coverage):
        self.weights = coverage.peaks.astype(np.float64)
        self.seen = [np.packbits(coverage.seen(view)) for view in range(len(coverage.cameras))]
        self.counts = np.zeros(len(self.weights), np.uint8)
        self.chosen: list[int] = []

    def share(self) -> float:
        """The share of the weights of all Gaussians that TIMES chosen views see."""
        return self._share(self.counts)

    def possible(self) -> float:
        """The share of the weights of all Gaussians that TIMES candidates see."""
        return self._share(self._times_seen())

    def _share(self, counts: np.ndarray) -> float:
        return float(self.weights[counts >= TIMES].sum() / max(self.weights.sum(), 1e-300))

    def few(self) -> np.ndarray:
        """(N,) bool: the Gaussians that candidates see, but fewer than TIMES of them."""
        counts = self._times_seen()
        return (counts > 0) & (counts < TIMES)

    def _times_seen(self) -> np.ndarray:
        """(N,) the number of candidates that see each Gaussian."""
        counts = np.zeros(len(self.weights), np.uint8)
        for view in range(len(self.seen)):
            counts += self._bits(view)
        return counts

    def rows(self, view: int, among: np.ndarray) -> np.ndarray:
        """The Gaussians among the marked ones (N,) that a candidate sees."""
        return np.flatnonzero(self._bits(view) & among)

    def run(self, least: int, most: int, share: float):
        """Chooses up to `most` views: at least `least`, and as many as are needed for the share."""
        cap = TIMES
        while cap < 256 - TIMES and not self._enough(least, most, share):
            self._run(cap, least, most, share)
            cap += TIMES

    def _enough(self, least: int, most: int, share: float) -> bool:
        count = len(self.chosen)
        return count >= min(most, len(self.seen)) or (count >= least and self.share() >= share)

    def _run(self, cap: int, least: int, most: int, share: float):
        """Chooses until no view adds anything below the cap. As gains only shrink, old ones are bounds."""
        taken = set(self.chosen)
        heap = [(-self._gain(view, cap), view) for view in range(len(self.seen)) if view not in taken]
        heapq.heapify(heap)
        while heap and not self._enough(least, most, share):
            _, view = heapq.heappop(heap)
            gain = self._gain(view, cap)
            if heap and gain < -heap[0][0]:
                heapq.heappush(heap, (-gain, view))
                continue
            if gain <= 0:
                return
            self.chosen.append(view)
            self.counts += self._bits(view)

    def _gain(self, view: int, cap: int) -> float:
        return float(self.weights[self._bits(view) & (self.counts < cap)].sum())

    def _bits(self, view: int) -> np.ndarray:
        return np.unpackbits(self.seen[view], count=len(self.weights)).view(bool)


def _marked(rows: np.ndarray, count: int) -> np.ndarray:
    marks = np.zeros(count, bool)
    marks[rows] = True
    return marks

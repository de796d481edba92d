"""Tables and palettes: the few values that stand for many with the least weighted squared error (k-means)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

BINS = 1 << 14  # of the histogram that a table is made from
TABLE_STEPS, PALETTE_STEPS = 30, 5  # of Lloyd's algorithm
COARSE = 256  # groups of rows of a palette, at most
SAMPLE = 64  # rows for each coarse group, at least, from which their centres are found
REPEATED = 4  # equal rows, on average, of a scene that has had a palette before
BLOCK = 1 << 16  # rows that are compared with all centres together
METRIC_STEPS, NEAR, PART = 2, 16, 1 << 12  # with a metric for each row: steps, entries and rows together
RIDGE = 1e-6  # part of the metric that every direction has at least
WINDOW = 1 << 10  # entries whose neighbours are searched together


def table(values: np.ndarray, weights: np.ndarray, size: int) -> np.ndarray:
    """(size,) float32, increasing: levels that stand for values (N,) of weights (N,); the last repeats."""
    different = np.unique(values[:: max(1, len(values) // BINS)]) if len(values) > BINS else np.unique(values)
    if len(different) <= size and np.isin(values, different).all():
        return np.pad(different, (0, size - len(different)), "edge").astype(np.float32)
    counts, edges = np.histogram(values, BINS, weights=weights)
    masses = np.cumsum(np.append(0, counts))
    sums = np.cumsum(np.append(0, counts * (edges[1:] + edges[:-1]) / 2))
    # density of the best levels: cube root of that of the values
    spread = np.cumsum(np.append(0, np.cbrt(counts)))
    levels = np.interp((np.arange(size) + 0.5) / size * spread[-1], spread, edges)
    for _ in range(TABLE_STEPS):
        ends = np.searchsorted(edges, (levels[1:] + levels[:-1]) / 2)
        starts, ends = np.append(0, ends), np.append(ends, BINS)
        mass = masses[ends] - masses[starts]
        levels = np.where(mass > 0, (sums[ends] - sums[starts]) / np.where(mass > 0, mass, 1), levels)
    return np.sort(levels).astype(np.float32)


def nearest(values: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Number of the nearest of the increasing levels (L,) to each value: uint8, shaped as values."""
    return np.searchsorted((levels[1:] + levels[:-1]) / 2, values).astype(np.uint8)


def palette(rows: np.ndarray, weights: np.ndarray, size: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """(entries, labels): at most `size` rows (E, D) that stand for rows (N, D) of these weights (N,), and the
    entry of each, (N,) int64. Rows that are equal REPEATED times on average come out of a palette, which is
    kept if it has at most `most` entries.

    In two stages: rows are put into at most COARSE groups, and each group gets entries of its own, as many as
    its share of the error asks for.
    """
    if len(rows) <= size:
        return rows, np.arange(len(rows))
    _, first, same = np.unique(_hashes(rows), return_index=True, return_inverse=True)
    # they come out of a palette
    if len(first) <= max(size, min(most, len(rows) // REPEATED)) and (rows[first][same] == rows).all():
        return rows[first], same
    chance = np.random.default_rng(0)
    coarse = min(COARSE, size)
    some = chance.choice(len(rows), min(len(rows), SAMPLE * COARSE), replace=False)
    centres = _means_of(rows[some], weights[some], _first(rows[some], weights[some], coarse, chance))
    # neighbours have similar numbers, which pack better
    main_axis = np.linalg.svd(centres - centres.mean(axis=0), full_matrices=False)[2][0]
    centres = centres[np.argsort(centres @ main_axis)]
    group, errors = _assigned(rows, centres)
    order = np.argsort(group, kind="stable")
    members = np.split(order, np.searchsorted(group[order], np.arange(1, coarse)))
    lost = np.array([float((weights[one] * errors[one]).sum()) for one in members])
    shares = _shares(lost, np.array([len(one) for one in members]), size)
    entries, labels, known = [], np.empty(len(rows), np.int64), 0
    for one, share in zip(members, shares, strict=True):
        if len(one) == 0:
            continue
        found = rows[one]
        if share < len(one):
            found = _means_of(found, weights[one], _first(found, weights[one], share, chance))
        labels[one] = known + _assigned(rows[one], found)[0]
        entries.append(found)
        known += len(found)
    return np.concatenate(entries), labels


def refined(
    rows: np.ndarray,
    entries: np.ndarray,
    labels: np.ndarray,
    factors: Callable[[slice], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """(entries, labels) with less error, where each row has a metric of its own: k-means with the Hessian of
    each row, as in GPTVQ (arXiv 2402.15319).

    rows: (N, K, 3) float32. entries: (E, K, 3) float32, in the order of palette(). labels: (N,) int64.
    factors(part): (n, K, K), F of these rows; their error is |F (row - entry)|^2. Each of METRIC_STEPS gives
    every row the best of NEAR entries around its own, then solves for the entry of least error of its rows.
    """
    near = _neighbours(entries.reshape(len(entries), -1), min(NEAR, len(entries)))
    for _ in range(METRIC_STEPS):
        labels, size = labels.copy(), entries.shape[1]
        squares, products = np.zeros((len(entries), size, size)), np.zeros(entries.shape)
        for start in range(0, len(rows), PART):
            part = slice(start, start + PART)
            F, some = factors(part), rows[part]
            nearby = near[labels[part]]
            wrong = F[:, None] @ (some[:, None] - entries[nearby])
            best = np.square(wrong).sum(axis=(2, 3)).argmin(axis=1)
            labels[part] = np.take_along_axis(nearby, best[:, None], axis=1)[:, 0]
            order = np.argsort(labels[part], kind="stable")
            found, first = np.unique(labels[part][order], return_index=True)
            metric = F.swapaxes(1, 2) @ F
            squares[found] += np.add.reduceat(metric[order], first)
            products[found] += np.add.reduceat((metric @ some)[order], first)
        used = np.flatnonzero(np.trace(squares, axis1=1, axis2=2) > 0)
        entries = entries.copy()
        spread = np.trace(squares[used], axis1=1, axis2=2)[:, None, None]
        entries[used] = solved(squares[used] + RIDGE * spread * np.eye(size), products[used])
    return entries, labels


def _neighbours(entries: np.ndarray, count: int) -> np.ndarray:
    """(E, count) int64: entries that are near to each one, itself among them. Only those of similar numbers
    are compared: palette() sorts its entries so that near ones have them."""
    half, found = np.square(entries).sum(axis=1) / 2, []
    for start in range(0, len(entries), WINDOW):
        low = max(0, min(start - WINDOW // 2, len(entries) - 2 * WINDOW))
        among = slice(low, low + 2 * WINDOW)
        likeness = entries[start : start + WINDOW] @ entries[among].T - half[among]
        found.append(low + np.argpartition(likeness, -count, axis=1)[:, -count:])
    return np.concatenate(found)


def solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """x of A x = b, for many small positive definite A (E, K, K) and b (E, K, 3). With several threads,
    np.linalg.solve takes 25 times as long for them."""
    L, x = np.linalg.cholesky(A), b.copy()
    for k in range(b.shape[1]):
        x[:, k] -= np.einsum("nj,njc->nc", L[:, k, :k], x[:, :k])
        x[:, k] /= L[:, k, k, None]
    for k in reversed(range(b.shape[1])):
        x[:, k] -= np.einsum("nj,njc->nc", L[:, k + 1 :, k], x[:, k + 1 :])
        x[:, k] /= L[:, k, k, None]
    return x


def _shares(errors: np.ndarray, counts: np.ndarray, size: int) -> np.ndarray:
    """Entries for each group, at least 1 for one with members and at most as many as it has, `size` together:
    by the root of error times members."""
    wanted = np.sqrt(errors * counts)
    shares = np.minimum(counts, 1)
    for _ in range(8):  # what is beyond the members of one group goes to the others
        left, open_ones = size - shares.sum(), shares < counts
        total = wanted[open_ones].sum()
        if left <= 0 or total <= 0:
            break
        more = np.minimum(np.floor(left * wanted / total).astype(np.int64), counts - shares)
        shares = shares + np.where(open_ones, more, 0)
    return shares


def _first(rows: np.ndarray, weights: np.ndarray, size: int, chance: np.random.Generator) -> np.ndarray:
    """Rows from which the search begins, drawn without replacement, likely ones by their weight."""
    waits = chance.standard_exponential(len(rows)) / (weights + weights.mean() * 1e-3 + 1e-30)
    return rows[np.sort(np.argpartition(waits, size - 1)[:size])]


def _hashes(rows: np.ndarray) -> np.ndarray:
    """A number for each row, (N,) uint64, the same for equal rows."""
    hashes = np.zeros(len(rows), np.uint64)
    for column in np.ascontiguousarray(rows).view(np.uint32).T:
        hashes = (hashes ^ column) * np.uint64(0x9E3779B97F4A7C15)
        hashes ^= hashes >> np.uint64(29)
    return hashes


def _means_of(rows: np.ndarray, weights: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """The centres after some steps of Lloyd's algorithm; one that nothing is near to stays where it was."""
    weighted = rows * weights[:, None]
    for _ in range(PALETTE_STEPS):
        label, _ = _assigned(rows, centres)
        mass = np.bincount(label, weights, len(centres))
        order = np.argsort(label, kind="stable")
        found = np.flatnonzero(np.bincount(label, minlength=len(centres)))
        sums = np.add.reduceat(weighted[order], np.searchsorted(label[order], found))
        good = mass[found] > 0
        centres = centres.copy()
        centres[found[good]] = sums[good] / mass[found][good, None]
    return centres


def _assigned(rows: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nearest centre of each row, (N,) int64, and the squared distance to it, (N,) float32."""
    half = np.square(centres).sum(axis=1) / 2
    labels, errors = np.empty(len(rows), np.int64), np.empty(len(rows), np.float32)
    for start in range(0, len(rows), BLOCK):
        block = rows[start : start + BLOCK]
        likeness = block @ centres.T
        likeness -= half
        label = likeness.argmax(axis=1)
        best = np.take_along_axis(likeness, label[:, None], axis=1)[:, 0]
        labels[start : start + BLOCK] = label
        errors[start : start + BLOCK] = np.maximum(np.square(block).sum(axis=1) - 2 * best, 0)
    return labels, errors

"""Viewpoints for a splat, and the cameras there: around an object, or within a room, a street or a sky."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...native.library import near_depth
from ...scene.bounds import weighted_quantiles
from ...scene.camera import Camera
from .space import CELLS, FREE, Matter, Space, connected, sphere

# tangents of half the angle of view of a square picture: 0.9 and 1.3 radians
AROUND, WITHIN = math.tan(0.9 / 2), math.tan(1.3 / 2)
SMALLEST, LARGEST, STEP = 512, 1024, 32  # side of a picture, pixels; a multiple of STEP
# from this enclosure on a place is within matter, from this share of such places a scene is inside-out
ENCLOSED, INSIDE_OUT = 0.5, 0.4
PROBED = 128  # places whose enclosure is measured, to tell both kinds of scene apart
STANDING = 512  # places within a scene from which cameras are chosen
BULK = 0.05, 0.95  # quantiles of opacity along each axis: the box in which the middle of the scene is
FRAME = 0.99  # share of the opacity of a body that fits into a picture of it
BODY, BODIES = 0.02, 8  # least share of the matter that is a body of its own; most bodies
APART, OF_BODY = 0.7, 4  # radius, in that of the whole, up to which a body has views of its own; the fewest
CLOSE = 0.35, 0.6  # radius of what a close view shows, in radii of the body
ROOM = 1.5  # a camera keeps this multiple of the nearest rendered depth from a body
NEAREST, FARTHEST = 0.6, 1.1  # distances of whole views of a body, in those at which it fills a picture
TRIES, FARTHER = 12, 1.15  # moves outward by this factor, until a camera is free
# views from one place within a scene; those of them that are aimed at Gaussians, not spread over the sphere
PER_PLACE, AIMED = 8, 3


@dataclass(frozen=True)
class View:
    """An eye, its target, and the tangent of half the angle of view."""

    eye: np.ndarray  # (3,) world
    target: np.ndarray  # (3,) world
    tangent: float
    unit: float  # Camera.unit

    def camera(self, side: int, name: str = "") -> Camera:
        """The square camera of this view. World -y is up in its picture, as in COLMAP's worlds."""
        forward = self.target - self.eye
        forward = forward / np.linalg.norm(forward)
        down = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.99 else np.array([0.0, 0.0, 1.0])
        right = np.cross(down, forward)
        right /= np.linalg.norm(right)
        viewmat = np.eye(4)
        viewmat[:3, :3] = right, np.cross(forward, right), forward
        viewmat[:3, 3] = -viewmat[:3, :3] @ self.eye
        focal = side / 2 / self.tangent
        K = np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1]])
        return Camera(viewmat, K, side, side, name, unit=self.unit)


@dataclass(frozen=True)
class Body:
    """A connected part of the matter, as a sphere."""

    centre: np.ndarray  # (3,)
    radius: float
    rows: np.ndarray  # (P,) int64: its Gaussians in Matter
    unit: float  # Camera.unit

    @property
    def nearest(self) -> float:
        """The least distance of a camera from the centre."""
        return self.radius + ROOM * near_depth(self.unit)

    @property
    def distance(self) -> float:
        """The distance at which the sphere fills a picture and no part of it is too near."""
        return max(self.radius / math.sin(math.atan(AROUND)), self.nearest)

    def view(self, direction: np.ndarray, nearness: float = 1.0, aim: np.ndarray | float = 0.0) -> View:
        """The view from a unit vector (3,). nearness: of the distance. aim: (3,) offset of the target."""
        # of a small body from as near as can be: a smaller angle
        fitting = math.tan(math.asin(min(1.0, self.radius / self.distance)))
        distance = max(self.nearest, nearness * self.distance)
        return View(self.centre + distance * direction, self.centre + aim, min(AROUND, fitting), self.unit)


class Around:
    """Views of an object from all around."""

    inside_out, tangent = False, AROUND

    def __init__(self, matter: Matter, space: Space):
        self.matter, self.space = matter, space
        free = space.free()
        self.standing = connected(free, 0).reshape(-1) if free.reshape(-1)[0] else free.reshape(-1)
        self.bodies = bodies_of(matter, space)
        rows = np.concatenate([body.rows for body in self.bodies])
        self.whole = self.bodies[0] if len(self.bodies) == 1 else body_of(matter, rows)
        # what views show
        self.shown = [self.whole, *(body for body in self.bodies if body.radius < APART * self.whole.radius)]

    def distances(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the matter, (P,), and the distances from which views show them, (P,)."""
        rows = np.concatenate([body.rows for body in self.bodies])
        counts = [len(body.rows) for body in self.bodies]
        return rows, np.repeat([body.distance for body in self.bodies], counts)

    def views(self, count: int, rng: np.random.Generator, close: float = 0.1) -> list[View]:
        """About `count` views. close: share of those that show a part from nearer."""
        wide = count - int(close * count)
        views = []
        total = sum(len(body.rows) for body in self.shown)
        for body in self.shown:
            for direction in sphere(max(OF_BODY, wide * len(body.rows) // total), rng.uniform(0, 2 * np.pi)):
                nearness = math.exp(rng.uniform(math.log(NEAREST), math.log(FARTHEST)))
                views.append(body.view(direction, nearness))
        views += [self.close_view(rng) for _ in range(count - wide)]
        return [view for view in map(self.freed, views) if view is not None]

    def close_view(self, rng: np.random.Generator) -> View:
        """A view of a part of a body, from the outside of this part."""
        body = self.bodies[rng.integers(len(self.bodies))]
        point = self.matter.means[body.rows[rng.integers(len(body.rows))]]
        outward = (point - body.centre) / max(body.radius, 1e-30) + 0.6 * _direction(rng)
        part = Body(point, rng.uniform(*CLOSE) * body.radius, body.rows, body.unit)
        return part.view(outward / np.linalg.norm(outward))

    def other_views(self, count: int, rng: np.random.Generator) -> list[View]:
        """Views for testing: other directions, distances and targets."""
        views: list[View] = []
        for _ in range(TRIES * count):
            body = self.shown[0 if len(views) % 8 else len(views) // 8 % len(self.shown)]
            if len(views) % 8 == 7:
                view = self.freed(self.close_view(rng))
            else:
                direction, nearness = _direction(rng), rng.uniform(NEAREST, FARTHEST)
                aim = 0.2 * body.radius * rng.standard_normal(3)
                view = self.freed(body.view(direction, nearness, aim))
            views += [view] if view is not None else []
            if len(views) == count:
                break
        return views

    def varied(self, view: View, target: np.ndarray, rng: np.random.Generator) -> View | None:
        """A view near another one that has `target` (3,) nearer to its middle; None if no camera can stand
        there."""
        arm = view.eye - view.target
        length = np.linalg.norm(arm)
        arm = arm / length + 0.35 * _direction(rng)
        eye = view.target + length * rng.uniform(0.75, 1.1) * arm / np.linalg.norm(arm)
        target = view.target + rng.uniform(0.3, 0.9) * (target - view.target)
        return self.freed(View(eye, target, view.tangent, view.unit))

    def freed(self, view: View) -> View | None:
        """The view from the nearest free place farther away in its direction; None if there is none."""
        for _ in range(TRIES):
            if self.standing[self.space.cells(view.eye[None])[0]]:
                return view
            view = replace(view, eye=view.target + FARTHER * (view.eye - view.target))
        return None


class Within:
    """Views from within a scene, in all directions."""

    inside_out, tangent = True, WITHIN

    def __init__(self, matter: Matter, space: Space):
        self.matter, self.space = matter, space
        self.places = standing_places(matter, space)  # (P, 3)
        middle = np.flatnonzero(_in_bulk(matter, matter.means))
        self.middle = middle if len(middle) else np.arange(len(matter.means))  # rows of the matter

    def distances(self) -> tuple[np.ndarray, np.ndarray]:
        """As Around.distances()."""
        rows = np.arange(0, len(self.matter.means), max(1, len(self.matter.means) // 5_000))
        means, places = self.matter.means[rows], spread_places(self.places, 16)
        return rows, np.min([np.linalg.norm(means - place, axis=1) for place in places], axis=0)

    def views(self, count: int, rng: np.random.Generator, aimed: int = AIMED) -> list[View]:
        """About `count` views. aimed: at Gaussians, of each place; 0: a few places look all around."""
        views = []
        per_place = PER_PLACE if aimed else 6
        for place in spread_places(self.places, max(1, count // per_place)):
            axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
            around = np.concatenate([axes, -axes]) if not aimed else sphere(per_place - aimed) @ axes
            views += [
                self._view(place, place + self.space.half * direction, self.tangent if aimed else 1.05)
                for direction in around
            ]
            views += [self._view(place, self._aim(place, rng)) for _ in range(aimed)]
        return views

    def _view(self, eye: np.ndarray, target: np.ndarray, tangent: float | None = None) -> View:
        return View(eye, target, tangent or self.tangent, self.matter.unit)

    def _aim(self, place: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """A Gaussian of the middle that is not too near."""
        for _ in range(TRIES):
            point = self.matter.means[self.middle[rng.integers(len(self.middle))]]
            if np.linalg.norm(point - place) > 2 * ROOM * self.space.near:
                return point
        return place + self.space.half * _direction(rng)

    def other_views(self, count: int, rng: np.random.Generator) -> list[View]:
        """Views for testing: from other places, in other directions."""
        chosen = rng.permutation(len(self.places))[:count]
        eyes = [self._near(self.places[k], rng) for k in np.resize(chosen, count)]
        return [self._view(eye, self._aim(eye, rng)) for eye in eyes]

    def varied(self, view: View, target: np.ndarray, rng: np.random.Generator) -> View | None:
        """A view from another place nearby that looks at `target` (3,)."""
        nearest = np.argsort(np.linalg.norm(self.places - view.eye, axis=1), kind="stable")[:8]
        eye = self._near(self.places[nearest[rng.integers(len(nearest))]], rng)
        return self._view(eye, target) if (target != eye).any() else None

    def _near(self, place: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """A point in the cell of the place, off its middle."""
        return place + rng.uniform(-0.4, 0.4, 3) * self.space.cell_size(place[None])


def setting_of(matter: Matter, space: Space) -> Around | Within:
    """The views that suit the scene."""
    if enclosed_share(matter, space) >= INSIDE_OUT:
        within = Within(matter, space)
        if len(within.places):
            return within
    return Around(matter, space)


def enclosed_share(matter: Matter, space: Space) -> float:
    """The share of the box around the middle of the scene that is empty, with matter in at least half of all
    directions. An object leaves its box empty, but outside of it; a room is empty inside."""
    inside = np.flatnonzero(_in_bulk(matter, space.places(np.arange(CELLS**3))))
    empty = inside[space.depth.reshape(-1)[inside] < FREE]
    if not len(empty):
        return 0.0
    probed = empty[np.linspace(0, len(empty) - 1, min(PROBED, len(empty))).astype(np.int64)]
    return float((space.enclosure(space.places(probed)) >= ENCLOSED).mean()) * len(empty) / len(inside)


def standing_places(matter: Matter, space: Space) -> np.ndarray:
    """(P, 3) the middles of connected free cells within the scene, at most STANDING. P may be 0."""
    free = space.free()
    cells = np.flatnonzero(free.reshape(-1) & _in_bulk(matter, space.places(np.arange(CELLS**3))))
    cells = cells[np.linspace(0, len(cells) - 1, min(STANDING, len(cells))).astype(np.int64)]
    cells = cells[space.enclosure(space.places(cells)) >= ENCLOSED] if len(cells) else cells
    best, left = cells[:0], cells
    while len(left) > len(best):
        part = connected(free, int(left[0])).reshape(-1)[left]
        best, left = (left[part] if part.sum() > len(best) else best), left[~part]
    return space.places(best)


def spread_places(places: np.ndarray, count: int) -> np.ndarray:
    """At most `count` of the places (P, 3), the most central one first, each farthest from those before."""
    chosen = [int(np.argmin(np.linalg.norm(places - np.median(places, axis=0), axis=1)))]
    nearest = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < min(count, len(places)):
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return places[chosen]


def bodies_of(matter: Matter, space: Space) -> list[Body]:
    """Connected parts of the matter with at least BODY of it, the largest first; floaters are none."""
    cells, weights = space.cells(matter.means), matter.opacities * np.minimum(matter.areas, space.half**2)
    mass = np.bincount(cells, weights, CELLS**3)
    left, bodies = (mass > 0).reshape(space.depth.shape), list[tuple[float, Body]]()
    order = np.argsort(-mass, kind="stable")
    for cell in order[: 50 * BODIES]:
        if not left.reshape(-1)[cell] or len(bodies) == BODIES:
            continue
        part = connected(left, int(cell))
        left = left & ~part
        share = mass[part.reshape(-1)].sum() / mass.sum()
        if share >= BODY or not bodies:
            bodies.append((share, body_of(matter, np.flatnonzero(part.reshape(-1)[cells]))))
    return [body for _, body in sorted(bodies, key=lambda pair: -pair[0])]


def body_of(matter: Matter, rows: np.ndarray) -> Body:
    """The sphere around some rows of the matter."""
    means, weights = matter.means[rows], matter.opacities[rows]
    centre = np.mean([weighted_quantiles(axis, weights, (1 - FRAME, FRAME)) for axis in means.T], axis=1)
    reach = np.linalg.norm(means - centre, axis=1) + matter.widths[rows]
    return Body(centre, float(weighted_quantiles(reach, weights, FRAME)), rows, matter.unit)


def side_of(setting: Around | Within, enlarged: float = 1.0) -> int:
    """The side of a picture in pixels at which a pixel is as wide as half of all Gaussians, within limits.
    enlarged: how much wider they are than those of the result."""
    rows, distances = setting.distances()
    matter = setting.matter
    focal = float(weighted_quantiles(distances / matter.widths[rows], matter.opacities[rows], 0.5))
    return int(np.clip(round(2 * setting.tangent * focal * enlarged / STEP) * STEP, SMALLEST, LARGEST))


def _in_bulk(matter: Matter, places: np.ndarray) -> np.ndarray:
    """(P,) bool: the places (P, 3) in the box between the quantiles BULK of the matter."""
    low, high = np.array([weighted_quantiles(axis, matter.opacities, BULK) for axis in matter.means.T]).T
    return ((places >= low) & (places <= high)).all(axis=1)


def _direction(rng: np.random.Generator) -> np.ndarray:
    """A random unit vector (3,)."""
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)

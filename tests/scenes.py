"""Small scenes and cameras for the numeric tests, ordinary and hostile, and their float64 torch twins.

Scenes are float32, around the origin; `camera` looks at the origin from 4 units away. Same seed, same scene.
"""

from __future__ import annotations

import contextlib
import copy
import pickle
from dataclasses import replace

import numpy as np

from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import SH_COEFFICIENTS, Scene

DISTANCE = 4.0

with contextlib.suppress(ImportError):  # the twins alone need it
    import torch

    from reference import rasterize as ref

    torch.set_num_threads(1)  # these tensors are small: waiting for a busy core costs more than it saves


def _float32(*arrays: np.ndarray) -> list[np.ndarray]:
    return [np.ascontiguousarray(a, dtype=np.float32) for a in arrays]


# --- scenes


def random_scene(
    n: int,
    seed: int = 0,
    sh_degree: int = 3,
    *,
    spread: float = 1.0,  # standard deviation of the centres
    scale: float = 0.1,  # median standard deviation of a Gaussian
    anisotropy: float = 0.6,  # standard deviation of the log-scales
    opacity: float = 0.5,  # mean opacity logit
    antialiased: bool = False,
) -> Scene:
    """n Gaussians like those of a trained scene: elongated, any rotation, quaternions not normalised."""
    rng = np.random.default_rng(seed)
    sh = rng.normal(0, 0.12, (n, SH_COEFFICIENTS[sh_degree], 3))
    sh[:, 0] = rng.normal(0.2, 0.8, (n, 3))
    quats = rng.normal(size=(n, 4))
    quats *= rng.uniform(0.5, 2.0, (n, 1)) / np.linalg.norm(quats, axis=1, keepdims=True)
    arrays = _float32(
        rng.normal(0, spread, (n, 3)),
        rng.normal(np.log(scale), anisotropy, (n, 3)),
        quats,
        rng.normal(opacity, 1.5, n),
        sh,
    )
    return Scene(*arrays, antialiased=antialiased)


def random_masks(n: int, seed: int = 0, keep: float = 0.7) -> np.ndarray:
    """Mixed masks (n,) float32 in {0, 1}; both values occur when n ≥ 2."""
    masks = (np.random.default_rng(seed).random(n) < keep).astype(np.float32)
    masks[:2] = (1, 0)[: len(masks[:2])]
    return masks


def empty_scene(sh_degree: int = 0) -> Scene:
    """No Gaussians."""
    return random_scene(0, sh_degree=sh_degree)


def needles(n: int, seed: int = 0, sh_degree: int = 3) -> Scene:
    """One axis up to 1e6 times the others."""
    scene = random_scene(n, seed, sh_degree)
    rng = np.random.default_rng(seed + 1)
    log_scales = np.stack([rng.uniform(-2, 1, n), rng.uniform(-14, -6, n), rng.uniform(-14, -6, n)], 1)
    return replace(scene, log_scales=_float32(rng.permuted(log_scales, axis=1))[0])


def near_camera(n: int, seed: int = 0, sh_degree: int = 3) -> Scene:
    """Centres behind, at and just in front of the near plane of `camera`, and far behind everything."""
    scene = random_scene(n, seed, sh_degree)
    rng = np.random.default_rng(seed + 1)
    depth = rng.choice([-1.0, 0.0, 0.1999, 0.2001, 0.21, 0.3, 1.0, 1e4], n)
    side = rng.uniform(-0.5, 0.5, (n, 2)) * np.maximum(np.abs(depth), 0.2)[:, None]
    return replace(scene, means=_float32(np.column_stack([side, depth - DISTANCE]))[0])


def off_screen(n: int, seed: int = 0, sh_degree: int = 3) -> Scene:
    """Wide Gaussians centred outside the view, where the Jacobian is clamped."""
    scene = random_scene(n, seed, sh_degree, scale=1.5)
    rng = np.random.default_rng(seed + 1)
    means = rng.uniform(-1, 1, (n, 3)) * (12, 12, 3)
    return replace(scene, means=_float32(means)[0])


def extreme_opacity(n: int, seed: int = 0, sh_degree: int = 3) -> Scene:
    """Opacities from 0 to 1 to float precision, and around both 1/255 and 0.99."""
    scene = random_scene(n, seed, sh_degree)
    logits = [-40.0, -5.6, -5.5373, -5.53, 4.59, 4.5951, 4.6, 8.0, 40.0]
    return replace(scene, opacity_logits=_float32(np.random.default_rng(seed + 1).choice(logits, n))[0])


def extreme_scales(n: int, seed: int = 0, sh_degree: int = 3) -> Scene:
    """Points to Gaussians much larger than the scene, isotropic and not."""
    scene = random_scene(n, seed, sh_degree)
    return replace(scene, log_scales=_float32(np.random.default_rng(seed + 1).uniform(-25, 4, (n, 3)))[0])


def equal_depths(n: int, seed: int = 0, sh_degree: int = 3) -> Scene:
    """Every Gaussian twice, all in two planes parallel to the image of `camera`."""
    scene = random_scene(n, seed, sh_degree)
    means = scene.means.copy()
    means[:, 2] = np.where(np.arange(n) % 2, 0.25, -0.25)
    return replace(scene, means=means).select(np.arange(n) // 2)


def opaque_stack(n: int, seed: int = 0, sh_degree: int = 3) -> Scene:
    """Opaque Gaussians filling the view one behind the other: every pixel stops early."""
    scene = random_scene(n, seed, sh_degree, spread=0.3, scale=1.0, anisotropy=0.2, opacity=3.0)
    means = scene.means.copy()
    means[:, 2] = np.linspace(-1, 1, n)
    return replace(scene, means=means)


HOSTILE_SCENES = {
    f.__name__: f
    for f in (needles, near_camera, off_screen, extreme_opacity, extreme_scales, equal_depths, opaque_stack)
}


# --- cameras


def ball(count: int = 2_000, radius: float = 3.0, middle=(0.0, 0.0, 0.0), seed: int = 0) -> Scene:
    """A sphere of overlapping Gaussians whose colours change slowly."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sh = np.zeros((count, 4, 3))
    sh[:, 0] = directions
    sh[:, 1:] = 0.05 * rng.normal(size=(count, 3, 3))
    scales = np.full((count, 3), np.log(radius * 0.05))
    return Scene.of(
        radius * directions + np.array(middle), scales, rng.normal(size=(count, 4)), np.full(count, 1.5), sh
    )


def camera(
    width: int,
    height: int,
    *,
    fov: float = 60.0,  # degrees, horizontal
    aspect: float = 1.0,  # fy / fx
    shift: tuple[float, float] = (0.0, 0.0),  # principal point off centre, in widths and heights
    eye: tuple[float, float, float] = (0.0, 0.0, -DISTANCE),  # looks at the origin
    roll: float = 0.0,  # degrees
) -> Camera:
    """A view of the origin, world y down; by default along +z without rotation."""
    eye = np.asarray(eye, dtype=np.float64)
    forward = -eye / np.linalg.norm(eye)
    right = np.cross((0.0, 1.0, 0.0), forward)
    right /= np.linalg.norm(right)
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    R = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ np.stack([right, np.cross(forward, right), forward])
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = R, -R @ eye
    focal = width / (2 * np.tan(np.radians(fov) / 2))
    principal = width * (0.5 + shift[0]), height * (0.5 + shift[1])
    K = np.array([[focal, 0, principal[0]], [0, focal * aspect, principal[1]], [0, 0, 1]])
    return Camera(viewmat, K, width, height)


CAMERAS = {
    "plain": camera(33, 21),
    "tiles": camera(48, 32),
    "rotated": camera(31, 24, eye=(2.0, -2.5, -1.5), roll=25),
    "off_centre": camera(32, 27, shift=(0.4, -0.3)),
    "outside": camera(29, 18, shift=(0.9, 0.0)),  # principal point beyond the image
    "wide": camera(40, 17, fov=120, aspect=0.8),
    "narrow": camera(17, 40, fov=12, aspect=1.3),
    "inside": camera(24, 24, eye=(0.1, 0.05, -0.2)),  # within the cloud
    "pixel": camera(1, 1),
    "row": camera(17, 1),
    "column": camera(1, 17),
}


def parallel(camera: Camera) -> Camera:
    """The orthographic view that shows the origin's plane at the camera's scale."""
    z = camera.viewmat[2, 3]
    return replace(camera, K=camera.K @ np.diag([1 / z, 1 / z, 1.0]), orthographic=True)


ORTHOGRAPHIC = {
    f"parallel_{name}": parallel(CAMERAS[name])
    for name in ("plain", "rotated", "off_centre", "narrow", "inside")
}


# --- float64 torch twins


def leaves(scene: Scene, requires_grad: bool = True) -> dict[str, torch.Tensor]:
    """The scene's five arrays as float64 leaf tensors, by their names."""
    names = ("means", "log_scales", "quats", "opacity_logits", "sh")
    return {
        n: torch.tensor(getattr(scene, n), dtype=torch.float64, requires_grad=requires_grad) for n in names
    }


def reference_render(
    params: dict[str, torch.Tensor], masks, camera: Camera, background=(0.0, 0.0, 0.0), **options
):
    """`rasterize` of `leaves(scene)` with masks (N,) and background (3,), arrays or tensors; a Render."""
    return ref.rasterize(
        **params,
        masks=torch.as_tensor(masks, dtype=torch.float64),
        viewmat=torch.as_tensor(camera.viewmat, dtype=torch.float64),
        K=torch.as_tensor(camera.K, dtype=torch.float64),
        width=camera.width,
        height=camera.height,
        orthographic=camera.orthographic,
        background=torch.as_tensor(background, dtype=torch.float64),
        **options,
    )


# --- scenes for finite differences


def _near(x: torch.Tensor, threshold: float, share: float) -> torch.Tensor:
    return (x / threshold - 1).abs() < share


def undecided(scene: Scene, camera: Camera, masks: np.ndarray) -> np.ndarray:
    """Gaussians (N,) bool close to a decision of this view, where a finite difference would measure a jump or
    kink.

    Within 3 % of α = 1/255 or 0.99 at any pixel, 10 % of the stop, the near plane or the antialiasing floor,
    1 % of a Jacobian clamp, 0.02 of a colour clamp, or 1e-4 of the depth of the next splat.
    """
    p = leaves(scene, requires_grad=False)
    viewmat, K = torch.tensor(camera.viewmat), torch.tensor(camera.K)
    size = camera.width, camera.height
    splats = ref.project(
        *p.values(), viewmat, K, *size, scene.sh_degree, scene.antialiased, camera.orthographic
    )
    pixels = ref.pixel_centres(*size)
    alpha, raw = ref.alphas(splats, pixels)[0], ref.unclamped_alphas(splats, pixels)[0]
    T = ref.transmittance(alpha, torch.as_tensor(masks, dtype=torch.float64)[splats.index])[:, 1:]

    means_c = (p["means"] @ viewmat[:3, :3].T + viewmat[:3, 3])[splats.index]
    slopes, limits = means_c[:, :2] / means_c[:, 2:], ref.frustum_limits(K, *size)
    colours = ref.view_colours(p["means"], p["sh"], viewmat, scene.sh_degree, camera.orthographic)[
        splats.index
    ]
    close = (
        _near(raw, ref.ALPHA_MIN, 0.03) | _near(raw, ref.ALPHA_MAX, 0.03) | _near(T, ref.T_MIN, 0.1)
    ).any(0)
    if not camera.orthographic:
        close |= torch.stack([_near(slopes, limit, 0.01) for limit in limits]).any(0).any(1)
    close |= (colours.abs() < 0.02).any(1)
    close[1:] |= splats.z.diff() < 1e-4 * splats.z[1:]
    if scene.antialiased:
        close |= _near(splats.det_ratio, ref.DET_RATIO_MIN, 0.1)

    found = _near(p["means"] @ viewmat[2, :3] + viewmat[2, 3], ref.NEAR, 0.1)
    found[splats.index] |= close
    return found.numpy()


def _jittered(scene: Scene, which: np.ndarray, rng: np.random.Generator) -> Scene:
    """The scene with small random changes to the Gaussians named by `which` (N,) bool."""
    amounts = {"means": 0.03, "log_scales": 0.05, "opacity_logits": 0.1, "sh": 0.02}
    arrays = {}
    for name, amount in amounts.items():
        array = getattr(scene, name).copy()
        array[which] += rng.normal(0, amount, array[which].shape)
        arrays[name] = array
    return replace(scene, **arrays)


def away_from_thresholds(
    scene: Scene, camera: Camera, masks: np.ndarray, *, seed: int = 0, rounds: int = 300
) -> tuple[Scene, np.ndarray]:
    """Scene and masks without undecided Gaussians: jittered up to `rounds` times, then dropped if nothing
    helps. Asked the same again, a copy of what was found before: it takes seconds, and many tests ask it for
    each level."""
    key = pickle.dumps((scene, camera, masks, seed, rounds))
    if key not in _decided:
        _decided[key] = _moved_away(scene, camera, masks, seed, rounds)
    return copy.deepcopy(_decided[key])


_decided: dict[bytes, tuple[Scene, np.ndarray]] = {}


def _moved_away(
    scene: Scene, camera: Camera, masks: np.ndarray, seed: int, rounds: int
) -> tuple[Scene, np.ndarray]:
    rng = np.random.default_rng(seed)
    for _ in range(rounds):
        which = undecided(scene, camera, masks)
        if not which.any():
            return scene, masks
        scene = _jittered(scene, which, rng)
    while (which := undecided(scene, camera, masks)).any():
        scene, masks = scene.select(~which), masks[~which]
    return scene, masks

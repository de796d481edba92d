"""Masked splatting and the spatial mask: every pixel meets every Gaussian, autograd supplies every gradient.

Owns the meaning of an image. Uses no tiles, no radii, no closed form of F and no skipping, so that the fast
path has something independent to agree with. All tensors float64; P = H·W pixels, N Gaussians of which V lie
in front of the camera. Pose and rays: COLMAP frame (x right, y down, z forward), pixel centres at k + 0.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

NEAR = 0.2  # world units; nearer centres are not drawn
BLUR = 0.3  # px², added to both variances of a splat
ALPHA_MIN = 1 / 255  # a splat fainter than this at a pixel does not hit it
ALPHA_MAX = 0.99
T_MIN = 1e-4  # colour stops where the transmittance would fall below this
# x/z is clamped this share of half the image beyond its borders (as gsplat does), for the Jacobian only
FRUSTUM_MARGIN = 0.3
DET_RATIO_MIN = 0.000025  # floor under the square root of the antialiasing factor

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


@dataclass(frozen=True)
class Splats:
    """What the V Gaussians in front of the camera look like in the image, nearest first."""

    index: Tensor  # (V,) int64, which Gaussian
    mean: Tensor  # (V, 2) px
    conic: Tensor  # (V, 3) inverse 2-D covariance: xx, xy, yy, px⁻²
    det_ratio: Tensor  # (V,) det Σ₂ / det(Σ₂ + blur)
    opacity: Tensor  # (V,) after the antialiasing factor
    colour: Tensor  # (V, 3) ≥ 0
    z: Tensor  # (V,) depth of the centre


@dataclass(frozen=True)
class Render:
    """One view. T_full is the transmittance that F uses: of all hits in full mode, T_final in visible
    mode."""

    rgb: Tensor  # (H, W, 3)
    depth: Tensor  # (H, W) Σ M α T z, not normalised
    alpha: Tensor  # (H, W) Σ M α T
    F: Tensor  # (H, W) spatial mask
    N: Tensor  # (H, W) hits counted, masked out or not
    K: Tensor  # (H, W) Σ M over them
    T_final: Tensor  # (H, W) after the last blended splat
    T_full: Tensor  # (H, W)


def rotations(quats: Tensor) -> Tensor:
    """Rotation matrices (N, 3, 3) of quaternions (N, 4) wxyz of any length > 0."""
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(1)
    rows = (
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1),
    )
    return torch.stack(rows, 1)


def sh_basis(directions: Tensor, degree: int) -> Tensor:
    """Real spherical harmonics (N, (degree + 1)²) of unit directions (N, 3), signs and order as 3DGS stores
    them."""
    x, y, z = directions.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    basis = [torch.full_like(x, C0)]
    if degree >= 1:
        basis += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        terms = (x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy)
        basis += [c * t for c, t in zip(C2, terms, strict=True)]
    if degree >= 3:
        terms = (
            y * (3 * xx - yy),
            x * y * z,
            y * (4 * zz - xx - yy),
            z * (2 * zz - 3 * xx - 3 * yy),
            x * (4 * zz - xx - yy),
            z * (xx - yy),
            x * (xx - 3 * yy),
        )
        basis += [c * t for c, t in zip(C3, terms, strict=True)]
    return torch.stack(basis, 1)


def view_colours(
    means: Tensor, sh: Tensor, viewmat: Tensor, degree: int, orthographic: bool = False
) -> Tensor:
    """Colour (N, 3) seen from the camera centre, before the clamp at 0; depends on the means through the
    direction.

    Orthographic: every Gaussian is seen along the camera's axis.
    """
    centre = -viewmat[:3, :3].T @ viewmat[:3, 3]
    rays = viewmat[2, :3].expand_as(means) if orthographic else means - centre
    basis = sh_basis(rays / rays.norm(dim=1, keepdim=True), degree)
    return 0.5 + (basis[:, :, None] * sh[:, : basis.shape[1]]).sum(1)


def frustum_limits(K: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Lower and upper limits (2,) of x/z and y/z within the Jacobian: the view enlarged by 0.3 half widths a
    side."""
    focal, principal = K.diagonal()[:2], K[:2, 2]
    size = torch.tensor([width, height], dtype=K.dtype)
    margin = FRUSTUM_MARGIN * size / (2 * focal)
    return -(principal / focal + margin), (size - principal) / focal + margin


def projection_jacobian(
    means_c: Tensor, K: Tensor, width: int, height: int, orthographic: bool = False
) -> Tensor:
    """d(pixel)/d(camera point) (V, 2, 3) at the centres (V, 3), directions outside the enlarged view clamped
    to it."""
    if orthographic:
        return (K.diagonal()[:2, None] * torch.eye(2, 3, dtype=K.dtype)).expand(len(means_c), 2, 3)
    z = means_c[:, 2:]
    slopes = torch.clamp(means_c[:, :2] / z, *frustum_limits(K, width, height))
    focal = K.diagonal()[:2]
    return torch.cat([torch.diag_embed(focal / z), (-focal * slopes / z)[:, :, None]], 2)


def project(
    means,
    log_scales,
    quats,
    opacity_logits,
    sh,
    viewmat,
    K,
    width,
    height,
    degree,
    antialiased,
    orthographic=False,
) -> Splats:
    """Centres in front of the near plane, sorted by (float32 z, index), as splats in the image."""
    means_c = means @ viewmat[:3, :3].T + viewmat[:3, 3]
    index = torch.nonzero(means_c[:, 2].detach() > NEAR).flatten()
    index = index[torch.argsort(means_c[index, 2].detach().float(), stable=True)]

    means_c = means_c[index]
    plane = means_c[:, :2] if orthographic else means_c[:, :2] / means_c[:, 2:]
    mean = plane * K.diagonal()[:2] + K[:2, 2]
    to_px = projection_jacobian(means_c, K, width, height, orthographic) @ viewmat[:3, :3]
    # (V, 2, 3) half axes, px
    axes = to_px @ rotations(quats[index]) * torch.exp(log_scales[index])[:, None, :]
    u, v = axes.unbind(1)
    xx, xy, yy = (u * u).sum(1), (u * v).sum(1), (v * v).sum(1)  # Σ₂ = axes axesᵀ
    # det(axes axesᵀ) without the cancellation of xx yy − xy²
    det_sharp = torch.linalg.cross(u, v).square().sum(1)
    det = det_sharp + BLUR * (xx + yy) + BLUR * BLUR
    conic = torch.stack([yy + BLUR, -xy, xx + BLUR], 1) / det[:, None]

    opacity = torch.sigmoid(opacity_logits[index])
    det_ratio = det_sharp / det
    if antialiased:
        opacity = opacity * torch.sqrt(det_ratio.clamp(min=DET_RATIO_MIN))
    colour = view_colours(means[index], sh[index], viewmat, degree, orthographic).clamp(min=0)
    return Splats(index, mean, conic, det_ratio, opacity, colour, means_c[:, 2])


def pixel_centres(width: int, height: int) -> Tensor:
    """(P, 2) x, y; row-major."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    return torch.stack([x, y], 2).reshape(-1, 2) + torch.tensor(0.5, dtype=torch.float64)


def unclamped_alphas(splats: Splats, pixels: Tensor) -> tuple[Tensor, Tensor]:
    """Opacity · exp(power) and power ≤ 0 (both (P, V)) of every splat at the pixels (P, 2)."""
    dx, dy = (pixels[:, None] - splats.mean).unbind(2)
    xx, xy, yy = splats.conic.unbind(1)
    power = -0.5 * (xx * dx * dx + 2 * xy * dx * dy + yy * dy * dy)
    return splats.opacity * torch.exp(power), power


def alphas(splats: Splats, pixels: Tensor) -> tuple[Tensor, Tensor]:
    """α (P, V), 0 without a hit, and which of them hit (P, V) bool. No gradient through the clamp at 0.99.

    An opacity below 1/255 can hit nowhere, so culling such Gaussians beforehand changes nothing.
    """
    raw, power = unclamped_alphas(splats, pixels)
    hit = (power <= 0) & (raw >= ALPHA_MIN)
    return torch.where(hit, raw.clamp(max=ALPHA_MAX), 0.0), hit


def transmittance(alpha: Tensor, M: Tensor) -> Tensor:
    """T_0 … T_V (P, V + 1) with T_{i+1} = (1 − M_i α_i) T_i: eq. transmittance-update."""
    start = torch.ones(len(alpha), 1, dtype=alpha.dtype)
    return torch.cat([start, torch.cumprod(1 - M * alpha, 1)], 1)


def spatial_mask(alpha: Tensor, M: Tensor, T: Tensor, counted: Tensor, kind: str, eps_a: float) -> Tensor:
    """F (P,) over the counted hits (P, V), 0 if none: 'svr' eq. redundancy-map; 'a', 'b' the ablation's
    scenarios."""
    N = counted.sum(1).clamp(min=1)
    if kind == "svr":
        return (counted * M * (1 - alpha * T)).sum(1) / torch.log1p(N.double())
    if kind == "b":
        return (counted * M * (1 - T)).sum(1) / torch.log1p(N.double())
    if kind == "a":
        w = counted / (alpha * T + eps_a)
        return (w * M).sum(1) / torch.where(counted.any(1), w.sum(1), 1.0)
    raise ValueError(f"mask_kind is {kind!r}; expected 'svr', 'a' or 'b'")


def blend(
    alpha, hit, M, colour, z, background, mode="full", mask_kind="svr", eps_a=1e-3, mask_gradient="exact"
):
    """Composite splats sorted nearest first: alpha, hit (P, V); M, z (V,); colour (V, 3); background (3,).

    Returns (rgb (P, 3), depth, alpha, F, N, K, T_final, T_full), each (P,). Eq. color-compositing plus
    T·background.
    """
    T = transmittance(alpha, M)
    # false from the splat that triggers the stop on
    blended = torch.cumprod((T[:, 1:] >= T_MIN).long(), 1).bool()
    weight = torch.where(blended, M * alpha * T[:, :-1], 0.0)
    T_final = T.gather(1, blended.sum(1, keepdim=True))[:, 0]
    rgb = weight @ colour + T_final[:, None] * background

    if mode not in ("full", "visible"):
        raise ValueError(f"mode is {mode!r}; expected 'full' or 'visible'")
    counted = hit if mode == "full" else hit & blended
    T_full = T[:, -1] if mode == "full" else T_final
    before = T[:, :-1].detach() if mask_gradient == "self" else T[:, :-1]
    F = spatial_mask(alpha, M, before, counted, mask_kind, eps_a)
    return rgb, weight @ z, weight.sum(1), F, counted.sum(1).double(), (counted * M).sum(1), T_final, T_full


def rasterize(
    means: Tensor,  # (N, 3)
    log_scales: Tensor,  # (N, 3)
    quats: Tensor,  # (N, 4) wxyz, any length > 0
    opacity_logits: Tensor,  # (N,)
    sh: Tensor,  # (N, C, 3), C ≥ (sh_degree + 1)²
    masks: Tensor,  # (N,) 0 or 1, this step's sample M
    viewmat: Tensor,  # (4, 4) world to camera, rigid
    K: Tensor,  # (3, 3) px; skew ignored
    width: int,
    height: int,
    background: Tensor,  # (3,)
    *,
    sh_degree: int | None = None,  # active degree; None: all that is stored
    antialiased: bool = False,
    orthographic: bool = False,  # parallel rays: no division by z; fx and fy are px per world unit
    mode: str = "full",  # 'full': F counts every hit; 'visible': F stops with the colour
    mask_kind: str = "svr",  # 'svr', 'a', 'b'
    eps_a: float = 1e-3,  # ε of scenario A
    mask_gradient: str = "exact",  # 'self': T constant within F, leaving only the self term
    depth_limit: Tensor | None = None,  # (H, W): only centres nearer than this hit a pixel
) -> Render:
    """Render one view. The order of the splats, the hits, the stop and N are constants of the gradient."""
    degree = round(sh.shape[1] ** 0.5) - 1 if sh_degree is None else sh_degree
    splats = project(
        means,
        log_scales,
        quats,
        opacity_logits,
        sh,
        viewmat,
        K,
        width,
        height,
        degree,
        antialiased,
        orthographic,
    )
    alpha, hit = alphas(splats, pixel_centres(width, height))
    if depth_limit is not None:
        hit = hit & (splats.z < depth_limit.reshape(-1, 1))
        alpha = torch.where(hit, alpha, 0.0)
    M = masks[splats.index]
    images = blend(alpha, hit, M, splats.colour, splats.z, background, mode, mask_kind, eps_a, mask_gradient)
    return Render(*(image.reshape(height, width, *image.shape[1:]) for image in images))

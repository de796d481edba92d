"""The paper's formulas on one ray, literally, and central differences. Lists or arrays in, lists of floats
out.

alpha and M hold the N hits of a ray, nearest first; eps is scenario A's ε. The paper's forms are O(N²) on
purpose.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

EPS_A = 1e-3


def central_difference(f: Callable[[Tensor], Tensor], x: Tensor, step: float = 1e-6) -> Tensor:
    """∂f/∂x, shaped like x, of a scalar f: (f(x + h) − f(x − h)) / 2h for one element at a time."""
    gradient = torch.zeros_like(x)
    with torch.no_grad():
        for i in range(x.numel()):
            up, down = x.detach().clone(), x.detach().clone()
            up.view(-1)[i] += step
            down.view(-1)[i] -= step
            gradient.view(-1)[i] = (f(up) - f(down)) / (2 * step)
    return gradient


def transmittances(alpha, M) -> list:
    """T_0 … T_N: eq. transmittance-update."""
    T = [1.0]
    for a, m in zip(alpha, M, strict=True):
        T.append((1 - m * a) * T[-1])
    return T


def log_count(alpha) -> float:
    """log(1 + N), a constant of every gradient."""
    return math.log(1 + len(alpha))


# --- colour: eq. color-compositing with background B, one channel


def colour(alpha, M, c, B):
    """C = Σ M_i α_i T_i c_i + T_N B."""
    T = transmittances(alpha, M)
    return sum(m * a * t * ci for m, a, t, ci in zip(M, alpha, T[:-1], c, strict=True)) + T[-1] * B


def colours_behind(alpha, M, c, B) -> list:
    """b_i, the colour per unit transmittance behind splat i: b_{i−1} = M_i α_i c_i + (1 − M_i α_i) b_i,
    b_{N−1} = B."""
    behind = [B]
    for a, m, ci in list(zip(alpha, M, c, strict=True))[:0:-1]:
        behind.append(m * a * ci + (1 - m * a) * behind[-1])
    return behind[::-1][: len(alpha)]


def dC_dM(alpha, M, c, B) -> list:
    """α_i T_i (c_i − b_i), the same for M_i = 0 and 1."""
    T, b = transmittances(alpha, M), colours_behind(alpha, M, c, B)
    return [a * t * (ci - bi) for a, t, ci, bi in zip(alpha, T[:-1], c, b, strict=True)]


def dC_dalpha(alpha, M, c, B) -> list:
    """M_i T_i (c_i − b_i)."""
    T, b = transmittances(alpha, M), colours_behind(alpha, M, c, B)
    return [m * t * (ci - bi) for m, t, ci, bi in zip(M, T[:-1], c, b, strict=True)]


# --- spatial mask, as printed


def paper_F(alpha, M):
    """Eq. redundancy-map; 0 on an empty ray."""
    T = transmittances(alpha, M)
    return (
        sum(m * (1 - a * t) for m, a, t in zip(M, alpha, T[:-1], strict=True)) / log_count(alpha)
        if len(M)
        else 0.0
    )


def paper_dF_dM(alpha, M) -> list:
    """Eq. dF_dMi: self term + occlusion term."""
    T, n = transmittances(alpha, M), len(alpha)
    tails = [sum(M[j] * alpha[j] * T[j] for j in range(i + 1, n)) for i in range(n)]
    return [
        ((1 - alpha[i] * T[i]) + alpha[i] / (1 - alpha[i] * M[i]) * tails[i]) / log_count(alpha)
        for i in range(n)
    ]


def self_dF_dM(alpha, M) -> list:
    """Eq. self_term alone: T held constant."""
    T = transmittances(alpha, M)
    return [(1 - a * t) / log_count(alpha) for a, t in zip(alpha, T[:-1], strict=True)]


# --- spatial mask, telescoped: Σ M_i α_i T_i = 1 − T_N


def closed_F(alpha, M):
    """(K − 1 + T_N) / log(1 + N) with K = Σ M_i; 0 on an empty ray."""
    return (sum(M) - 1 + transmittances(alpha, M)[-1]) / log_count(alpha) if len(M) else 0.0


def closed_dF_dM(alpha, M) -> list:
    """(1 − α_i T_N / (1 − α_i M_i)) / log(1 + N)."""
    T_N = transmittances(alpha, M)[-1]
    return [(1 - a * T_N / (1 - a * m)) / log_count(alpha) for a, m in zip(alpha, M, strict=True)]


def closed_dF_dalpha(alpha, M) -> list:
    """−M_i T_N / ((1 − α_i M_i) log(1 + N))."""
    T_N = transmittances(alpha, M)[-1]
    return [-m * T_N / ((1 - a * m) * log_count(alpha)) for a, m in zip(alpha, M, strict=True)]


# --- the ablation's scenarios, as printed


def scenario_a_weights(alpha, M, eps=EPS_A) -> list:
    """w_i = 1 / (α_i T_i + ε): eq. scenarioA_weights_FA."""
    return [1 / (a * t + eps) for a, t in zip(alpha, transmittances(alpha, M)[:-1], strict=True)]


def scenario_a_F(alpha, M, eps=EPS_A):
    """F_A = Σ w_i M_i / Σ w_i; 0 on an empty ray."""
    w = scenario_a_weights(alpha, M, eps)
    return sum(wi * m for wi, m in zip(w, M, strict=True)) / sum(w) if len(M) else 0.0


def scenario_a_dF_dM(alpha, M, eps=EPS_A) -> list:
    """Eq. scenarioA_backward_exact."""
    T, w, n = transmittances(alpha, M), scenario_a_weights(alpha, M, eps), len(alpha)
    F, S = scenario_a_F(alpha, M, eps), sum(w)

    def dw_dM(j: int, i: int) -> float:
        return alpha[i] * alpha[j] * T[j] / ((1 - alpha[i] * M[i]) * (alpha[j] * T[j] + eps) ** 2)

    return [(w[i] + sum((M[j] - F) * dw_dM(j, i) for j in range(i + 1, n))) / S for i in range(n)]


def scenario_b_F(alpha, M):
    """F_B = Σ M_i (1 − T_i) / log(1 + N): eq. scenarioB_forward; 0 on an empty ray."""
    T = transmittances(alpha, M)
    return sum(m * (1 - t) for m, t in zip(M, T[:-1], strict=True)) / log_count(alpha) if len(M) else 0.0


def scenario_b_dF_dM(alpha, M) -> list:
    """Eq. scenarioB_backward_exact."""
    T, n = transmittances(alpha, M), len(alpha)
    tails = [sum(M[j] * T[j] for j in range(i + 1, n)) for i in range(n)]
    return [((1 - T[i]) + alpha[i] / (1 - alpha[i] * M[i]) * tails[i]) / log_count(alpha) for i in range(n)]

"""Raw values survive beside their activated ones bit by bit, and give way to edits."""

from __future__ import annotations

import numpy as np
import pytest

from svrgs_addon.scene import activation as a

RNG = np.random.default_rng(0)
LOGITS = np.concatenate([RNG.normal(0, 8, 10_000), [0, -0.0, 120, -120, np.inf, -np.inf]]).astype(np.float32)
LOG_SCALES = (
    np.concatenate([RNG.normal(-4, 4, 30_000), [0, -0.0, 200, -200, -np.inf, 1e-8]])
    .astype(np.float32)
    .reshape(-1, 3)
)
QUATS = (RNG.normal(size=(10_000, 4)) * RNG.uniform(1e-6, 1e6, (10_000, 1))).astype(np.float32)
CASES = {
    "scale": (a.scales, a.raw_scales, LOG_SCALES),
    "opacity": (a.opacities, a.raw_opacities, LOGITS),
    "rotation": (a.rotations, a.raw_rotations, QUATS),
}


@pytest.mark.parametrize("activate, restore, raw", CASES.values(), ids=CASES)
def test_kept_values_come_back_bit_by_bit(activate, restore, raw):
    assert restore(activate(raw), raw).tobytes() == raw.tobytes()


@pytest.mark.parametrize("activate, restore, raw", CASES.values(), ids=CASES)
def test_edited_values_win_over_kept_ones(activate, restore, raw):
    ordinary = raw[
        np.isfinite(raw).reshape(len(raw), -1).all(axis=1)
        & (np.abs(raw).reshape(len(raw), -1).max(axis=1) < 10)
    ]
    edited = ordinary[::-1].copy()
    found = restore(activate(edited), ordinary)
    np.testing.assert_allclose(activate(found), activate(edited), rtol=3e-6, atol=1e-7)


@pytest.mark.parametrize("activate, restore, raw", CASES.values(), ids=CASES)
def test_without_kept_values_the_activated_ones_are_undone(activate, restore, raw):
    """Opacities of 0 and 1 up to 5e-5, as finite logits."""
    values = activate(raw)
    found = restore(values)
    ends = (values == 0) | (values == 1) if restore is a.raw_opacities else np.zeros(values.shape, bool)
    np.testing.assert_allclose(activate(found)[~ends], values[~ends], rtol=2e-5, atol=1e-7)
    np.testing.assert_allclose(activate(found)[ends], values[ends], atol=5e-5)
    assert np.isfinite(found[ends]).all()


def test_rotations_have_length_1_and_nothing_is_the_identity():
    assert np.abs(np.linalg.norm(a.rotations(QUATS), axis=1) - 1).max() < 1e-6
    assert a.rotations(np.zeros((1, 4), np.float32)).tolist() == [[1, 0, 0, 0]]

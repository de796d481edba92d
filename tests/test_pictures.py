"""Colour maps, and pictures made of pictures."""

from __future__ import annotations

import numpy as np
import pytest

from svrgs_addon.files.images import linear_to_srgb
from svrgs_addon.prune.report.pictures import contact_sheet, wipe, with_color_bar
from svrgs_addon.render import color_maps


@pytest.mark.parametrize("name", color_maps.NAMES)
def test_colour_maps_become_lighter_from_low_to_high(name):
    rgb = color_maps.colored(np.linspace(-1, 3, 200), 2.0, name)
    luminance = rgb @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(luminance) >= -1e-3).all() and luminance[-1] > 0.7
    # what is outside 0 to top has the colours at the ends
    assert (rgb[:50] == rgb[0]).all() and (rgb[-50:] == rgb[-1]).all()


def test_pixels_are_linear_colours_or_the_numbers_themselves():
    values = np.linspace(0, 5, 12).reshape(3, 4)
    np.testing.assert_allclose(
        linear_to_srgb(color_maps.pixels(values, 5, "viridis")),
        color_maps.colored(values, 5, "viridis"),
        atol=1e-6,
    )
    np.testing.assert_array_equal(color_maps.pixels(values, 5, "values"), np.stack([values] * 3, -1))


def test_a_wipe_has_the_left_picture_on_the_left():
    a, b = np.zeros((2, 10, 3)), np.ones((2, 10, 3))
    assert [wipe(a, b, share)[0, :, 0].sum() for share in (0, 0.3, 1)] == [10, 7, 0]


def test_a_contact_sheet_holds_every_picture_whole():
    rng = np.random.default_rng(0)
    rows = [
        [rng.integers(1, 255, (h, w, 3), np.uint8) for _ in range(3)] for h, w in ((4, 6), (5, 3), (2, 8))
    ]
    sheet = contact_sheet(rows, columns=2, gap=1)
    assert sheet.shape == (5 + 1 + 2, 3 * 6 + 2 + 3 + 3 * 3 + 2, 3)
    np.testing.assert_array_equal(sheet[:4, 7:13], rows[0][1])
    np.testing.assert_array_equal(sheet[:5, 23:26], rows[1][0])
    np.testing.assert_array_equal(sheet[6:8, 18:26], rows[2][2])
    assert int(sheet.astype(int).sum()) == sum(int(p.astype(int).sum()) for row in rows for p in row)


def test_the_bar_below_a_picture_goes_through_the_map():
    picture = with_color_bar(np.full((80, 50, 3), 0.5), "magma")
    np.testing.assert_array_equal(picture[:80], 0.5)
    np.testing.assert_allclose(picture[-1], color_maps.colored(np.linspace(0, 1, 50), 1, "magma"))

# SPDX-License-Identifier: Apache-2.0
"""Rendered images: prints are averaged exactly, and are where the geometry places them."""

from dataclasses import replace

import numpy as np
import pytest
from camera_rig import SETTINGS, PaperCamera
from rendered_images import Pattern, RenderedCamera

HALVES = Pattern(np.array([[0.0, 1.0]]), (1.0, 1.0))  # black for u < 0, white for u > 0


@pytest.mark.parametrize(
    ("u", "width", "mean"), [(0.0, 0.5, 0.5), (0.1, 0.5, 0.7), (-0.4, 0.2, 0.0), (0.5, 0.3, 1.0)]
)
def test_an_edge_within_a_pixel_shares_it(u: float, width: float, mean: float):
    """The white share of a pixel of a width around u is 1/2 + u / width."""
    given = (np.array([value]) for value in (u, 0.0, width, 0.2))
    reflectance, share = HALVES.average(*given)
    assert reflectance[0] == pytest.approx(mean)
    assert share[0] == pytest.approx(1.0)


def test_beyond_its_border_a_print_has_no_share():
    reflectance, share = HALVES.average(*(np.array([v]) for v in (1.0, 0.5, 0.4, 0.4)))
    assert share[0] == pytest.approx(0.25)
    assert reflectance[0] == pytest.approx(1.0)
    assert HALVES.average(*(np.array([v]) for v in (3.0, 0.0, 0.1, 0.1)))[1][0] == 0.0


def test_a_print_is_dark_where_its_frame_projects_to():
    camera = RenderedCamera(replace(SETTINGS, glare=0.0, noise_dark=0.0, noise_bright=0.0))
    image = camera.image(0.05, 0.33)
    y, z = SETTINGS.module_line
    cell = SETTINGS.marker_size / 6.0
    for centre in (0.05, 0.33):
        places = np.array([[centre + 2.5 * cell, y, z], [centre + 3.5 * cell, y, z]])
        frame, margin = np.round(PaperCamera().pixels(places)).astype(int)
        assert image[frame[1], frame[0]] < 40
        assert image[margin[1], margin[0]] > 100

# SPDX-License-Identifier: Apache-2.0
"""The virtual camera's images: prints are averaged exactly, and are where the geometry places them."""

from dataclasses import replace

import numpy as np
import pytest
from camera_rig import SETTINGS, PaperCamera

from worm_driver.virtual_robot.camera_images import (
    DEFAULT_FILE,
    Pattern,
    VirtualCamera,
    exposure_path,
    load_camera_settings,
)
from worm_msgs.yaml_file import SettingsFileError

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
    camera = VirtualCamera(replace(SETTINGS, glare=0.0, noise_dark=0.0, noise_bright=0.0), 0)
    image = camera.image(np.array([[0.05, 0.33]]))
    y, z = SETTINGS.module_line
    cell = SETTINGS.marker_size / 6.0
    for centre in (0.05, 0.33):
        places = np.array([[centre + 2.5 * cell, y, z], [centre + 3.5 * cell, y, z]])
        frame, margin = np.round(PaperCamera().pixels(places)).astype(int)
        assert image[frame[1], frame[0]] < 40
        assert image[margin[1], margin[0]] > 100


def test_the_same_seed_makes_the_same_images():
    path = np.array([[0.0, 0.3]])
    first, second, other = (VirtualCamera(SETTINGS, seed).image(path) for seed in (4, 4, 5))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_what_is_out_of_sight_is_not_in_the_image():
    camera = VirtualCamera(replace(SETTINGS, noise_dark=0.0, noise_bright=0.0), 0)
    seen, hidden = (camera.image(np.array([[rear, 0.33]])).astype(int) for rear in (0.05, np.nan))
    different = np.flatnonzero(np.abs(seen - hidden).sum(axis=0))
    column = PaperCamera().pixels(np.array([[0.05, *SETTINGS.module_line]]))[0, 0]
    assert np.abs(different - column).max() < 80  # pixels: around the rear module alone


def test_the_path_of_an_exposure():
    path = exposure_path((2_000_000_000, 0.10, 0.40), (1_900_000_000, 0.09, 0.42), 0.03)
    assert path == pytest.approx(np.array([[0.099, 0.402], [0.1, 0.4], [0.101, 0.398]]))
    still = exposure_path((5, 0.1, np.nan), None, 0.03)
    assert still[:, 0] == pytest.approx([0.1] * 3)
    assert np.isnan(still[:, 1]).all()


@pytest.mark.parametrize(
    ("old", "new", "facts"),
    [
        ("width: 1280\n", "", ["width", "missing"]),
        ("width: 1280", "width: 1280.5", ["width", "integer", "1280.5"]),
        ("focal_px", "focal_mm", ["'focal_mm'", "focal_px"]),
        ("centre_px: [652.3, 351.8]", "centre_px: [652.3]", ["centre_px: [1]", "missing"]),
        ("z_m: 0.0}", "z_m: off}", ["module_line: z_m", "number"]),
        ('"1011"', '"10x1"', ["markers: 0", "'x'"]),
        ("width: 1280", "width: [", ["YAML"]),
    ],
)
def test_an_invalid_file_is_rejected(tmp_path, old, new, facts):
    text = DEFAULT_FILE.read_text()
    assert old in text
    path = tmp_path / "camera.yaml"
    path.write_text(text.replace(old, new))
    with pytest.raises(SettingsFileError) as caught:
        load_camera_settings(path)
    assert [fact for fact in facts if fact not in str(caught.value)] == []
    with pytest.raises(SettingsFileError, match="No such file"):
        load_camera_settings(tmp_path / "none.yaml")
